"""Figures of docking runs in six degrees of freedom."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from ..plotting.figures import COLORS
from .figures import BLUE, GREEN, GREY, VERMILION
from .space_contacts import SpaceContacts
from .space_signals import pose, stacked

if TYPE_CHECKING:
    from ..results.recorders import Results
    from .options import SpaceOptions

AXES = (("x", VERMILION), ("y", BLUE), ("z", GREEN))


def positions(results: Results, options: SpaceOptions) -> Figure:
    """The rod's assembly frame as the satellites have it, the robot beside it, and how far that is off."""
    figure, (upper, lower) = _two()
    wanted, real = (stacked(results, f"{name}.position") for name in (options.satellites, options.robot))
    for index, (axis, color) in enumerate(AXES):
        upper.plot(results.time, wanted[:, index] * 1e3, color=color, label=f"{axis} of the satellites")
        upper.plot(results.time, real[:, index] * 1e3, "--", color=color, label=f"{axis} of the robot")
        lower.plot(results.time, (real - wanted)[:, index] * 1e3, color=color, label=axis)
    upper.set_ylabel("position of O_u in O_t [mm]")
    lower.set_ylabel("robot - satellites [mm]")
    return _finished(figure, upper, lower, "Position of the rod's assembly frame")


def attitude(results: Results, options: SpaceOptions) -> Figure:
    """Rotation vector and angular velocity of the rod's assembly frame."""
    figure, (upper, lower) = _two()
    wanted, real = (pose(results, name) for name in (options.satellites, options.robot))
    turns = [motion.orientation.as_rotvec() * 1e3 for motion in (wanted, real)]
    for index, (axis, color) in enumerate(AXES):
        upper.plot(results.time, turns[0][:, index], color=color, label=f"{axis} of the satellites")
        upper.plot(results.time, turns[1][:, index], "--", color=color, label=f"{axis} of the robot")
        lower.plot(results.time, wanted.angular_velocity[:, index] * 1e3, color=color)
        lower.plot(results.time, real.angular_velocity[:, index] * 1e3, "--", color=color)
    upper.set_ylabel("rotation vector [mrad]")
    lower.set_ylabel("angular velocity [mrad/s]")
    return _finished(figure, upper, lower, "Attitude of the rod's assembly frame in O_t")


def forces(results: Results, options: SpaceOptions) -> Figure:
    """Contact force along the axes of O_t, and along the surface normal."""
    figure, (upper, lower) = _two()
    force = stacked(results, f"{options.contact}.force")
    for index, (axis, color) in enumerate(AXES):
        upper.plot(results.time, force[:, index], color=color, label=axis)
    lower.plot(results.time, SpaceContacts.of(results, options).force, color=BLUE)
    upper.set_ylabel("force on the rod, in O_t [N]")
    lower.set_ylabel("along the way to the front [N]")
    return _finished(figure, upper, lower, "Contact force")


def energy(results: Results, options: SpaceOptions) -> Figure:
    """Kinetic energy of the pair, with the energy stored in the contact, and momentum's change."""
    figure, (upper, lower) = _two()
    kinetic = results[f"{options.satellites}.kinetic_energy"]
    stored = results[f"{options.contact}.stored_energy"]
    upper.plot(results.time, kinetic * 1e3, color=BLUE, label="kinetic, both satellites")
    upper.plot(
        results.time, (kinetic + stored) * 1e3, color=VERMILION, linewidth=0.9, label="with the contact's"
    )
    upper.axhline(kinetic[0] * 1e3, linestyle="--", color=GREY, label="at the start")
    for name, unit, color in (("linear", "N.s", BLUE), ("angular", "N.m.s", VERMILION)):
        values = stacked(results, f"{options.satellites}.{name}_momentum")
        change = np.linalg.norm(values - values[0], axis=1)
        lower.plot(results.time, change, color=color, label=f"{name} [{unit}]")
    upper.set_ylim(bottom=0.0)
    upper.set_ylabel("energy [mJ]")
    lower.set_ylabel("change of momentum of the pair")
    lower.legend(loc="upper left")
    return _finished(figure, upper, lower, "Energy and momentum")


def contacts(results: Results, options: SpaceOptions) -> Figure:
    """Velocity of the rod tip and contact force along the normal, free flight cut out (as in Fig. 7)."""
    seen = SpaceContacts.of(results, options)
    figure, (upper, lower) = _two()
    begin = 0.0
    for one in seen.found:
        rows = slice(max(one.first - 1, 0), one.last + 2)
        time = begin + results.time[rows] - results.time[rows][0]
        upper.plot(time, seen.velocity[rows] * 1e3, color=BLUE)
        lower.plot(time, seen.force[rows], color=BLUE)
        begin = float(time[-1])
    upper.set_ylabel("normal velocity of the rod tip [mm/s]")
    lower.set_ylabel("normal contact force [N]")
    lower.set_xlabel("time in contact, free flight cut out [s]")
    upper.set_title(f"{len(seen.found)} contacts, seen along the surface normal", loc="left")
    return figure


def estimates(results: Results, options: SpaceOptions) -> Figure:
    """Estimated contact stiffness and damping beside the true values."""
    figure, (upper, lower) = _two()
    for axes, name, unit in ((upper, "stiffness", "N/mm"), (lower, "damping", "N.s/mm")):
        axes.plot(
            results.time,
            results[f"{options.controller}.{name}_estimate"] * 1e-3,
            color=BLUE,
            label="estimate",
        )
        truth = results.parameters[f"{options.contact}.{name}"] * 1e-3
        axes.axhline(truth, linestyle="--", color=GREY, label="true")
        axes.set_ylabel(f"{name} [{unit}]")
    return _finished(figure, upper, lower, "Estimates of the contact")


def comparison(measured: Mapping[str, Mapping[str, Any]]) -> Figure:
    """Restitution, kinetic energy and peak force per contact of several runs."""
    figure = Figure(figsize=(12.0, 4.2), layout="constrained")
    panels = figure.subplots(1, 3)
    wanted = (
        ("cor", "coefficient of restitution along the normal [1]"),
        ("kinetic_energy_ratio", "kinetic energy / that at the start [1]"),
        ("peak_force", "peak contact force [N]"),
    )
    for axes, (key, text) in zip(panels, wanted, strict=True):
        for index, (name, one) in enumerate(measured.items()):
            values = [contact[key] for contact in one["contacts"]]
            # Rings, each within the one before: runs that agree can all be seen.
            axes.plot(
                range(1, len(values) + 1),
                values,
                "o-",
                color=COLORS[index % len(COLORS)],
                fillstyle="none",
                markersize=max(3.0, 10.0 - 3.0 * index),
                linewidth=max(0.8, 2.6 - 0.8 * index),
                label=name,
            )
        axes.set_xlabel("contact")
        axes.set_ylabel(text)
        axes.xaxis.get_major_locator().set_params(integer=True)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def _two() -> tuple[Figure, Any]:
    figure = Figure(figsize=(9.0, 6.0), layout="constrained")
    return figure, figure.subplots(2, 1, sharex=True)


def _finished(figure: Figure, upper: Any, lower: Any, title: str) -> Figure:
    lower.set_xlabel("time [s]")
    upper.set_title(title, loc="left")
    figure.legend(*upper.get_legend_handles_labels(), loc="outside upper right", ncols=3)
    return figure
