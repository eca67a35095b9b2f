"""Figures of a diagnosis' report, as SVG to stand in a page."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...plotting.figures import COLORS, svg
from .finding import Augmented
from .motion import contacts
from .study import Array, Role, Run, Study
from .traces import CHANNEL_OF, Trace, traces

_TITLES = {
    "encoder_position": "robot position",
    "sensor_force": "contact force, as sensed",
    "compensated_force": "controller output",
    "body_force": "force that moves the satellite",
}
_BEFORE, _AFTER, _MEASURED = COLORS[1], COLORS[0], "#444444"
# What is shown around a contact, as a part of its length, and at the least [ticks].
_MARGIN, _FEWEST = 0.3, 25


def figure_of(study: Study, place: str, model: Augmented) -> tuple[str, str]:
    """Residuals of the signal in which a place shows, before and after, over a run and around one contact.

    Returns: the figure as SVG, and what it shows in words.
    """
    run = (study.of(Role.HELDOUT) or study.of(Role.TRAIN))[0]  # one that no fit saw, where there is one
    trace = traces(study, run, model)[CHANNEL_OF.get(place, "sensor_force")]
    first, last, number = _worst(study, run, trace)
    figure = Figure(figsize=(9.0, 4.4), layout="constrained")
    grid = figure.subplot_mosaic([["run", "run"], ["zoom", "left"]], height_ratios=[1.0, 1.7])
    scale, unit = _scale(trace)
    _draw_left(grid["run"], trace, slice(None), scale, unit)
    grid["run"].axvspan(trace.time[first], trace.time[last], color="#000000", alpha=0.07, linewidth=0)
    grid["run"].set_title(f"residual over {run.name}; shaded: enlarged below", fontsize="small", loc="left")
    span = slice(first, last + 1)
    axes = grid["zoom"]
    size, size_unit = _scale(trace, trace.measured)
    for values, color, width, label in (
        (trace.measured, _MEASURED, 2.6, "logged"),
        (trace.before, _BEFORE, 1.3, "before: model as calibrated"),
        (trace.after, _AFTER, 1.3, "after: model of the verdict"),
    ):
        axes.plot(trace.time[span], size * values[span], color=color, linewidth=width, label=label)
    axes.set_title(
        _TITLES[trace.name] + (f", contact {number}" if number else ""), fontsize="small", loc="left"
    )
    axes.set_ylabel(f"[{size_unit}]")
    _draw_left(grid["left"], trace, span, scale, unit)
    _finish(figure, grid)
    before, after = trace.misfit()
    words = (
        f"{_TITLES[trace.name].capitalize()} in {run.name}: the residual is {before:.3g} times the noise "
        f"before and {after:.3g} times after (1: nothing but noise)."
    )
    return svg(figure, f"{place}-{run.name}"), words


def _finish(figure: Figure, grid: Mapping[str, Axes]) -> None:
    """Grid lines, ticks, axis titles and legend of a figure's parts: the run, what is enlarged, the residual.

    One legend stands for all parts, below them: within one it would cover traces.
    """
    grid["left"].set_title("residual: logged minus model", fontsize="small", loc="left")
    for name in ("run", "zoom", "left"):
        grid[name].grid(alpha=0.25)
        grid[name].tick_params(labelsize="x-small")
        grid[name].yaxis.get_offset_text().set_fontsize("x-small")
    for name in ("zoom", "left"):
        grid[name].set_xlabel("time [s]", fontsize="small")
    handles = [one for name in ("zoom", "left") for one in grid[name].get_legend_handles_labels()[0]]
    figure.legend(handles=handles, loc="outside lower center", fontsize="x-small", ncols=4, frameon=False)


def _worst(study: Study, run: Run, trace: Trace) -> tuple[int, int, int]:
    """First and last row of the contact with the largest residual, and its number; 0 without contacts."""
    left = np.square(trace.measured - trace.before)
    found = [(one.first, one.last) for one in contacts(study, run) if one.last < len(left)]
    if not found:
        return 0, len(left) - 1, 0
    number = int(np.argmax([left[first : last + 1].sum() for first, last in found]))
    first, last = found[number]
    margin = max(round(_MARGIN * (last - first)), _FEWEST)
    return max(first - margin, 0), min(last + margin, len(left) - 1), number + 1


def _scale(trace: Trace, values: Array | None = None) -> tuple[float, str]:
    """Factor and unit in which numbers are of the order of one."""
    largest = float(np.max(np.abs(trace.measured - trace.before if values is None else values), initial=0.0))
    if trace.unit != "m":
        return 1.0, trace.unit
    return (1e6, "um") if largest < 1e-3 else (1e3, "mm")


def _draw_left(axes: Axes, trace: Trace, span: slice, scale: float, unit: str) -> None:
    time = trace.time[span]
    axes.axhspan(
        -2 * scale * trace.noise, 2 * scale * trace.noise, color=COLORS[2], alpha=0.15, linewidth=0,
        label="band: noise, two standard deviations",
    )  # fmt: skip
    for model, color in ((trace.before, _BEFORE), (trace.after, _AFTER)):
        axes.plot(time, scale * (trace.measured - model)[span], color=color, linewidth=0.9)
    axes.set_ylabel(f"[{unit}]")
