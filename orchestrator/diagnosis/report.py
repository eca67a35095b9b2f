"""A diagnosis as one page that needs no network: what a lab engineer reads in two minutes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

from ..page import bar as _bar
from ..page import card as _card
from ..page import document, figure
from .catalogue import catalogue, in_words
from .effect import Effect
from .figures import figure_of
from .finding import Augmented
from .headline import TELLS, given, headline, leaves_in_words, listed_or, nats, percent
from .study import Role, Study
from .verdict import Diagnosis, Gap

__all__ = ["compose", "page", "remarks"]

# A share of probability below which an answer is not worth a line, and so many lines.
_WORTH, _LINES = 0.005, 8
# Ties are told of answers that are likelier than this.
_TIED = 0.05
# So many answers of the 95 % set are named.
_NAMED = 6
# Energy shares are shown with a colour that is full from here on.
_FULL = 0.5


def page(study: Study, diagnosis: Diagnosis, model: Augmented) -> str:
    """The page as HTML.

    Args:
        model: the answer's, by which residuals are shown after the effects are added.
    """
    places = list(dict.fromkeys(diagnosis.verdict.places)) or ["sensor"]
    figures = [figure_of(study, place, model) for place in places[:3]]
    seen: dict[str, str] = {words: drawn for drawn, words in figures}
    return compose(diagnosis, seen, _assumed(study, diagnosis), catalogue(), "one contact ahead")


def compose(
    diagnosis: Diagnosis,
    figures: Mapping[str, str],
    assumed: Sequence[str],
    known: Mapping[str, Effect],
    gap: str,
) -> str:
    """A page of a diagnosis, as HTML.

    Args:
        figures: SVG by what each shows in words.
        assumed: sentences.
        known: the effects that were weighed, by id.
        gap: over what the gap is measured.
    """
    parts = [
        f"<p class=headline>{escape(headline(diagnosis))}</p>",
        _warnings(diagnosis),
        "<div class=cards>",
        _card("Which effect", _posterior(diagnosis, known)),
        _card("Where the gap lies", _where(diagnosis)),
        _card("How far it shrinks", _how_far(diagnosis, gap)),
        _card("What to run next", _next(diagnosis)),
        "</div>",
        "<h2>Residuals before and after</h2>",
        *(figure(drawn, words) for words, drawn in figures.items()),
        _augmented(diagnosis),
        _ledger(diagnosis),
        _energy(diagnosis),
        _calibration(diagnosis),
        _told(assumed),
        _provenance(diagnosis),
    ]
    return document(f"{diagnosis.case}: diagnosis of the sim-to-real gap", parts)


def _number(value: float | None, digits: int = 3) -> str:
    return "-" if value is None else f"{value:.{digits}g}"


def _posterior(diagnosis: Diagnosis, known: Mapping[str, Effect]) -> str:
    rows = []
    answer = given(diagnosis)
    shown = [one for one in diagnosis.which if one.probability >= _WORTH][:_LINES]
    for one in shown:
        label = " + ".join(one.effects) or "no effect"
        notes = [_in_words(effect, one.parameters, known) for effect in one.effects if effect in known]
        if one.ties and (one is answer or one.probability >= _TIED):
            notes.append(f"tied with {', '.join(one.ties)}")
        note = "; ".join(part for part in notes if part)
        rows.append(_bar(label, one.probability, percent(one.probability), note, one is answer))
    rest = 1.0 - sum(one.probability for one in shown)
    if rest > 1e-4:
        rows.append(_bar("all others", rest, percent(rest)))
    answers = ", ".join(diagnosis.answer_set[:_NAMED])
    if len(diagnosis.answer_set) > _NAMED:
        more = len(diagnosis.answer_set) - _NAMED
        answers += f", and {more} more that the logs show too little of to exclude"
    return "".join(rows) + (f"<p class=note>95 % answer set: {escape(answers)}</p>" if answers else "")


def _in_words(name: str, parameters: Mapping[str, float], known: Mapping[str, Effect]) -> str:
    """What an effect is, and its fitted parameters with their units."""
    fitted = []
    for one in known[name].parameters:
        value = parameters.get(f"{name}.{one.name}")
        if value is not None:
            unit = "" if one.unit in ("", "1") else f" {one.unit}"
            fitted.append(f"{one.name.replace('_', ' ')} {value:.4g}{unit}")
    told = in_words(known[name])
    return f"{told} ({', '.join(fitted)})" if fitted else told


def _where(diagnosis: Diagnosis) -> str:
    if not diagnosis.where:
        return _left_out(diagnosis, "where")
    rows = [
        _bar(one.place, one.share, percent(one.share), strong=one.place in diagnosis.verdict.places)
        for one in diagnosis.where
    ]
    note = "Shares of the held-out closed-loop gap; they add up to 100 %."
    if diagnosis.how_far is not None and diagnosis.how_far.within_floor:
        note += " The gap is within the noise: they mean little."
    return f"{''.join(rows)}<p class=note>{note}</p>"


def _how_far(diagnosis: Diagnosis, over: str) -> str:
    gap = diagnosis.how_far
    if gap is None:
        return _left_out(diagnosis, "how_far")
    rows = [(over, gap)] + ([("whole run", gap.full_run)] if gap.full_run is not None else [])
    body = "".join(f"<tr><th>{name}</th>{_gap_cells(one)}</tr>" for name, one in rows)
    head = "".join(
        f"<th>{one}</th>" for one in ("", "before", "after", "noise", "closed", "by calibration alone")
    )
    note = (
        "Error of the model on held-out runs, relative to the size of the signals; noise: what two runs of "
        "the same rig differ by. High closure alone does not prove the cause."
    )
    return f"<table><tr>{head}</tr>{body}</table><p class=note>{note}</p>"


def _gap_cells(gap: Gap) -> str:
    closed = "within the noise" if gap.within_floor else "-" if gap.closure is None else percent(gap.closure)
    if gap.interval is not None and not gap.within_floor:
        closed += f"<div class=note>{100 * gap.interval[0]:.0f} to {100 * gap.interval[1]:.0f} %</div>"
    alone = "-" if gap.recalibration_only is None else percent(gap.recalibration_only)
    cells = (*map(_number, (gap.before, gap.after, gap.noise_floor)), closed, alone)
    return "".join(f"<td>{one}</td>" for one in cells)


def _next(diagnosis: Diagnosis) -> str:
    one = diagnosis.next_experiment
    if one is None:
        if "next_experiment" in diagnosis.left_out:
            return _left_out(diagnosis, "next_experiment")
        return "<p>No experiment is needed: no tie is left to break.</p>"
    text = f"<p><b>{escape(one.name)}</b></p><p>{escape(one.description)}</p>"
    if one.expected_evidence is not None and one.expected_evidence < TELLS:
        return "<p>No experiment of the menu tells these answers apart.</p>"
    if one.between:
        text += f"<p class=note>Between {escape(listed_or(one.between))}"
        if one.expected_evidence is not None:
            text += f": {nats(one.expected_evidence)} of evidence expected"
        text += ".</p>"
    if one.leaves and one.expected_evidence is not None and one.expected_evidence >= TELLS:
        text += f"<p class=note>{escape(leaves_in_words(one))}</p>"
    return text


def _left_out(diagnosis: Diagnosis, name: str) -> str:
    return f"<p class=note>Left out: {escape(diagnosis.left_out.get(name, 'no result'))}.</p>"


def _augmented(diagnosis: Diagnosis) -> str:
    one = diagnosis.augmented
    if one is None:
        return ""
    items = "".join(f"<li>{escape(line)}</li>" for line in one.changed) or "<li>nothing</li>"
    items += "".join(f"<li>Not in it: {escape(key)}: {escape(why)}</li>" for key, why in one.left_out.items())
    name = "rig" if one.run else "system"
    like = f" with mass, speed and duration of {escape(one.run)}" if one.run else ""
    return (
        f"<h2>The {name} with the effects, to be run</h2>"
        f"<p><code>orchestrator run {escape(one.file)} --out augmented</code> co-simulates the {name}{like}. "
        f"What differs from the {name} as believed:</p>"
        f"<ul>{items}</ul>"
    )


def _warnings(diagnosis: Diagnosis) -> str:
    told = [f"{one.place}: {one.what}. {one.remedy}" for one in diagnosis.data]
    if diagnosis.doubtful_tolerances and diagnosis.verdict.effects:
        told.insert(0, "Calibrated numbers moved farther than their tolerances allow: doubt the tolerances.")
    items = "".join(f"<li>{escape(one)}</li>" for one in told)
    return f"<aside><b>About the data</b><ul>{items}</ul></aside>" if items else ""


def _ledger(diagnosis: Diagnosis) -> str:
    if not diagnosis.ledger:
        return ""
    components = list(dict.fromkeys(one.component for one in diagnosis.ledger))
    phases = list(dict.fromkeys(one.phase for one in diagnosis.ledger))
    bands = list(dict.fromkeys(one.band for one in diagnosis.ledger))
    shares = {(one.component, one.phase, one.band): one.share for one in diagnosis.ledger}
    head = "".join(f"<th colspan={len(bands)}>{escape(phase)}</th>" for phase in phases)
    sub = "".join(f"<th class=band>{escape(band)}</th>" for _ in phases for band in bands)
    body = ""
    for component in components:
        cells = [shares.get((component, phase, band), 0.0) for phase in phases for band in bands]
        body += f"<tr><th>{escape(component)}</th>{''.join(map(_heat, cells))}{_heat(sum(cells))}</tr>"
    return (
        "<h2>Residual energy</h2><p class=note>Excess over noise, in percent of all of it, by component, "
        "phase of motion and frequency band. Cells add up to 100.</p>"
        f"<div class=wide><table class=heat><tr><th></th>{head}"
        f"<th>all</th></tr><tr><th></th>{sub}<th></th></tr>{body}</table></div>"
    )


def _heat(share: float) -> str:
    depth = min(abs(share) / _FULL, 1.0) ** 0.5
    colour = f"rgba(213,94,0,{0.75 * depth:.2f})" if share >= 0 else f"rgba(0,114,178,{0.75 * depth:.2f})"
    text = f"{100 * share:.1f}"
    return f'<td style="background:{colour}">{text.removeprefix("-") if float(text) == 0 else text}</td>'


def _energy(diagnosis: Diagnosis) -> str:
    energy = diagnosis.energy
    if not energy.get("interfaces"):
        return ""
    columns = [name for name in ("measured", "nominal", "excess", "answer") if name in energy]
    head = "".join(f"<th>{escape(one)}</th>" for one in columns)
    rows = [
        f"<tr><th>{escape(one)}</th>{''.join(f'<td>{energy[name][one]:+.4f}</td>' for name in columns)}</tr>"
        for one in energy["interfaces"]
    ]
    total = "".join(f"<td><b>{energy['change'][name]:+.4f}</b></td>" for name in columns)
    title, words, whole = (
        "Energy of a contact",
        "CoR^2 - 1, the share of kinetic energy that a contact adds, by the interface at which it enters; "
        "mean over held-out contacts, or all where no run was held out.",
        "CoR^2 - 1",
    )
    if "unit" in energy:
        title, whole = "Energy at interfaces", f"all [{energy['unit']}]"
        words = f"Force times velocity over the runs [{energy['unit']}], by interface and phase of motion."
    return (
        f"<h2>{title}</h2><p class=note>{words} Excess is measured less nominal.</p>"
        f"<table><tr><th></th>{head}</tr>{''.join(rows)}<tr><th>{whole}</th>{total}</tr></table>"
    )


def _calibration(diagnosis: Diagnosis) -> str:
    rows = ""
    for name, one in diagnosis.calibration.items():
        moved = [(one[key] - one["nominal"]) / one["tolerance"] for key in ("fitted", "recalibrated")]
        cells = f"<td>{_number(one['nominal'], 6)}</td><td>{_number(one['tolerance'])}</td>"
        cells += "".join(f"<td>{'<b>' if abs(by) > 3 else ''}{by:+.1f}</td>" for by in moved)
        rows += f"<tr><th>{escape(name.replace('_', ' '))}</th>{cells}</tr>"
    head = "".join(
        f"<th>{one}</th>"
        for one in ("", "as calibrated (SI)", "tolerance", "moved, with effects", "moved, without effects")
    )
    return (
        "<details><summary>Calibration</summary><p class=note>Moves in tolerances; more than 3 in bold.</p>"
        f"<table><tr>{head}</tr>{rows}</table></details>"
    )


def _assumed(study: Study, diagnosis: Diagnosis) -> list[str]:
    roles = {role: [run.name for run in study.of(role)] for role in Role}
    told = [
        f"Fits saw {', '.join(roles[Role.TRAIN])} only; "
        + (
            f"closure is measured on {', '.join(roles[Role.HELDOUT])}."
            if roles[Role.HELDOUT]
            else "nothing is held out."
        ),
        "A calibrated number deviates from its value by its tolerance, one standard deviation of a normal "
        "distribution; rigs have small roughness besides, which is not called an effect.",
        f"Causes are those of a catalogue of {len(catalogue())} effects, alone or together, none of them, or "
        "one outside the catalogue.",
        "Probabilities are calibrated on simulated rigs, not on measured ones.",
    ]
    return told + remarks(diagnosis)


def remarks(diagnosis: Diagnosis) -> list[str]:
    """What is said of any diagnosis: the numerical error, and what was left out."""
    told = [f"Left out: {name.replace('_', ' ')}: {why}." for name, why in diagnosis.left_out.items()]
    if diagnosis.numerics is None:
        return told
    own = []
    if diagnosis.numerics.fraction is not None:
        share = percent(diagnosis.numerics.fraction)
        own.append(f"The co-simulation's own error, by step halving, is {share} of the gap.")
    change, noise = diagnosis.numerics.replay_change, diagnosis.numerics.replay_noise
    if change is not None and noise is not None and change > noise:
        own.append(
            f"Halving the sub-steps changes the position by {1e3 * change:.2g} mm over whole runs that are "
            "replayed from their commands: the model with these effects goes another way in time, and "
            "what it leaves then was not held against them."
        )
    return [*own, *told]


def _told(assumed: Sequence[str]) -> str:
    items = "".join(f"<li>{escape(one)}</li>" for one in assumed)
    return f"<h2>What was assumed</h2><ul>{items}</ul>"


def _provenance(diagnosis: Diagnosis) -> str:
    kept = diagnosis.provenance
    packages = ", ".join(f"{name} {version}" for name, version in (kept.get("packages") or {}).items())
    lines = "".join(
        f"<tr><td>{escape(name)}</td><td><code>{escape(digest)}</code></td></tr>"
        for name, digest in (kept.get("sha256") or {}).items()
    )
    return (
        f"<details><summary>Provenance</summary><p>{escape(str(kept.get('created', '')))}; Python "
        f"{escape(str(kept.get('python', '')))}, {escape(str(kept.get('platform', '')))}; "
        f"{escape(packages)}</p>"
        f"<table>{lines}</table></details>"
    )
