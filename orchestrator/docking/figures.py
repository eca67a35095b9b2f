"""Figures of docking runs, drawn as in the paper: free flight between the frames is cut out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from ..base.arrays import Array
from ..plotting.figures import COLORS
from .contacts import Contact, find_contacts
from .theory import ideal_restitution

if TYPE_CHECKING:
    from ..results.recorders import Results
    from .options import DockingOptions

# Okabe and Ito's palette: distinguished with any colour vision.
BLUE, VERMILION, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "#666666"


def contacts(results: Results, options: DockingOptions) -> Figure:
    """Relative velocity and contact force over contact time, beside the ideal contact (Figs. 3, 7)."""
    found = find_contacts(
        results.time, results[f"{options.satellite}.velocity"], results[f"{options.contact}.force"]
    )
    figure = Figure(figsize=(9.0, 6.0), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    _draw_contacts(upper, lower, results, options, found, BLUE, "simulated")
    _draw_ideal(upper, lower, results, options, found)
    upper.set_ylabel("relative velocity [mm/s]")
    lower.set_ylabel("contact force [N]")
    lower.set_xlabel("time in contact, free flight cut out [s]")
    figure.suptitle(f"{len(found)} contacts")
    figure.legend(*upper.get_legend_handles_labels(), loc="outside upper right", ncols=2)
    return figure


def rebounds(measures: Mapping[str, Any]) -> Figure:
    """Rebound velocity over the approach speed, and coefficient of restitution, per contact (Fig. 10)."""
    number = np.arange(1, len(measures["contacts"]) + 1)
    figure = Figure(figsize=(9.0, 4.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.plot(number, _absolute(measures, "rebound_velocity_ratio"), "o-", color=BLUE, label="simulated")
    left.plot(number, _absolute(measures, "ideal_velocity_ratio"), "--", color=GREY, label="ideal contact")
    left.set_ylabel("rebound velocity / approach speed [1]")
    left.legend()
    right.plot(number, _absolute(measures, "cor"), "o-", color=BLUE)
    right.axhline(measures["ideal"]["cor"], linestyle="--", color=GREY)
    right.set_ylabel("coefficient of restitution [1]")
    for axes in (left, right):
        axes.set_xlabel("contact")
        axes.xaxis.get_major_locator().set_params(integer=True)
        _spread(axes)
    return figure


def estimates(results: Results, options: DockingOptions) -> Figure:
    """Estimated contact stiffness and damping over time in contact beside the true values (Fig. 6)."""
    found = find_contacts(
        results.time, results[f"{options.satellite}.velocity"], results[f"{options.contact}.force"]
    )
    figure = Figure(figsize=(9.0, 6.0), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    for axes, name in ((upper, "stiffness"), (lower, "damping")):
        estimate = results[f"{options.controller}.{name}_estimate"] * 1e-3
        for index, (time, rows) in enumerate(contact_time(results, found)):
            axes.plot(time, estimate[rows], color=BLUE, label="estimate" if index == 0 else None)
        truth = results.parameters[f"{options.contact}.{name}"] * 1e-3
        axes.axhline(truth, linestyle="--", color=GREY, label="true")
        axes.legend(loc="lower right")
    upper.set_ylabel("stiffness [N/mm]")
    lower.set_ylabel("damping [N.s/mm]")
    lower.set_xlabel("time in contact, free flight cut out [s]")
    return figure


def comparison(runs: Mapping[str, tuple[Results, DockingOptions]]) -> Figure:
    """Rebound velocity and peak force per contact of several runs on one pair of axes."""
    figure = Figure(figsize=(9.0, 4.5), layout="constrained")
    left, right = figure.subplots(1, 2)
    shown = 0
    for index, (name, (results, options)) in enumerate(runs.items()):
        found = find_contacts(
            results.time, results[f"{options.satellite}.velocity"], results[f"{options.contact}.force"]
        )
        speed = abs(results[f"{options.satellite}.velocity"][0])
        number = np.arange(1, len(found) + 1)
        shown = max(shown, len(found))
        style = {"color": COLORS[index % len(COLORS)], "marker": "o", "label": name}
        ratios = [abs(contact.velocity_after) / speed if speed else np.nan for contact in found]
        left.plot(number, ratios, **style)
        right.plot(number, [contact.peak_force for contact in found], **style)
    left.axhline(1.0, color=GREY, linewidth=0.8)
    left.set_ylabel("rebound velocity / approach speed [1]")
    right.set_ylabel("peak contact force [N]")
    for axes in (left, right):
        axes.set_xlabel("contact")
        axes.xaxis.get_major_locator().set_params(integer=True)
    figure.legend(*left.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def _draw_contacts(
    upper: Any,
    lower: Any,
    results: Results,
    options: DockingOptions,
    found: list[Contact],
    color: str,
    label: str,
) -> None:
    velocity = results[f"{options.satellite}.velocity"]
    force = results[f"{options.contact}.force"]
    for index, (time, rows) in enumerate(contact_time(results, found)):
        text = label if index == 0 else None
        upper.plot(time, velocity[rows] * 1e3, color=color, label=text)
        lower.plot(time, force[rows], color=color, label=text)


def _draw_ideal(
    upper: Any, lower: Any, results: Results, options: DockingOptions, found: list[Contact]
) -> None:
    """The contact without delay, each begun where the simulated one begins, at the theoretical speed."""
    stiffness = results.parameters[f"{options.contact}.stiffness"]
    damping = results.parameters[f"{options.contact}.damping"]
    mass = results.parameters[f"{options.satellite}.mass"]
    decay, natural = damping / (2.0 * mass), np.sqrt(stiffness / mass)
    if decay >= natural:
        return  # an overdamped contact does not oscillate; its rebound is drawn in `rebounds`
    damped = np.sqrt(natural**2 - decay**2)
    duration = 2.0 * np.arccos(decay / natural) / damped
    speed = float(results[f"{options.satellite}.velocity"][0])
    restitution = ideal_restitution(stiffness, damping, mass)
    for index, (time, _) in enumerate(contact_time(results, found)):
        begin = time[0]
        elapsed = np.linspace(0.0, duration, 200)
        envelope = speed * (-restitution) ** index * np.exp(-decay * elapsed)
        depth = envelope * np.sin(damped * elapsed) / damped
        rate = envelope * (np.cos(damped * elapsed) - decay / damped * np.sin(damped * elapsed))
        text = "ideal contact" if index == 0 else None
        style = {"linestyle": "--", "color": GREY, "linewidth": 1.0, "label": text}
        upper.plot(begin + elapsed, rate * 1e3, **style)
        lower.plot(begin + elapsed, -(stiffness * depth + damping * rate), **style)


def contact_time(results: Results, found: list[Contact]) -> Iterator[tuple[Array, slice]]:
    """Time [s] with the free flight cut out, and rows of each contact with the instants around it."""
    begin = 0.0
    for contact in found:
        rows = slice(max(contact.first - 1, 0), contact.last + 2)
        time = begin + results.time[rows] - results.time[rows][0]
        yield time, rows
        begin = float(time[-1])


def _absolute(measures: Mapping[str, Any], key: str) -> list[float]:
    """NaN, which is not drawn, where there is none."""
    return [np.nan if contact[key] is None else abs(contact[key]) for contact in measures["contacts"]]


def _spread(axes: Any) -> None:
    """Keep values that agree to a per mille from being drawn as if they differed."""
    low, high = axes.get_ylim()
    middle = 0.5 * (low + high)
    if high - low < 0.1 * abs(middle):
        axes.set_ylim(middle - 0.05 * abs(middle), middle + 0.05 * abs(middle))
