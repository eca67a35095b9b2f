"""Leave outliers of logs out; thin out logs that are sampled much faster than the system moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..study.channels import outliers
from ..study.study import PortStudy, Role
from .model import StateModel
from .places import Runs
from .polish import Replays

Array = NDArray[np.float64]
# Samples that are enough for a search, and noises by which simulations with fewer may differ.
_ENOUGH, _SAME_SIMULATION = 3000, 0.1
# Rows on each side where a jump of the simulation explains what it misses.
_NEAR = 4


def without_outliers(model: StateModel) -> tuple[PortStudy, list[str]]:
    """The study with NaN in place of gaps and outliers of compared logs, and a remark for each log with some.

    Outliers are looked for in what the configured model misses, which holds less of the machine's own motion.
    """
    study, runs, remarks = model.study, [], []
    replays = Replays(Runs(model, study.runs), ())
    for index, (run, start) in enumerate(zip(study.runs, replays.starts, strict=True)):
        found, logs = replays.found(index, start, model.nominal), dict(run.logs)
        for k, port in enumerate(model.compared):
            if port not in logs or port in model.fed:
                continue
            noise = float(model.noise[k])
            missed = logs[port] - found[:, k]
            away = outliers(missed, noise) & ~_jumps(found[:, k], missed)
            if rows := np.flatnonzero(away).tolist():
                remarks.append(
                    f"{run.name}: {port}: {len(rows)} of {len(away)} rows are outliers, first row {rows[0]} "
                    f"({logs[port][rows[0]]:.6g} {study.unit(port)}): they jump away and back at once. They "
                    "are not compared. Look for drop-outs of the sensor, its cable and the logger."
                )
                logs[port] = np.where(away, np.nan, logs[port])
        for port, empty in run.gaps.items():
            logs[port] = np.where(empty, np.nan, logs[port])
            remarks.append(
                f"{run.name}: {port}: {empty.sum()} of {len(empty)} rows hold nothing, first row "
                f"{int(np.argmax(empty))}. They are not compared."
            )
        runs.append(replace(run, logs=logs, gaps={}))
    return replace(study, runs=tuple(runs)) if remarks else study, remarks


def _jumps(simulated: Array, missed: Array) -> NDArray[np.bool_]:
    """Rows near which the simulation itself jumps by half of what it misses there.

    A switch that is a few rows early or late in the model is no drop-out of the log.
    """
    jumps = np.abs(np.diff(simulated))
    sides = np.lib.stride_tricks.sliding_window_view(np.pad(jumps, _NEAR, constant_values=0.0), 2 * _NEAR)
    near: NDArray[np.bool_] = sides.max(axis=1) > 0.5 * np.abs(missed)
    return near


def thinned(model: StateModel) -> PortStudy:
    """The study with as few samples as simulate the same, but no fewer than `_ENOUGH`.

    Logs are often sampled much faster than the system moves.
    """
    study = model.study
    if not model.filters:
        return study
    count = sum(map(len, study.of(Role.TRAIN, Role.VALIDATION)))
    whole = _simulated(model)
    missed = _size(
        [
            one - model.logged(run)
            for one, run in zip(whole, model.study.of(Role.TRAIN, Role.VALIDATION), strict=True)
        ],
        model,
    )
    for stride in (32, 16, 8, 4, 2):
        if count < stride * _ENOUGH:
            continue
        model.study = study.every(stride)
        differ = [one - two[::stride] for one, two in zip(_simulated(model), whole, strict=True)]
        if _size(differ, model) < max(_SAME_SIMULATION, 0.03 * missed):
            return model.study
    model.study = study
    return study


def _size(differ: Sequence[Array], model: StateModel) -> float:
    """Root mean square of differences of compared signals, over the noise."""
    return float(np.sqrt(np.nanmean(np.square(np.concatenate(differ) / model.noise))))


def _simulated(model: StateModel) -> list[Array]:
    """Compared signals of the runs as configured."""
    replays = Replays(Runs(model, model.study.of(Role.TRAIN, Role.VALIDATION)), ())
    return [replays.found(k, start, model.nominal) for k, start in enumerate(replays.starts)]
