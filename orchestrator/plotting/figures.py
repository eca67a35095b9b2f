"""Figures of any system's results, drawn without pyplot: no window system, no global state."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from ..results.recorders import Results

# Okabe and Ito's palette: distinguished with any colour vision, and dark enough on white.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
_DASHES = ("-", "--", ":", "-.")
_MOST_LINES = len(COLORS) * 2
_MOST_AXES = 12
_MOST_POINTS = 20_000


def draw_signals(
    results: Results, title: str = "", names: Sequence[str] | None = None, points: int = _MOST_POINTS
) -> Figure:
    """All real signals over time, one pair of axes for each unit.

    Args:
        results: of a run.
        title: stands above.
        names: signals to draw; all floating-point ones by default.
        points: longer signals are thinned, lowest and highest values kept.
    """
    names = [n for n, kind in results.types.items() if kind.kind == "f"] if names is None else list(names)
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(results.units.get(name, ""), []).append(name)
    shown = list(groups.items())[:_MOST_AXES]
    figure = Figure(figsize=(9.0, 1.2 + 2.2 * max(len(shown), 1)), layout="constrained")
    all_axes = figure.subplots(max(len(shown), 1), 1, sharex=True, squeeze=False)[:, 0]
    instants = results.time
    for axes, (unit, members) in zip(all_axes, shown, strict=False):
        for index, name in enumerate(members[:_MOST_LINES]):
            time, values = _thinned(instants, results[name], points)
            dash = _DASHES[index // len(COLORS)]
            # Each line is thinner than the one below it, so that equal signals can both be seen.
            width = max(0.8, 2.6 - 0.5 * index)
            axes.plot(time, values, dash, color=COLORS[index % len(COLORS)], linewidth=width, label=name)
        left_out = len(members) - _MOST_LINES
        label = f"{len(members)} signals, {left_out} not drawn" if left_out > 0 else None
        axes.set_ylabel(f"[{unit}]" if unit else "no unit")
        axes.grid(alpha=0.3)
        axes.legend(
            loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize="small", title=label
        )
    all_axes[-1].set_xlabel("time [s]")
    left_out = len(groups) - len(shown)
    figure.suptitle(title + (f" ({left_out} further units not drawn)" if left_out > 0 else ""))
    return figure


def draw_coupling(coupling: Results, title: str = "") -> Figure:
    """Energies of power bonds over time: what was exchanged above, what the coupling created below.

    Args:
        coupling: per bond `taken`, `given` and `created` [J].
        title: stands above.
    """
    bonds = list(dict.fromkeys(name.rpartition(".")[0] for name in coupling.signals))
    # Of many bonds those that create most.
    bonds.sort(key=lambda name: -float(np.abs(coupling[f"{name}.created"]).max(initial=0.0)))
    figure = Figure(figsize=(9.0, 5.6), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    for name, color in zip(bonds, COLORS, strict=False):
        for what, dash, width in (("taken", "-", 2.2), ("given", "--", 1.2)):
            time, values = _thinned(coupling.time, coupling[f"{name}.{what}"])
            upper.plot(time, values, dash, color=color, linewidth=width, label=f"{name}, {what}")
        time, values = _thinned(coupling.time, coupling[f"{name}.created"])
        lower.plot(time, values, color=color, linewidth=1.6, label=name)
    upper.set_ylabel("energy [J]")
    lower.set_ylabel("created by the coupling [J]")
    lower.set_xlabel("time [s]")
    left_out = len(bonds) - len(COLORS)
    for axes in (upper, lower):
        axes.grid(alpha=0.3)
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize="small")
    figure.suptitle(title + (f" ({left_out} further bonds not drawn)" if left_out > 0 else ""))
    return figure


def draw_punctuality(realtime: Mapping[str, Any], step_size: float, title: str = "") -> Figure:
    """How late the steps of a paced run began, and how long they took.

    Args:
        realtime: from a summary, with histograms.
        step_size: of communication [s].
        title: stands above.
    """
    figure = Figure(figsize=(9.0, 4.2), layout="constrained")
    axes = figure.subplots()
    for (key, label), color in zip(
        (("latency", "from deadline to begin of step"), ("busy", "from begin to end of step")),
        COLORS,
        strict=False,
    ):
        found = realtime[key]["histogram"]
        if found["counts"]:
            axes.stairs(found["counts"], found["edges"], color=color, linewidth=1.8, label=label)
    axes.axvline(
        step_size / realtime["speed"], color="black", linestyle="--", linewidth=1.0, label="time per step"
    )
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_ylim(bottom=0.5)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("steps")
    axes.grid(alpha=0.3)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize="small")
    figure.suptitle(f"{title}: {realtime['missed']} of {realtime['steps']} deadlines missed".lstrip(": "))
    return figure


def _thinned(
    time: np.ndarray, values: np.ndarray, points: int = _MOST_POINTS
) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest value of each short stretch: no peak is lost, and long runs draw fast."""
    width = len(time) // points
    if width < 2:
        return time, values
    whole = len(time) // width * width
    blocks = values[:whole].reshape(-1, width)
    starts = np.arange(0, whole, width)
    pairs = np.sort(
        np.stack([starts + blocks.argmin(axis=1), starts + blocks.argmax(axis=1)], axis=1), axis=1
    )
    rows = np.unique(np.concatenate([[0], pairs.ravel(), [len(time) - 1]]))
    return time[rows], values[rows]


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG."""
    _written(figure, path, dpi=150)


def _written(figure: Figure, target: Any, **options: Any) -> None:
    # Margins around what a diverging run reached are beyond the range of numbers: those axes end there.
    with np.errstate(over="ignore", invalid="ignore"):
        figure.savefig(target, **options)


def encoded(figure: Figure | Path, dpi: int = 110) -> str:
    """A figure, or a PNG file, in base 64, to stand in a page."""
    if isinstance(figure, Path):
        return base64.b64encode(figure.read_bytes()).decode("ascii")
    memory = io.BytesIO()
    _written(figure, memory, format="png", dpi=dpi)
    return base64.b64encode(memory.getvalue()).decode("ascii")


def svg(figure: Figure, name: str) -> str:
    """A figure as SVG text; the same figure gives the same bytes, and names do not clash within a page."""
    stream = io.StringIO()
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": name, "path.simplify": True}):
        _written(figure, stream, format="svg", metadata={"Date": None})
    text = stream.getvalue()
    return text[text.index("<svg") :]


def draw_overlaid(runs: Mapping[str, Results], name: str, points: int = _MOST_POINTS) -> Figure:
    """One signal of several runs over time.

    Args:
        runs: that have it, by name.
        points: longer signals are thinned, lowest and highest values kept.
    """
    figure = Figure(figsize=(9.0, 3.2), layout="constrained")
    axes = figure.subplots()
    unit = next(iter(runs.values())).units.get(name, "")
    for index, (run, results) in enumerate(runs.items()):
        time, values = _thinned(results.time, results[name], points)
        dash = _DASHES[index // len(COLORS) % len(_DASHES)]
        axes.plot(time, values, dash, color=COLORS[index % len(COLORS)], linewidth=1.4, label=run)
    axes.set_ylabel(f"[{unit}]" if unit else "no unit")
    axes.set_xlabel("time [s]")
    axes.grid(alpha=0.3)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize="small")
    return figure


def draw_points(
    lines: Mapping[str, tuple[Sequence[float], Sequence[float]]], x_label: str, y_label: str
) -> Figure:
    """Points of one quantity over another, joined within each line where there are several.

    Args:
        lines: x and y by name.
    """
    figure = Figure(figsize=(9.0, 3.2), layout="constrained")
    axes = figure.subplots()
    for index, (name, (x, y)) in enumerate(lines.items()):
        dash = _DASHES[index // len(COLORS) % len(_DASHES)] if len(lines) > 1 else ""
        axes.plot(x, y, dash, marker="o", markersize=4, color=COLORS[index % len(COLORS)], label=name)
    axes.set_xlabel(x_label)
    axes.set_ylabel(y_label)
    axes.grid(alpha=0.3)
    if len(lines) > 1:
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize="small")
    return figure
