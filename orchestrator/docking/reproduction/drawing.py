"""Figures of several runs on one pair of axes, free flight cut out."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from matplotlib.figure import Figure

from ...plotting.figures import COLORS
from ..figures import contact_time
from .experiment import Recorded

_DASHES = ("-", "--", ":", "-.")
_TIME = "time in contact, free flight cut out [s]"


def sheet(x: str, y: str) -> tuple[Figure, Any]:
    """A figure with one pair of axes and their labels."""
    figure = Figure(figsize=(9.0, 4.2), layout="constrained")
    axes = figure.subplots()
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(alpha=0.3)
    return figure, axes


def velocities(runs: Mapping[str, Recorded], contacts: int) -> Figure:
    """Relative velocity of the satellites in the first contacts of several runs, by label."""
    figure, axes = sheet(_TIME, "relative velocity [mm/s]")
    over_contact_time(axes, {label: (run, run.velocity * 1e3) for label, run in runs.items()}, contacts)
    return figure


def forces(runs: Mapping[str, Recorded], contacts: int) -> Figure:
    """Contact force in the first contacts of several runs, by label."""
    figure, axes = sheet(_TIME, "contact force [N]")
    over_contact_time(axes, {label: (run, run.force) for label, run in runs.items()}, contacts)
    return figure


def stacked(upper: str, lower: str) -> tuple[Figure, Any, Any]:
    """A figure of two pairs of axes over time in contact, and their labels."""
    figure = Figure(figsize=(9.0, 6.4), layout="constrained")
    first, second = figure.subplots(2, 1, sharex=True)
    for axes, label in ((first, upper), (second, lower)):
        axes.set_ylabel(label)
        axes.grid(alpha=0.3)
    second.set_xlabel(_TIME)
    return figure, first, second


def over_contact_time(axes: Any, lines: Mapping[str, tuple[Recorded, Any]], contacts: int) -> None:
    """Draw a signal of each run, by label, over the time in its first contacts."""
    for index, (label, (run, signal)) in enumerate(lines.items()):
        style = {"color": COLORS[index % len(COLORS)], "linewidth": 1.4}
        style["linestyle"] = _DASHES[index % len(_DASHES)]

        for number, (time, rows) in enumerate(contact_time(run.results, run.found[:contacts])):
            axes.plot(time, signal[rows], label=label if number == 0 else None, **style)
    if len(lines) > 1:
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize="small")
