"""The page of a diagnosis of a system's ports."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ...plotting.figures import COLORS, svg
from ...system.connection import Port
from ..figures import NOISE, finish
from ..finding import NOMINAL
from ..headline import percent
from ..report import compose, remarks
from ..study import Array
from ..verdict import Diagnosis
from .replay import PortReplay
from .study import PortRun, PortStudy, Role
from .weigh import Weighed

__all__ = ["page"]

_MOST_POINTS, _MOST_PORTS = 4000, 3
# Part of a run that is enlarged.
_ENLARGED = 0.08


def page(
    study: PortStudy, diagnosis: Diagnosis, weighed: Weighed, taught: Mapping[str, Any] | None = None
) -> str:
    """The page as HTML.

    Args:
        taught: content of practice.json, if there was practice.
    """
    run = (study.of(Role.HELDOUT) or study.of(Role.VALIDATION) or study.of(Role.TRAIN))[0]
    replay = PortReplay(study, [run])
    answer = weighed.finding.answer
    before = replay.signals(run, NOMINAL.calibrated, NOMINAL.effects, NOMINAL.theta)
    after = replay.signals(run, answer.calibrated, answer.effects, answer.theta)
    figures = {}
    for port in replay.compared(run)[:_MOST_PORTS]:
        figure, words = _figure(study, run, port, before[port], after[port])
        figures[words] = svg(figure, f"{port}-{run.name}")
    known = {one.id: one for one in weighed.effects}
    # Of a calibrated one it is not known by how much each answer's calibration moved it besides.
    names = [name for one in weighed.effects for name in one.changes if name not in study.nominal]
    believed = {name: study.prepared.system.start(Port.of(name)) for name in names}
    assumed = _assumed(study, diagnosis, weighed, taught or {})
    return compose(diagnosis, figures, assumed, known, "held-out runs", believed)


def _figure(study: PortStudy, run: PortRun, port: Port, before: Array, after: Array) -> tuple[Figure, str]:
    """A port's log and models over a run, and enlarged where the model as configured is farthest off."""
    log, unit, noise = run.logs[port], study.unit(port), study.columns[port].noise
    assert noise is not None
    time = np.arange(len(run)) * study.interval
    left = np.abs(log - before)
    left[: study.settled] = 0.0
    width = max(int(_ENLARGED * len(run)), min(len(run), 50))
    sums = np.convolve(np.nan_to_num(left, posinf=0.0) ** 2, np.ones(width), "valid")
    first = int(np.argmax(sums))
    figure = Figure(figsize=(9.0, 4.4), layout="constrained")
    grid = figure.subplot_mosaic([["run", "run"], ["zoom", "left"]], height_ratios=[1.0, 1.7])
    thin = slice(None, None, max(len(run) // _MOST_POINTS, 1))
    span = slice(first, first + width)
    for axes, part in ((grid["run"], thin), (grid["left"], span)):
        for values, color in ((before, COLORS[1]), (after, COLORS[0])):
            axes.plot(time[part], (log - values)[part], color=color, linewidth=0.9)
        axes.axhspan(-2 * noise, 2 * noise, color=COLORS[2], alpha=0.15, linewidth=0, label=NOISE)
        axes.set_ylabel(f"[{unit}]")
    for values, color, line, label in (
        (log, "#444444", 2.6, "logged"),
        (before, COLORS[1], 1.3, "before: model as configured"),
        (after, COLORS[0], 1.3, "after: model of the verdict"),
    ):
        grid["zoom"].plot(time[span], values[span], color=color, linewidth=line, label=label)
    grid["run"].axvspan(time[first], time[span][-1], color="#000000", alpha=0.07, linewidth=0)
    grid["run"].set_title(f"residual over {run.name}; shaded: enlarged below", fontsize="small", loc="left")
    grid["zoom"].set_title(str(port), fontsize="small", loc="left")
    grid["zoom"].set_ylabel(f"[{unit}]")
    finish(figure, grid)
    spread = float(log[study.settled :].std()) or noise
    # An offset, too, is a gap.
    shares = [float(np.sqrt(np.mean((log - one)[study.settled :] ** 2))) / spread for one in (before, after)]
    words = (
        f"{port} in {run.name}: the residual's rms is {100 * shares[0]:.3g} % of the signal's spread before "
        f"and {100 * shares[1]:.3g} % after."
    )
    return figure, words


def _assumed(
    study: PortStudy, diagnosis: Diagnosis, weighed: Weighed, taught: Mapping[str, Any]
) -> list[str]:
    names = {role: ", ".join(run.name for run in study.of(role)) for role in Role}
    fed, compared, unasked = (
        ", ".join(map(str, ports)) for ports in (study.fed, study.compared, study.unasked)
    )
    told = [
        f"Logs stand in for {fed}; the system is compared at {compared}."
        + (f" Fed, not compared, for want of a `noise`: {unasked}." if unasked else ""),
        f"Fits saw {names[Role.TRAIN]} only"
        + (f"; answers were chosen with {names[Role.VALIDATION]}, too" if names[Role.VALIDATION] else "")
        + (f"; the gap is measured on {names[Role.HELDOUT]}." if names[Role.HELDOUT] else "."),
        "A calibrated number deviates from its value by its tolerance, one standard deviation.",
        f"Causes are {len(weighed.effects)} candidates, alone or up to four together: parameters with a "
        "prior, effects at ports, laws of friction; none of them; or something else.",
        "Residuals count less where they are larger than the noise, or correlated.",
        _trusted(taught),
    ]
    return told + remarks(diagnosis)


def _trusted(taught: Mapping[str, Any]) -> str:
    """How far probabilities can be trusted."""
    if not taught:
        return "Probabilities are tempered, not calibrated on cases: this system was not practised on."
    told = taught["coverage"]["as learned, on unseen cases"]
    return (
        f"Probabilities were calibrated on {told['cases']:.0f} simulated cases of this system. Of cases that "
        f"it did not see, 95 % answer sets held the truth in {percent(told['covered'])}; first answers were "
        f"right in {percent(told['right'])}, at a mean probability of {percent(told['claimed'])}."
    )
