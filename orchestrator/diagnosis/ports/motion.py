"""Phases of motion of any system: which way it moves, where it turns, where it rests."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ...system.connection import Port
from ..study import Array
from .keys import SPEEDS
from .study import PortRun, PortStudy

__all__ = ["PHASES", "phases"]

PHASES = ("forth", "back", "reversal", "rest")
_FORTH, _BACK, _REVERSAL, _REST = range(len(PHASES))
# Slower than this share of the root mean square speed is slow; where nothing moves at all, phases are one.
_SLOW = 0.1
# Noise of a velocity made of positions, as a share of the slow speed; and what it may be averaged over at
# most, as a share of the run.
_QUIET, _LONGEST = 0.3, 0.02


def phases(
    study: PortStudy, run: PortRun, signals: Mapping[Port, Array]
) -> tuple[tuple[str, ...], np.ndarray]:
    """Phase of each sample of a run.

    By the velocity of the study's `motion`, else of the first logged velocity, else of the first logged
    position; compared ports first. Slow stretches between motions of two ways are reversals, others rest.

    Args:
        signals: of ports beside the logged ones, each of shape (n,).
    Returns: names of the phases, and the number of each sample's, shape (n,). Where nothing tells of motion,
        the one phase is the run.
    """
    velocity = _velocity(study, run, signals)
    if velocity is None:
        return ("run",), np.zeros(len(run), int)
    usual = float(np.sqrt(np.mean(velocity**2)))
    slow = np.abs(velocity) <= (study.rest if study.rest is not None else _SLOW * usual)
    if usual == 0.0:
        slow[:] = True
    found = np.where(velocity > 0.0, _FORTH, _BACK)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], slow, [False]]).astype(int)))
    for first, end in edges.reshape(-1, 2):
        inner = first > 0 and end < len(found)
        found[first:end] = _REVERSAL if inner and velocity[first - 1] * velocity[end] < 0.0 else _REST
    # Fast from one way to the other without a slow sample in between: the first sample after turns.
    turned = np.flatnonzero((found[1:] + found[:-1] == _FORTH + _BACK) & (found[1:] != found[:-1])) + 1
    found[turned] = _REVERSAL
    return PHASES, found


def _velocity(study: PortStudy, run: PortRun, signals: Mapping[Port, Array]) -> Array | None:
    port = study.motion or _moving(study, run)
    if port is None:
        return None
    values = run.logs.get(port, signals.get(port))
    if values is None or not np.isfinite(values).all():
        return None
    if study.unit(port) == SPEEDS[study.unit(port)]:
        return values
    step = study.interval
    column = study.columns.get(port)
    noise = 0.0 if column is None or column.noise is None or port not in run.logs else column.noise
    speed = float(np.std(np.diff(values))) / step
    wanted = np.sqrt(2.0) * noise / (_QUIET * _SLOW * speed * step) if speed > 0.0 else 1.0
    half = int(np.clip(wanted / 2.0, 1, max(_LONGEST * len(values) / 2.0, 1.0)))
    padded = np.pad(values, half, mode="edge")
    return (padded[2 * half :] - padded[: -2 * half]) / (2.0 * half * step)


def _moving(study: PortStudy, run: PortRun) -> Port | None:
    """The logged port that tells best of motion."""
    logged = [port for port in (*study.compared, *study.fed) if port in run.logs]
    for fast in (True, False):
        for port in logged:
            unit = study.unit(port)
            if unit in SPEEDS and (SPEEDS[unit] == unit) is fast:
                return port
    return None
