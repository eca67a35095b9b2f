"""The page of one run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from html import escape
from typing import Any

from ..base.errors import OrchestratorError, listed
from ..base.text_tables import remarks
from ..plotting.figures import encoded
from ..plotting.page import (
    SignalStore,
    aside,
    card,
    details,
    document,
    figure,
    heading,
    note,
    number,
    provenance,
    table,
)
from .charts import HELP, coupling_charts, run_charts
from .folder import RunFolder, State
from .graph_svg import draw_graph, links_of
from .numbers import KeyNumber, coupling_table, key_numbers, measure_tables, spelt
from .punctuality import punctuality

# What the signals may take in a page by default [B], and the part of it that the coupling's energies take.
BUDGET = 8_000_000
_COUPLING = 0.2


def _remarks(summary: Mapping[str, Any]) -> list[str]:
    return [*summary.get("notes", ()), *remarks(summary)] if summary else []


def page(run: RunFolder, budget: int = BUDGET, notes: Sequence[str] = ()) -> str:
    """The page as HTML.

    Args:
        budget: what the signals may take in it [B].
        notes: to be reported with it.
    """
    store = SignalStore(budget)
    charts = energies = ""
    if run.coupling is not None:
        energies = coupling_charts(store, run.coupling, _COUPLING)
    if run.results is not None:
        first = [name for one in run.measures for name in one.signals()]
        charts = run_charts(store, run.results, first, 1.0 - _COUPLING if energies else 1.0)
    summary = run.summary
    parts = [
        f"<p class=headline>{escape(sentence(run))}</p>",
        _error(summary),
        aside("To know", [*notes, *run.missing, *_remarks(summary)]),
        "<div class=cards>",
        card("Key numbers", _numbers(run)),
        card("The run", _about(run)),
        "</div>",
    ]
    for key, content in measure_tables(summary, run.units):
        parts += [heading(spelt(key).capitalize(), key), content]
    if ledger := coupling_table(summary):
        parts += [
            heading("Coupling ledger", "coupling"),
            note(
                "What holding inputs over communication steps adds to the energy that a power bond exchanges."
            ),
            ledger,
            energies,
        ]
    parts += [*punctuality(summary.get("run") or {}, run.title), _motion(run, store), *_graph(run)]
    if charts:
        parts += [heading("Signals", "signals"), f"<p class='note help needs-script'>{escape(HELP)}</p>"]
        parts += [note(one) for one in store.notes] or [note(_whole(run))]
        parts.append(charts)
    parts += [*_figures(run), *_folded(run)]
    return document(run.title, parts, store.data() if charts or energies else None)


def sentence(run: RunFolder) -> str:
    """How the run ended, and what its measures say."""
    sentences = [verdict(run)]
    for one in run.measures:
        headline = getattr(one.measure, "headline", None)
        try:
            if callable(headline) and run.state is State.DONE:
                sentences.append(headline(run.summary))
        except (KeyError, TypeError, ValueError):
            continue  # of another version, or of a run whose measures failed: its numbers stand below
    return " ".join(sentences)


def verdict(run: RunFolder) -> str:
    """How the run ended."""
    about = run.summary.get("run") or {}
    reached = _reached(run)
    if run.state is State.DONE:
        return f"Done: {reached:g} s in {about['steps']} steps of {_time(about['step_size'])}."
    if run.state is State.FAILED:
        return f"Failed at {reached:g} s: {run.summary['error']['message'].splitlines()[0]}"
    if run.state is State.INTERRUPTED:
        return f"Interrupted at {reached:g} s; what was recorded until then is here."
    if run.state is State.RUNNING:
        return f"Still running: recorded up to {reached:g} s so far."
    return (
        f"Killed at {reached:g} s or shortly after, without a summary; what was recorded until then is here."
    )


def measured(run: RunFolder) -> dict[str, KeyNumber]:
    """Key numbers by name."""
    return {one.name: one for one in key_numbers(run.summary, run.units)}


def _reached(run: RunFolder) -> float:
    return float(run.results.time[-1]) if run.results is not None and len(run.results) else 0.0


def _time(seconds: float) -> str:
    return f"{1e3 * seconds:g} ms" if seconds < 0.1 else f"{seconds:g} s"


def _error(summary: Mapping[str, Any]) -> str:
    error = summary.get("error")
    if not error:
        return ""
    log = "".join(f"<li>{escape(str(line))}</li>" for line in error.get("log") or [])
    more = f"<ul>{log}</ul>" if log else ""
    return f"<div class=error role=alert>{escape(error['message'])}{more}</div>"


def _numbers(run: RunFolder) -> str:
    found = key_numbers(run.summary, run.units)
    signals = (run.summary.get("numerics") or {}).get("signals") or {}
    matter = {name for one in run.measures for name in one.signals()} or set(signals)
    changed = [
        (one["relative"], name)
        for name, one in signals.items()
        if name in matter and one["relative"] is not None
    ]
    worst = ""
    if changed:
        share, name = max(changed)
        worst = note(
            f"Of the measured signals, half the step changes {name} most: by {share:.2g} of its range."
        )
    if not found:
        text = "The config names no measures that give single numbers."
        if run.measures and run.state is not State.DONE:
            how = "has not ended yet" if run.state is State.RUNNING else "did not come to its end"
            text = f"{listed(one.name for one in run.measures)}: not computed, since the run {how}."
        return (worst or "") + note(text)
    rows = [
        [spelt(one.name), one.value, one.unit, None if one.change is None else float(f"{one.change:.1e}")]
        for one in found
    ]
    return (
        table(["", "value", "unit", "change at half the step"], rows, keys=[one.name for one in found])
        + worst
    )


def _about(run: RunFolder) -> str:
    about = run.summary.get("run") or {}
    rows: list[list[Any]] = []
    if run.config is not None and not about:
        model = run.config.model.run
        rows = [["master", model.master_name], ["step size", model.step_size], ["stop time", model.stop_time]]
    if about:
        rows = [
            ["master", about["master"]],
            ["step size", _time(about["step_size"])],
            ["steps", about["steps"]],
            ["loop", about.get("loop")],
            ["wall time", f"{about['wall_time']:.3g} s"],
            [
                "of it stepping",
                f"{about['stepping_time']:.3g} s, {about['real_time_factor']:.3g} times real time",
            ],
        ]
    if run.config is not None:
        model = run.config.model
        rows.append(["system", f"{len(model.instances)} instances, {len(model.connections)} connections"])
    if run.results is not None:
        rows.append(["recorded", f"{len(run.results)} instants of {len(run.results.signals)} signals"])
    rows.append(["folder", run.name])
    body = "".join(f"<tr><td>{escape(a)}</td><td>{escape(number(b))}</td></tr>" for a, b in rows)
    return f"<table class=facts>{body}</table>"


def _whole(run: RunFolder) -> str:
    count = len(run.results) if run.results is not None else 0
    return f"The plots hold every recorded instant ({count}) to seven digits; results.arrow has all of them."


def _motion(run: RunFolder, store: SignalStore) -> str:
    """The view of motion, where a measure knows what moves."""
    if run.results is None or len(run.results) < 2:
        return ""
    for one in run.measures:
        draw = getattr(one.measure, "scene", None)
        try:
            scene = draw(run.results, one.options) if callable(draw) else None
        except KeyError:
            continue  # a run that failed before its parameters were written
        if scene and all(name in store for name in _names(scene)):
            store.set_scene(scene)
            return _player(bool(scene["bodies"]))
    return ""


def _names(scene: Any) -> Iterator[str]:
    """All signals that a scene reads."""
    poses = [*scene["tip"].values(), *scene["bodies"]]
    lists = [
        pose.get(kind) or []
        for pose in poses
        if isinstance(pose, Mapping)
        for kind in ("position", "orientation")
    ]
    for names in (*lists, scene["force"]):
        yield from (name for name in names if name is not None)


def _player(bodies: bool) -> str:
    views = '<option value="tip">rod tip, from the target</option>'
    factor = ""
    if bodies:
        views += '<option value="bodies">both satellites</option>'
        options = "".join(f'<option value="{one}">motion x {one}</option>' for one in (1, 5, 20))
        factor = (
            f'<select name="factor" aria-label="enlargement of the satellites\' motion">{options}</select>'
        )
    speeds = "".join(
        f'<option value="{one}"{" selected" if one == 0.25 else ""}>{one:g} x real time</option>'
        for one in (0.02, 0.1, 0.25, 1.0)
    )
    return (
        '<div class="needs-script">' + heading("Motion", "motion") + "<div class=scene id=scene>"
        '<canvas tabindex="0" role="img" aria-label="docking motion; arrow keys turn the view, plus and '
        'minus zoom, space plays"></canvas><div class=player><button type=button class=play>Play</button>'
        '<input type=range min=0 max=1 value=0 step=1 aria-label="time"><output></output>'
        f'<select name="speed" aria-label="speed">{speeds}</select>'
        f'<select name="view" aria-label="view">{views}</select>{factor}</div></div>'
        + note("Drag to turn, wheel to zoom. The arrow at the tip is the contact force.")
        + "</div>"
    )


def _graph(run: RunFolder) -> list[str]:
    if run.config is None:
        return []
    model, units = run.config.model, dict(run.results.units) if run.results is not None else {}
    drawn = draw_graph(model, units)
    rows = [
        [
            " + ".join(".".join(one) for one in link.sources),
            ".".join(link.target),
            link.unit(units),
            link.effects,
        ]
        for link in links_of(model)
    ]
    listed = details(f"The {len(rows)} connections", table(["from", "to", "unit", "through"], rows))
    shown = f"<div class=graph>{drawn}</div>" if drawn else note("The system is too large to be drawn.")
    return [heading("System", "system"), shown, listed]


def _figures(run: RunFolder) -> list[str]:
    """The measures' own figures; none of a run that failed."""
    if run.results is None or run.state is not State.DONE:
        return []
    drawn: list[str] = []
    for one in run.measures:
        try:
            figures = one.measure.figures(run.results, one.options)
        except Exception as error:  # whatever a measure trips over, the rest of the page is worth having
            raise OrchestratorError(f"figures of measure {one.name} failed: {error}") from error
        for name, made in figures.items():
            image = f'<img alt="{escape(name)}" src="data:image/png;base64,{encoded(made, 90)}">'
            drawn.append(figure(image, name.capitalize(), f"figure-{name}"))
    return [details(f"The {len(drawn)} figures of the measures", "".join(drawn))] if drawn else []


def _folded(run: RunFolder) -> list[str]:
    parts = []
    signals = (run.summary.get("numerics") or {}).get("signals") or {}
    if signals:
        rows = [[name, one["max_change"], one["relative"]] for name, one in signals.items()]
        columns = ["signal", "largest change", "over its range"]
        parts.append(details("Change of every signal at half the step size", table(columns, rows)))
    if run.results is not None and run.results.parameters:
        rows = [[name, value] for name, value in run.results.parameters.items()]
        parts.append(details("Parameters and start values", table(["parameter", "value"], rows)))
    if run.config is not None:
        parts.append(details("Config as run", f"<pre>{escape(run.config.text())}</pre>"))
    kept = run.summary.get("provenance") or (dict(run.results.provenance) if run.results is not None else {})
    fmus = [
        [name, one.get("model"), one.get("file"), one.get("fmi_version"), one.get("checksum")]
        for name, one in (kept.get("fmus") or {}).items()
    ]
    more = table(["instance", "model", "file", "FMI", "checksum"], fmus) if fmus else ""
    parts.append(provenance(kept, more))
    return parts
