"""A chart of stability as text, as data and as a figure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.arrays import Array, Complex


@dataclass(frozen=True)
class Chart:
    """Stability over two parameters.

    Attributes:
        x_name, y_name, x_unit, y_unit: of the axes.
        x, y: shapes (nx,), (ny,).
        unstable: number of roots that grow, shape (ny, nx).
        root: dominant root, exact to some digits, shape (ny, nx) [rad/s]; between points of the coarse grid,
            away from the border, interpolated.
        border: lines between stable and unstable, each of shape (k, 3): x, y, frequency there [Hz].
        sampled: whether it is the co-simulation with its step, or the machine.
        here: x and y of the config; None if not known.
        evaluations: how many systems were linearised or sampled.
    """

    x_name: str
    y_name: str
    x_unit: str
    y_unit: str
    x: Array
    y: Array
    unstable: NDArray[np.int64]
    root: Complex
    border: tuple[Array, ...]
    sampled: bool = False
    here: tuple[float, float] | None = None
    evaluations: int = 0

    @property
    def stable(self) -> NDArray[np.bool_]:
        """Where no root grows, shape (ny, nx)."""
        return self.unstable == 0


def chart_text(found: Chart) -> str:
    """The chart in lines for terminals."""
    what = "co-simulation" if found.sampled else "machine"
    share = 100.0 * float(np.mean(found.stable))
    lines = [f"{what} over {found.x_name} and {found.y_name}: stable in {share:.3g} % of the chart"]
    for line in found.border:
        (x0, y0), (x1, y1) = line[0, :2], line[-1, :2]
        lines.append(
            f"  border from {x0:.5g} {found.x_unit}, {y0:.5g} {found.y_unit} to {x1:.5g} {found.x_unit}, "
            f"{y1:.5g} {found.y_unit}; {line[:, 2].min():.4g} to {line[:, 2].max():.4g} Hz"
        )
    return "\n".join(lines)


def chart_data(found: Chart) -> dict[str, Any]:
    """The chart for JSON: axes, counts, dominant root's real part and frequency, border lines."""
    return {
        "x": {"parameter": found.x_name, "unit": found.x_unit, "values": found.x.tolist()},
        "y": {"parameter": found.y_name, "unit": found.y_unit, "values": found.y.tolist()},
        "sampled": found.sampled,
        "unstable": found.unstable.tolist(),
        "border": [line.tolist() for line in found.border],
        "config": found.here,
        "evaluations": found.evaluations,
    }


def chart_figure(found: Chart, points: Mapping[str, tuple[float, float]] | None = None) -> Any:
    """The dominant root's real part as colours, the border, and the config.

    Args:
        points: further points, x and y by name.
    """
    from matplotlib.figure import Figure

    from ..plotting.figures import COLORS

    figure = Figure(figsize=(7.5, 5.0), layout="constrained")
    axes = figure.subplots()
    values, label = found.root.real, "real part of the dominant root [1/s]"
    limit = float(np.nanpercentile(abs(values), 95)) or 1.0
    mesh = axes.pcolormesh(
        found.x, found.y, values, cmap="RdBu_r", vmin=-limit, vmax=limit, shading="nearest", rasterized=True
    )
    figure.colorbar(mesh, ax=axes, label=label, extend="both")
    for index, line in enumerate(found.border):
        axes.plot(
            line[:, 0],
            line[:, 1],
            color="black",
            linewidth=2.0,
            label=None if index else "border of stability",
        )
    marks = ({"this config": found.here} if found.here else {}) | dict(points or {})
    for index, (name, (px, py)) in enumerate(marks.items()):
        if found.x[0] <= px <= found.x[-1] and found.y[0] <= py <= found.y[-1]:
            axes.plot(
                [px],
                [py],
                "osvD^"[index % 5],
                color="black",
                markerfacecolor=COLORS[(index + 1) % len(COLORS)],
                markersize=8,
                label=name,
                linestyle="",
                clip_on=False,
                zorder=5,
            )
    axes.set_xlabel(f"{found.x_name} [{found.x_unit or '1'}]")
    axes.set_ylabel(f"{found.y_name} [{found.y_unit or '1'}]")
    axes.set_title("co-simulation with its step" if found.sampled else "machine", fontsize="medium")
    if axes.get_legend_handles_labels()[0]:
        figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure
