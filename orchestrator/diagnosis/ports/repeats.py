"""Runs that repeat others, and what of their logs does not repeat."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...system.connection import Port
from ..study import Array
from .noise import white
from .study import PortRun, PortStudy, Role

__all__ = ["apart", "repeats_of", "unlike"]

# Runs whose inputs differ by more of their spread do not repeat each other.
_UNLIKE = 0.2
# Last digits of a signal, as a share of it.
_LAST = 1e-6


def unlike(study: PortStudy, run: PortRun, of: PortRun) -> Iterator[tuple[Port, float, float]]:
    """Fed ports at which a run was driven otherwise than the one that it is said to repeat.

    Yields: port, root mean square of the difference, and spread of the other's log, in the port's unit.
    """
    for port in study.fed:
        if port not in run.logs or port not in of.logs:
            continue
        n = min(len(run), len(of))
        log, other = run.logs[port][:n], of.logs[port][:n]
        # Noise of a sensor does not repeat.
        square = float(np.mean((log - other) ** 2)) - white(log - other)
        differ, spread = float(np.sqrt(max(square, 0.0))), float(np.std(other))
        if differ > _UNLIKE * spread + _LAST * float(np.abs(other).max()):
            yield port, differ, spread


def apart(study: PortStudy, run: PortRun, port: Port) -> list[Array]:
    """What differs at a port between a run and each of its repeats, as noise of one of them, once settled.

    Repeats that were driven otherwise are left out: they say about their inputs.
    """
    found = []
    for other in repeats_of(study, run):
        if port in run.logs and port in other.logs:
            n = min(len(run), len(other))
            found.append((run.logs[port][:n] - other.logs[port][:n])[study.settled :] / np.sqrt(2.0))
    return found


def repeats_of(study: PortStudy, run: PortRun) -> list[PortRun]:
    """The repeats of a run that were driven as it was."""
    return [
        other
        for other in study.of(Role.REPEAT)
        if other.repeats == run.name and next(unlike(study, other, run), None) is None
    ]
