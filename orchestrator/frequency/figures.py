"""Figures of a system's report: Bode, Nyquist, Nichols, step response, roots, participation, sigma."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ..base.arrays import Array, Complex
from ..plotting.figures import COLORS

_GREY = "#666666"


def bode(name: str, omega: Array, value: Complex) -> Figure:
    """Magnitude and phase of an open loop, with its crossovers."""
    figure = Figure(figsize=(6.0, 5.0), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    hertz = omega / (2.0 * np.pi)
    upper.semilogx(hertz, 20.0 * np.log10(np.maximum(abs(value), 1e-300)))
    upper.axhline(0.0, color="black", linewidth=0.8)
    upper.set_ylabel("magnitude [dB]")
    upper.set_title(name)
    lower.semilogx(hertz, _phase(value))
    lower.axhline(-180.0, color="black", linewidth=0.8)
    low, high = lower.get_ylim()
    lower.set_ylim(max(min(low, -190.0), -900.0), max(high, -170.0))
    lower.set_ylabel("phase [deg]")
    lower.set_xlabel("frequency [Hz]")
    level = abs(value)
    for index in np.flatnonzero((level[:-1] > 1.0) != (level[1:] > 1.0)):
        for axes in (upper, lower):
            axes.axvline(hertz[index], color=_GREY, linewidth=0.8, linestyle="--")
    for axes in (upper, lower):
        axes.grid(alpha=0.3)
    return figure


def nyquist(name: str, omega: Array, value: Complex) -> Figure:
    """The locus near -1, with the unit circle."""
    figure = Figure(figsize=(5.0, 5.0), layout="constrained")
    axes = figure.subplots()
    axes.plot(value.real, value.imag, color=COLORS[0])
    axes.plot(value.real, -value.imag, color=COLORS[0], alpha=0.3)
    turn = np.exp(2j * np.pi * np.linspace(0.0, 1.0, 200))
    axes.plot(turn.real, turn.imag, color="black", linewidth=0.6)
    axes.plot([-1.0], [0.0], "+", color="#D55E00", markersize=10)
    axes.set_xlim(-2.5, 1.5)
    axes.set_ylim(-2.0, 2.0)
    axes.set_aspect("equal")
    axes.set_title(name)
    axes.set_xlabel("real part of L [1]")
    axes.set_ylabel("imaginary part of L [1]")
    axes.grid(alpha=0.3)
    return figure


def nichols(name: str, omega: Array, value: Complex) -> Figure:
    """Magnitude over phase, with curves of equal |L/(1 + L)|."""
    figure = Figure(figsize=(6.0, 5.0), layout="constrained")
    axes = figure.subplots()
    phase = _phase(value)
    center = -180.0 + 360.0 * np.round(
        (np.median(phase[abs(abs(value) - 1.0).argsort()[:20]]) + 180.0) / 360.0
    )
    turn = np.exp(1j * np.linspace(1e-3, 2.0 * np.pi - 1e-3, 400))
    for peak in (-12.0, -6.0, -3.0, 0.0, 3.0, 6.0, 12.0):
        closed = 10.0 ** (peak / 20.0) * turn
        opened = closed / (1.0 - closed)
        angle = np.degrees(np.angle(-opened)) + center
        angle = np.where(abs(np.diff(angle, append=angle[-1])) > 90.0, np.nan, angle)
        axes.plot(angle, 20.0 * np.log10(abs(opened)), color=_GREY, linewidth=0.6, linestyle=":")
        place = int(np.nanargmin(angle))
        axes.annotate(
            f"{peak:g} dB", (angle[place], 20.0 * np.log10(abs(opened[place]))), fontsize=7, color=_GREY
        )
    axes.plot(phase, 20.0 * np.log10(np.maximum(abs(value), 1e-300)), color=COLORS[0])
    axes.plot([center], [0.0], "+", color="#D55E00", markersize=10)
    axes.set_xlim(center - 200.0, center + 200.0)
    axes.set_ylim(-40.0, 40.0)
    axes.set_title(name)
    axes.set_xlabel("phase of L [deg]")
    axes.set_ylabel("magnitude of L [dB]")
    axes.grid(alpha=0.3)
    return figure


def root_map(modes: Sequence[Mapping[str, Any]], sampled: Sequence[Mapping[str, Any]]) -> Figure:
    """Roots of the machine, and as co-simulated those that stand for one of them."""
    figure = Figure(figsize=(5.5, 4.5), layout="constrained")
    axes = figure.subplots()
    for one in modes:
        real, imaginary = one["root"]
        axes.plot([real, real], [imaginary, -imaginary], "x", color="#D55E00" if real > 0 else "#0072B2")
    shown = axes.get_ylim()
    for one in sampled:
        real, imaginary = one["root"]
        if one["machine"] is not None:
            axes.plot([real, real], [imaginary, -imaginary], "o", color="#009E73", fillstyle="none")
            shown = min(shown[0], -abs(imaginary) * 1.1), max(shown[1], abs(imaginary) * 1.1)
    # Roots that a delay adds far away would hide those that matter.
    sizes = sorted(abs(complex(*one["root"])) for one in modes)
    near = 8.0 * next((one for one in sizes if one > 1e-9 * sizes[-1]), 1.0)
    axes.set_ylim(max(shown[0], -near), min(shown[1], near))
    low, high = axes.get_xlim()
    axes.set_xlim(max(low, -near), min(high, near))
    axes.set_title("x machine, o as co-simulated")
    axes.axvline(0.0, color="black", linewidth=0.8)
    axes.set_xlabel("real part [1/s]")
    axes.set_ylabel("imaginary part [rad/s]")
    axes.grid(alpha=0.3)
    return figure


def participation(modes: Sequence[Mapping[str, Any]]) -> Figure:
    """Which states take part in which mode, as bars."""
    names = list(dict.fromkeys(name for one in modes for name in one["participation"]))
    figure = Figure(figsize=(7.0, 1.2 + 0.32 * len(modes)), layout="constrained")
    axes = figure.subplots()
    left = np.zeros(len(modes))
    for index, name in enumerate(names):
        share = np.array([100.0 * one["participation"].get(name, 0.0) for one in modes])
        hatch = ("", "//", "..", "xx")[index // len(COLORS) % 4]
        axes.barh(
            range(len(modes)), share, left=left, label=name, color=COLORS[index % len(COLORS)], hatch=hatch
        )
        left += share
    labels = [
        f"{one['frequency']:.3g} Hz" if one["root"][1] else f"{one['root'][0]:.3g} 1/s, real" for one in modes
    ]
    axes.set_yticks(range(len(modes)), labels)
    axes.invert_yaxis()
    axes.set_xlim(0.0, 100.0)
    axes.set_xlabel("share in the mode [%]")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside right upper", fontsize="small")
    return figure


def step_figure(name: str, time: Array, value: Array) -> Figure:
    """How the closed loop follows a step at a connection."""
    figure = Figure(figsize=(6.0, 3.5), layout="constrained")
    axes = figure.subplots()
    axes.plot(time, value)
    axes.axhline(1.0, color="black", linewidth=0.8, linestyle="--")
    axes.set_title(f"step at {name}")
    axes.set_xlabel("time [s]")
    axes.set_ylabel("closed loop L/(1 + L) [1]")
    axes.grid(alpha=0.3)
    return figure


def sigma(names: Sequence[str], omega: Array, matrices: Complex) -> Figure:
    """Singular values of sensitivity and complementary sensitivity, shape (k, loops, loops)."""
    figure = Figure(figsize=(6.0, 4.5), layout="constrained")
    axes = figure.subplots()
    hertz = omega / (2.0 * np.pi)
    eye = np.eye(len(names))
    for label, values, color in (("S", matrices, "C0"), ("T", eye - matrices, "C1")):
        found = np.linalg.svd(values, compute_uv=False)
        for row in range(found.shape[1]):
            decibel = 20.0 * np.log10(np.maximum(found[:, row], 1e-300))
            axes.semilogx(hertz, decibel, color=color, label=None if row else f"singular values of {label}")
    axes.axhline(0.0, color="black", linewidth=0.8)
    axes.set_ylim(bottom=max(axes.get_ylim()[0], -80.0))
    axes.set_title(", ".join(name.rpartition("-> ")[2] for name in names))
    axes.set_xlabel("frequency [Hz]")
    axes.set_ylabel("magnitude [dB]")
    axes.grid(alpha=0.3)
    axes.legend()
    return figure


def _phase(value: Complex) -> Array:
    """Phase from the low-frequency end on, without jumps, begun between -360 and 0 degrees [deg]."""
    phase = np.degrees(np.unwrap(np.angle(value)))
    return phase - 360.0 * np.floor((phase[0] + 1e-6) / 360.0) - 360.0 if phase[0] > 1e-6 else phase
