"""Figures of loops: Bode, Nyquist, Nichols, characteristic roots, stability charts, steps of the master."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from ..plotting.figures import COLORS
from .charts import Chart
from .gain import verdict
from .margins import margins
from .points import source_points
from .roots import Roots
from .sampled import SampledLoop
from .spans import span
from .tones import Measured
from .transfer import Array, Transfer

__all__ = ["bode", "nichols", "nyquist", "root_map", "stability_chart", "step_chart"]

_GREY = "#666666"
# Least range of a phase axis [deg].
_LEAST_PHASE = 10.0
_DASHES = ("-", "--", "-.", ":")
# Parameters as they stand on axes: factor from SI and unit, by the end of the name.
_UNITS = {
    "tau_m": (1e3, "ms"),
    "tau_s": (1e3, "ms"),
    "omega_n": (0.5 / np.pi, "Hz"),
    "stiffness": (1e-3, "N/mm"),
    "stiffness_estimate": (1e-3, "N/mm"),
    "damping": (1.0, "N.s/m"),
    "damping_estimate": (1.0, "N.s/m"),
    "mass": (1.0, "kg"),
    "xi_n": (1.0, "1"),
    "cutoff": (1.0, "Hz"),
    "sample_period": (1e3, "ms"),
    "step_size": (1e3, "ms"),
}


def bode(
    loops: Mapping[str, Transfer], omega: Array | None = None, measured: Mapping[str, Measured] | None = None
) -> Figure:
    """Magnitude and phase of loops or plants over frequency, measured responses as points."""
    figure = Figure(figsize=(8.0, 6.0), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    for index, (name, loop) in enumerate(loops.items()):
        w = _shown(loop) if omega is None else omega
        value = loop(1j * w)
        style = {"color": COLORS[index % len(COLORS)], "linestyle": _DASHES[index % 4]}
        upper.semilogx(w / (2 * np.pi), 20 * np.log10(np.abs(value)), label=name, **style)
        lower.semilogx(w / (2 * np.pi), _phase(value), **style)
    for index, (name, one) in enumerate((measured or {}).items()):
        style = {
            "color": COLORS[(index + len(loops)) % len(COLORS)],
            "marker": "o",
            "linestyle": "",
            "markersize": 4,
        }
        upper.semilogx(one.omega / (2 * np.pi), 20 * np.log10(np.abs(one.response)), label=name, **style)
        lower.semilogx(one.omega / (2 * np.pi), _phase(one.response), **style)
    upper.axhline(0.0, color=_GREY, linewidth=0.8)
    lower.axhline(-180.0, color=_GREY, linewidth=0.8)
    upper.set_ylabel("magnitude [dB]")
    lower.set_ylabel("phase [deg]")
    lower.set_xlabel("frequency [Hz]")
    for axes in (upper, lower):
        axes.grid(alpha=0.3)
    lower.ticklabel_format(axis="y", useOffset=False)
    low, high = lower.get_ylim()
    # A compensated loop's phase is -180 deg to rounding, which is not to fill the axes.
    if high - low < _LEAST_PHASE:
        middle = 0.5 * (low + high)
        lower.set_ylim(middle - 0.5 * _LEAST_PHASE, middle + 0.5 * _LEAST_PHASE)
    _plain(lower)
    upper.legend()
    return figure


def nyquist(loops: Mapping[str, Transfer], growth: Mapping[str, float] | None = None) -> Figure:
    """L(j w) around -1, with the circle that the modulus margin leaves free.

    Args:
        growth: of the velocity per contact, where it is known; says which loops are on the border.
    """
    figure = Figure(figsize=(6.5, 6.0), layout="constrained")
    axes = figure.subplots()
    for index, (name, loop) in enumerate(loops.items()):
        value, margin = loop(1j * span(loop)), margins(loop)
        color = COLORS[index % len(COLORS)]
        near = np.abs(value) < 20.0
        axes.plot(
            value.real[near],
            value.imag[near],
            _DASHES[index % 4],
            color=color,
            label=f"{name}: {verdict(margin.unstable, (growth or {}).get(name))}",
        )
        turn = np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 200))
        circle = -1.0 + margin.modulus_margin * turn
        axes.plot(circle.real, circle.imag, ":", color=color, linewidth=0.9)
    unit = np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 400))
    axes.plot(unit.real, unit.imag, color=_GREY, linewidth=0.6)
    axes.plot([-1.0], [0.0], "+", color="black", markersize=12)
    axes.set_xlim(-2.2, 1.2)
    axes.set_ylim(-1.7, 1.7)
    axes.set_aspect("equal")
    axes.set_xlabel("real part of L [1]")
    axes.set_ylabel("imaginary part of L [1]")
    axes.grid(alpha=0.3)
    axes.legend(loc="upper right", fontsize="small")
    return figure


def nichols(loops: Mapping[str, Transfer]) -> Figure:
    """Magnitude over phase, with contours of the sensitivity |1/(1 + L)| in dB."""
    figure = Figure(figsize=(7.5, 5.5), layout="constrained")
    axes = figure.subplots()
    phase, level = np.meshgrid(np.linspace(-360.0, 0.0, 361), np.linspace(-40.0, 40.0, 321))
    grid = 10 ** (level / 20) * np.exp(1j * np.radians(phase))
    with np.errstate(divide="ignore"):
        sensitivity = -20 * np.log10(np.abs(1.0 + grid))
    lines = axes.contour(
        phase, level, sensitivity, [-20, -6, 0, 3, 6, 12, 20], colors="#bbbbbb", linewidths=0.7
    )
    axes.clabel(lines, fmt="%d dB", fontsize="x-small")
    for index, (name, loop) in enumerate(loops.items()):
        value = loop(1j * _shown(loop))
        style = {"color": COLORS[index % len(COLORS)], "linestyle": _DASHES[index % 4]}
        axes.plot(_phase(value), 20 * np.log10(np.abs(value)), label=name, **style)
    axes.plot([-180.0], [0.0], "k+", markersize=12)
    axes.set_xlim(-360.0, 0.0)
    axes.set_ylim(-40.0, 40.0)
    axes.set_xticks(np.arange(-360.0, 1.0, 45.0))
    axes.set_xlabel("phase of L [deg]")
    axes.set_ylabel("magnitude of L [dB]")
    axes.legend(loc="lower right")
    return figure


def root_map(roots: Mapping[str, Roots]) -> Figure:
    """Characteristic roots: all that are listed, and those near the imaginary axis."""
    figure = Figure(figsize=(9.0, 4.5), layout="constrained")
    whole, near = figure.subplots(1, 2)
    markers = "ox^sdv*"
    for index, (name, one) in enumerate(roots.items()):
        for axes in (whole, near):
            axes.plot(
                one.values.real,
                one.values.imag / (2 * np.pi),
                markers[index % len(markers)],
                color=COLORS[index % len(COLORS)],
                fillstyle="none",
                label=name,
            )
    first = [one.values[0] for one in roots.values()]
    width = 1.5 * max(abs(root.real) for root in first) + 0.02 * max(abs(root) for root in first)
    height = 1.5 * max(abs(root.imag) for root in first) / (2 * np.pi) + 1e-9
    near.set_xlim(-width, width)
    near.set_ylim(-height, height)
    whole.xaxis.get_major_locator().set_params(nbins=5)
    whole.set_title("all that were asked for")
    near.set_title("rightmost")
    for axes in (whole, near):
        axes.axvline(0.0, color=_GREY, linewidth=0.8)
        axes.set_xlabel("real part [1/s]")
        axes.set_ylabel("imaginary part/(2 pi) [Hz]")
        axes.grid(alpha=0.3)
    near.legend(fontsize="small")
    return figure


def stability_chart(chart: Chart, points: Mapping[str, tuple[float, float]] | None = None) -> Figure:
    """Growth per contact, the exact border, the first-order rule, and operating points.

    Args:
        points: (x, y) in SI by name, beside those of the source that lie in the chart's plane.
    """
    points = {**source_points(chart), **(points or {})}
    figure = Figure(figsize=(8.0, 5.5), layout="constrained")
    axes = figure.subplots()
    (x_factor, x_unit), (y_factor, y_unit) = _unit(chart.x_name), _unit(chart.y_name)
    x, y = chart.x * x_factor, chart.y * y_factor
    growth = np.ma.masked_invalid(chart.growth)
    if growth.count():
        limit = max(0.02, min(1.0, float(np.ma.max(np.ma.abs(np.ma.log(growth))))))
        mesh = axes.pcolormesh(
            x,
            y,
            np.exp(np.ma.log(growth)),
            cmap="RdBu_r",
            shading="nearest",
            rasterized=True,
            norm=_log_norm(limit),
        )
        bar = figure.colorbar(mesh, ax=axes, label="growth of the velocity per contact [1]")
        ticks = np.exp(np.linspace(-limit, limit, 5))
        bar.set_ticks(ticks, labels=[f"{tick:.2f}" for tick in ticks])
        bar.ax.minorticks_off()
    if chart.stable.any() and not chart.stable.all():
        # Where the contact's root alone decides, its growth says where between two points the border lies;
        # where it does not oscillate, the count of roots does.
        known = np.isfinite(chart.growth)
        alone = np.array_equal(chart.growth[known] < 1.0, chart.stable[known])
        sure = np.where(chart.stable, -0.5, 0.5)
        field = (
            np.where(known, np.log(np.where(known, np.maximum(chart.growth, 1e-9), 1.0)), sure)
            if alone
            else sure
        )
        axes.contour(x, y, field, [0.0], colors="black", linewidths=2.0)
        axes.plot([], [], color="black", linewidth=2.0, label="exact border")
    if chart.rule is not None and (chart.rule > 0).any() and not (chart.rule > 0).all():
        axes.contour(x, y, chart.rule, [0.0], colors=COLORS[2], linestyles="--", linewidths=1.6)
        axes.plot([], [], "--", color=COLORS[2], label="c = k (tau_m + 2 xi_n/omega_n)")
    for index, (name, (px, py)) in enumerate(points.items()):
        axes.plot(
            [px * x_factor],
            [py * y_factor],
            "ovs^Dp*"[index % 7],
            color="black",
            markerfacecolor="white",
            markersize=8,
            label=name,
            clip_on=False,
            zorder=5,
            linestyle="",
        )
    axes.set_xlabel(f"{chart.x_name} [{x_unit}]")
    axes.set_ylabel(f"{chart.y_name} [{y_unit}]")
    if axes.get_legend_handles_labels()[0]:
        figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def step_chart(
    loops: Mapping[str, Sequence[SampledLoop]],
    limit: float,
    measured: Mapping[str, Sequence[tuple[float, float]]] | None = None,
) -> Figure:
    """Growth per contact and phase margin over the communication step, one line for each master.

    Args:
        loops: sampled loops by master.
        limit: growth without steps.
        measured: (step size [s], growth) of co-simulations by master.
    """
    figure = Figure(figsize=(9.0, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    for index, (name, sampled) in enumerate(loops.items()):
        steps = np.array([one.step_size for one in sampled]) * 1e3
        style = {"color": COLORS[index % len(COLORS)], "linestyle": _DASHES[index % 4], "label": name}
        left.semilogx(steps, [one.growth() for one in sampled], **style)
        right.semilogx(steps, [one.margins()[0] for one in sampled], **style)
        for number, (step, growth) in enumerate((measured or {}).get(name, ())):
            label = f"{name}, co-simulated" if number == 0 else None
            left.semilogx([step * 1e3], [growth], "o", color=style["color"], fillstyle="none", label=label)
    left.axhline(limit, color=_GREY, linewidth=0.8)
    left.set_ylabel("growth of the velocity per contact [1]")
    right.set_ylabel("phase margin [deg]")
    for axes in (left, right):
        _plain(axes)
        axes.set_xlabel("communication step [ms]")
        axes.grid(alpha=0.3)
    left.legend(fontsize="small")
    return figure


def _log_norm(limit: float) -> object:
    from matplotlib.colors import LogNorm

    return LogNorm(np.exp(-limit), np.exp(limit))


def _plain(axes: Axes) -> None:
    """Plain numbers along a logarithmic x axis: the labels by default collide within a decade or two."""
    low, high = axes.get_xlim()
    wide = high > 1e4 * low
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0,) if wide else (1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())


def _unit(name: str) -> tuple[float, str]:
    return _UNITS.get(name.rpartition(".")[2], (1.0, "SI"))


def _phase(value: Array) -> Array:
    """Phase from the low-frequency end on, without jumps, begun between -360 and 0 degrees [deg]."""
    phase = np.degrees(np.unwrap(np.angle(value)))
    return phase - 360.0 * np.floor((phase[0] + 1e-6) / 360.0) - 360.0 if phase[0] > 1e-6 else phase


def _shown(loop: Transfer) -> Array:
    """Frequencies around the crossovers: two decades to either side."""
    w = span(loop)
    level = np.abs(loop(1j * w))
    inside = w[(level < 1e3) & (level > 1e-4)]
    return np.geomspace(inside[0], inside[-1], 3000) if inside.size else w
