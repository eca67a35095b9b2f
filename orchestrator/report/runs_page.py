"""The page of several runs side by side."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Any

from ..plotting.figures import encoded
from ..plotting.page import SignalStore, aside, details, document, figure, heading, note, provenance, table
from .charts import HELP, shared_charts
from .folder import RunFolder, State
from .numbers import measure_tables, spelt
from .run_page import BUDGET, measured, sentence


def page(runs: Sequence[RunFolder], budget: int = BUDGET, notes: Sequence[str] = ()) -> str:
    """The page as HTML.

    Args:
        runs: two or more, with names of their own.
        budget: what the signals may take in it [B].
        notes: to be reported with it.
    """
    done = sum(run.state is State.DONE for run in runs)
    outcome = f"{len(runs)} runs, {'all' if done == len(runs) else done} done."
    store = SignalStore(budget)
    having = {run.name: run.results for run in runs if run.results is not None and len(run.results)}
    first = list(dict.fromkeys(name for run in runs for one in run.measures for name in one.signals()))
    charts = shared_charts(store, having, first) if having else ""
    parts = [
        f"<p class=headline>{escape(outcome)}</p>",
        aside("To know", notes),
        table(
            ["run", "state", "in a sentence"],
            [[run.name, run.state.value, sentence(run)] for run in runs],
            keys=[run.name for run in runs],
        ),
        heading("Key numbers", "numbers"),
        _numbers(runs),
        *_figures(runs),
        heading("Signals", "signals"),
        f"<p class='note help needs-script'>{escape(HELP)}</p>",
        *(note(one) for one in store.notes),
        charts,
    ]
    for run in runs:
        for key, content in measure_tables(run.summary, run.units):
            parts.append(details(f"{run.name}: {spelt(key)}", content))
    for run in runs:
        if run.config is not None:
            parts.append(details(f"{run.name}: config as run", f"<pre>{escape(run.config.text())}</pre>"))
    kept = next((run.summary["provenance"] for run in runs if "provenance" in run.summary), {})
    parts.append(provenance(kept))
    return document(f"Comparison of {len(runs)} runs", parts, store.data() if having else None)


def _numbers(runs: Sequence[RunFolder]) -> str:
    """One line per run, one column per number; under it what half the step size changes."""
    found = [measured(run) for run in runs]
    names = list(dict.fromkeys(name for one in found for name in one))
    columns = ["run", "master", "step [s]", "wall time [s]"]
    for name in names:
        unit = next(one[name].unit for one in found if name in one)
        columns.append(f"{spelt(name)} [{unit}]" if unit else spelt(name))
    rows: list[list[Any]] = []
    for run, one in zip(runs, found, strict=True):
        about = run.summary.get("run") or {}
        rows.append([run.name, about.get("master"), about.get("step_size"), about.get("wall_time")])
        rows[-1] += [one[name].value if name in one else None for name in names]
    changes = [
        [run.name, *(one[name].change if name in one else None for name in names)]
        for run, one in zip(runs, found, strict=True)
    ]
    drawn = table(columns, rows, keys=[f"numbers.{run.name}" for run in runs])
    if names:
        heads = ["run", *(spelt(name) for name in names)]
        drawn += details("Change of each at half the step size", table(heads, changes))
    return drawn


def _figures(runs: Sequence[RunFolder]) -> list[str]:
    """What the measures that runs have in common draw of them together."""
    drawn = []
    for name in dict.fromkeys(one.name for run in runs for one in run.measures):
        having = {
            run.name: (run.results, one)
            for run in runs
            for one in run.measures
            if one.name == name and run.state is State.DONE and run.results is not None
        }
        measure = next((one.measure for _, one in having.values()), None)
        if len(having) < 2 or not hasattr(measure, "comparison"):
            continue
        both = {run: (results, one.options) for run, (results, one) in having.items()}
        for key, made in measure.comparison(both).items():
            image = f'<img alt="{escape(key)}" src="data:image/png;base64,{encoded(made)}">'
            drawn.append(figure(image, f"Measure {name}: all runs", f"figure-{key}"))
    return drawn
