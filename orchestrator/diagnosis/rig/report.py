"""Page of a diagnosis, without network access."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

from ...plotting.page import aside, bar, card, details, document, figure, note, number, provenance, table
from .catalogue import catalogue
from .caveats import caveats
from .effect import Effect
from .figures import figure_of
from .finding import Augmented
from .headline import (
    SEPARATES,
    chosen_answer,
    headline,
    leaves_in_words,
    listed_or,
    nats,
    percent,
)
from .report_energy import energy, ledger
from .report_text import UNTOLD
from .study import Role, Study
from .verdict import Diagnosis, Gap, HowFar

# A share of probability below which an answer is not worth a line, and so many lines.
_WORTH, _LINES = 0.005, 8
# Ties are reported for answers that are likelier than this.
_TIED = 0.05
# So many answers of the 95 % set are named.
_NAMED = 6


def page(study: Study, diagnosis: Diagnosis, model: Augmented) -> str:
    """The page as HTML.

    Args:
        model: the answer's, by which residuals are shown after the effects are added.
    """
    places = list(dict.fromkeys(diagnosis.verdict.places)) or ["sensor"]
    figures = [figure_of(study, place, model) for place in places[:3]]
    seen: dict[str, str] = {words: drawn for drawn, words in figures}
    return compose(diagnosis, seen, _assumed(study, diagnosis))


def compose(diagnosis: Diagnosis, figures: Mapping[str, str], assumed: Sequence[str]) -> str:
    """A page of a diagnosis, as HTML.

    Args:
        figures: SVG by what each shows in words.
        assumed: sentences.
    """
    parts = [
        f"<p class=headline>{escape(headline(diagnosis))}</p>",
        aside("About the answer", caveats(diagnosis)),
        aside("About the data", [f"{one.place}: {one.what}. {one.remedy}" for one in diagnosis.data]),
        "<div class=cards>",
        card("Which effect", _posterior(diagnosis)),
        card("Where the gap lies", _where(diagnosis)),
        card("How far it shrinks", _how_far(diagnosis)),
        card("What to run next", _next(diagnosis)),
        "</div>",
        "<h2>Residuals before and after</h2>",
        *(figure(drawn, words) for words, drawn in figures.items()),
        _augmented(diagnosis),
        ledger(diagnosis),
        energy(diagnosis),
        _calibration(diagnosis),
        f"<h2>What was assumed</h2>{_listing(assumed)}",
        provenance(diagnosis.provenance, _digests(diagnosis)),
    ]
    return document(f"{diagnosis.case}: diagnosis of the sim-to-real gap", parts)


def _listing(sentences: Sequence[str]) -> str:
    return f"<ul>{''.join(f'<li>{escape(one)}</li>' for one in sentences)}</ul>"


def _posterior(diagnosis: Diagnosis) -> str:
    rows = []
    answer = chosen_answer(diagnosis)
    shown = [one for one in diagnosis.which if one.probability >= _WORTH][:_LINES]
    for one in shown:
        label = " + ".join(one.effects) or "no effect"
        effects = [catalogue()[name] for name in one.effects if name in catalogue()]
        notes = [_in_words(effect, one.parameters) for effect in effects]
        if one.ties and (one is answer or one.probability >= _TIED):
            notes.append(f"tied with {', '.join(one.ties)}")
        below = "; ".join(part for part in notes if part)
        rows.append(bar(label, one.probability, percent(one.probability), below, one is answer))
    rest = 1.0 - sum(one.probability for one in shown)
    if rest > 1e-4:
        rows.append(bar("all others", rest, percent(rest)))
    answers = ", ".join(diagnosis.answer_set[:_NAMED])
    if len(diagnosis.answer_set) > _NAMED:
        more = len(diagnosis.answer_set) - _NAMED
        answers += f", and {more} more that the logs show too little of to exclude"
    return "".join(rows) + (note(f"95 % answer set: {answers}") if answers else "")


def _in_words(effect: Effect, parameters: Mapping[str, float]) -> str:
    """Description of an effect with its fitted parameters and units."""
    fitted = []
    for one in effect.parameters:
        value = parameters.get(f"{effect.id}.{one.name}")
        if value is not None:
            unit = "" if one.unit in ("", "1") else f" {one.unit}"
            fitted.append(f"{one.name} {value:.4g}{unit}")
    return f"{effect.words} ({', '.join(fitted)})" if fitted else effect.words


def _where(diagnosis: Diagnosis) -> str:
    if not diagnosis.where:
        return _left_out(diagnosis, "where")
    rows = [
        bar(one.place, one.share, percent(one.share), strong=one.place in diagnosis.verdict.places)
        for one in diagnosis.where
    ]
    text = "Shares of the closed-loop gap on held-out runs; they add up to 100 %."
    if diagnosis.how_far is not None and diagnosis.how_far.within_floor:
        text += " The gap is within the noise: they mean little."
    return "".join(rows) + note(text)


def _how_far(diagnosis: Diagnosis) -> str:
    gap = diagnosis.how_far
    if gap is None:
        return _left_out(diagnosis, "how_far")
    rows = [("one contact ahead", gap)]
    rows += [("complete run", gap.full_run)] if gap.full_run is not None else []
    heads = ("", "before", "after", "noise", "closed", "95 %", "by calibration alone")
    text = (
        "Error of the model on held-out runs, relative to the size of the signals; "
        f"noise: {_noise_in_words(gap)}. High closure alone does not prove the cause."
    )
    return table(heads, [[name, *_gap_cells(one)] for name, one in rows]) + note(text)


def _noise_in_words(gap: HowFar) -> str:
    """Where the noise comes from that a gap is held against."""
    text = {
        "repeats": "what runs differ by that repeat each other",
        "specified": "as specified, since no held-out run was repeated",
        "both": "what runs differ by that repeat each other, else as specified",
    }.get(gap.noise_floor_from, "what does not repeat")
    unknown = gap.full_run is not None and gap.full_run.noise_floor_from == "none"
    return f"{text}; over complete runs none is known" if unknown else text


def _gap_cells(gap: Gap) -> list[str]:
    closed = "within the noise" if gap.within_floor else "-" if gap.closure is None else percent(gap.closure)
    known = gap.interval is not None and not gap.within_floor
    interval = "{:.0f} to {:.0f} %".format(*(100 * one for one in gap.interval)) if known else ""
    alone = "-" if gap.recalibration_only is None else percent(gap.recalibration_only)
    return [*(number(one, 3) for one in (gap.before, gap.after, gap.noise_floor)), closed, interval, alone]


def _next(diagnosis: Diagnosis) -> str:
    one = diagnosis.next_experiment
    if one is None:
        if "next_experiment" in diagnosis.left_out:
            return _left_out(diagnosis, "next_experiment")
        return "<p>No experiment is needed: no tie is left to break.</p>"
    text = f"<p><b>{escape(one.name)}</b></p><p>{escape(one.description)}</p>"
    if one.expected_evidence is not None and one.expected_evidence < SEPARATES:
        return f"<p>{escape(UNTOLD[0].upper() + UNTOLD[1:])}.</p>"
    if one.between:
        known = one.expected_evidence is not None
        expected = f": {nats(one.expected_evidence)} of evidence expected" if known else ""
        text += note(f"Between {listed_or(one.between)}{expected}.")
    if one.leaves and one.expected_evidence is not None:
        text += note(leaves_in_words(one))
    return text


def _left_out(diagnosis: Diagnosis, name: str) -> str:
    return note(f"Left out: {diagnosis.left_out.get(name, 'no result')}.")


def _augmented(diagnosis: Diagnosis) -> str:
    one = diagnosis.augmented
    if one is None:
        return ""
    missing = [f"Not in it: {key}: {why}" for key, why in one.left_out.items()]
    return (
        "<h2>The rig with the effects, to be run</h2>"
        f"<p><code>orchestrator run {escape(one.file)} --out augmented</code> co-simulates the rig with "
        f"mass, speed and duration of {escape(one.run)}. What differs from the rig as believed:</p>"
        + _listing([*(one.changed or ["nothing"]), *missing])
    )


def _calibration(diagnosis: Diagnosis) -> str:
    heads = ("", "as calibrated (SI)", "tolerance", "moved, with effects", "moved, without effects")
    rows = []
    for name, one in diagnosis.calibration.items():
        moved = [(one[key] - one["nominal"]) / one["tolerance"] for key in ("fitted", "recalibrated")]
        rows.append([name, one["nominal"], one["tolerance"], *(round(by, 1) for by in moved)])
    return details("Calibration", note("Moves in tolerances; more than 3 is much.") + table(heads, rows))


def _assumed(study: Study, diagnosis: Diagnosis) -> list[str]:
    roles = {role: [run.name for run in study.of(role)] for role in Role}
    sentences = [
        f"Fits saw {', '.join(roles[Role.TRAIN])} only; "
        + (
            f"closure is measured on {', '.join(roles[Role.HELDOUT])}, and what an answer leaves is looked "
            "for in all runs, if these can show it."
            if roles[Role.HELDOUT]
            else "nothing is held out."
        ),
        "A calibrated number deviates from its value by its tolerance, one standard deviation of a normal "
        "distribution; rigs have small roughness besides, which is not called an effect.",
        f"Causes are those of a catalogue of {len(catalogue())} effects, alone or together, none of them, or "
        "one outside the catalogue.",
        "Probabilities are calibrated on simulated rigs, not on measured ones.",
    ]
    return sentences + remarks(diagnosis)


def remarks(diagnosis: Diagnosis) -> list[str]:
    """Remarks on any diagnosis: the numerical error, and what was left out."""
    omitted = [f"Left out: {name.replace('_', ' ')}: {why}." for name, why in diagnosis.left_out.items()]
    if diagnosis.numerics is None:
        return omitted
    own = []
    if diagnosis.numerics.fraction is not None:
        share = percent(diagnosis.numerics.fraction)
        own.append(f"The co-simulation's own error, by step halving, is {share} of the gap.")
    change, noise = diagnosis.numerics.replay_change, diagnosis.numerics.replay_noise
    if change is not None and noise is not None and change > noise:
        own.append(
            f"Halving the sub-steps changes the position by {1e3 * change:.2g} mm over complete runs that "
            "are replayed from their commands: the model with these effects goes another way in time, and "
            "what it leaves then was not held against them."
        )
    return [*own, *omitted]


def _digests(diagnosis: Diagnosis) -> str:
    sums = diagnosis.provenance.get("sha256") or {}
    return table(("file", "SHA-256"), [[name, one.removeprefix("sha256:")] for name, one in sums.items()])
