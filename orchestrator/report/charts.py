"""Charts of recorded signals, one per unit, and of the same signal of several runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..plotting.figures import draw_overlaid, draw_signals, svg
from ..plotting.page import SignalStore, note
from ..results.recorders import Results

HELP = (
    "Drag to zoom, shift-drag to pan, wheel to zoom at the pointer, double click or 0 for everything; values "
    "at the cursor stand in the legend, whose names switch signals on and off. All plots share one time axis."
)
# Of a chart's signals so many are shown at first, and so many points are drawn where scripts do not run.
_SHOWN, _POINTS = 6, 500
# A title names so many signals. A signal is flat where its range is a smaller part of the chart's than this.
_NAMED, _FLAT = 4, 0.04
# A chart with more signals than this is split.
_MOST = 24
# Names the arrays of the coupling's energies, whose instants are their own.
_COUPLING = "coupling"


def run_charts(store: SignalStore, results: Results, first: Sequence[str], share: float = 1.0) -> str:
    """All signals of a run, one chart per unit.

    Args:
        store: takes the signals.
        first: names of those that matter most: their charts come first, and show them.
        share: the part of the page's budget that they may take.
    """
    names = list(results.signals)
    if not names or not len(results):
        return note("No signal was recorded.")
    store.add(results, names, share=share)
    groups: dict[str, list[str]] = {}
    for name in sorted(names, key=lambda one: one not in first):
        groups.setdefault(results.units.get(name, ""), []).append(name)
    parts = []
    for unit, members in groups.items():
        for begin in range(0, len(members), _MOST):
            parts.append(_unit_chart(store, results, unit, members[begin : begin + _MOST]))
    return "\n".join(parts)


def _unit_chart(store: SignalStore, results: Results, unit: str, members: Sequence[str]) -> str:
    time, shown = store.key("time"), _comparable(results, members)
    series = [
        {"label": name, "x": time, "y": store.key(name), "shown": name in shown}
        for name in (*shown, *members)
    ]
    series = list({one["label"]: one for one in series}.values())
    plain = "without unit" if unit in ("", "1") else f"in {unit}"
    names = list(dict.fromkeys(name.partition("[")[0] for name in (*shown, *members)))
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    figure = draw_signals(results, "", shown, points=_POINTS)
    title = f"{', '.join(names[:_NAMED])}{more}, {plain}"
    return store.chart(title, unit, series, svg(figure, f"signals-{members[0]}"))


def _comparable(results: Results, members: Sequence[str]) -> list[str]:
    """The first signals that can be distinguished in one chart: none is flat beside another's range."""
    chosen: list[str] = []
    low, high, least = np.inf, -np.inf, np.inf
    for name in members:
        values = np.asarray(results[name], dtype=float)
        values = values[np.isfinite(values)]
        if not values.size:
            continue
        bottom, top = float(values.min()), float(values.max())
        spread = top - bottom
        span = max(high, top) - min(low, bottom)
        if spread > 0.0 and min(least, spread) >= _FLAT * span:
            chosen.append(name)
            low, high, least = min(low, bottom), max(high, top), min(least, spread)
        if len(chosen) == _SHOWN:
            break
    return chosen or list(members[:1])


def coupling_charts(store: SignalStore, coupling: Results, share: float) -> str:
    """Energies of power bonds over time: what the coupling created, and what was exchanged.

    Args:
        store: takes the energies.
        coupling: per bond `taken`, `given` and `created` [J].
        share: the part of the page's budget that they may take.
    """
    bonds = list(dict.fromkeys(name.rpartition(".")[0] for name in coupling.signals))
    # Of many bonds those that create most.
    bonds.sort(key=lambda bond: -float(np.abs(coupling[f"{bond}.created"]).max(initial=0.0)))
    created = [f"{bond}.created" for bond in bonds[:_MOST]]
    exchanged = [f"{bond}.{what}" for bond in bonds[: _MOST // 2] for what in ("taken", "given")]
    store.add(coupling, list(dict.fromkeys([*created, *exchanged])), _COUPLING, share)
    parts = []
    for title, names in (("Energy created by the coupling", created), ("Energy exchanged", exchanged)):
        series = [
            {
                "label": name,
                "x": store.key("time", _COUPLING),
                "y": store.key(name, _COUPLING),
                "shown": index < _SHOWN,
            }
            for index, name in enumerate(names)
        ]
        static = svg(draw_signals(coupling, "", names[:_SHOWN], points=_POINTS), f"coupling-{names[0]}")
        parts.append(store.chart(f"{title}, in J", "J", series, static))
    if len(bonds) > _MOST // 2:
        left = "bonds that create less are left out"
        parts.append(note(f"{left}; coupling.csv has all {len(bonds)}."))
    return "\n".join(parts)


def shared_charts(store: SignalStore, runs: Mapping[str, Results], first: Sequence[str]) -> str:
    """Signals that several runs have, one chart each.

    Args:
        first: names of those to show; if none of them is shared, the first of all.
    """
    counts: dict[str, int] = {}
    for results in runs.values():
        for name in results.signals:
            counts[name] = counts.get(name, 0) + 1
    shared = [name for name, count in counts.items() if count > 1]
    chosen = ([name for name in first if name in shared] or shared)[:_MOST]
    if not chosen:
        return note("The runs have no signal in common.")
    for run, results in runs.items():
        store.add(results, [name for name in chosen if name in results.signals], run, 1.0 / len(runs))
    parts = []
    for name in chosen:
        having = {run: results for run, results in runs.items() if name in results.signals}
        series = [
            {"label": run, "x": store.key("time", run), "y": store.key(name, run), "shown": True}
            for run in having
        ]
        unit = next(iter(having.values())).units.get(name, "")
        figure = draw_overlaid(having, name, points=_POINTS)
        parts.append(
            store.chart(f"{name} [{unit}]" if unit else name, unit, series, svg(figure, f"shared-{name}"))
        )
    left = len(shared) - len(chosen)
    if left > 0:
        parts.append(note(f"{left} more signals are shared; each run's own page has them."))
    return "\n".join(parts)
