"""Runs that repeat others, and what of their logs does not repeat."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...system.connection import Port
from .study import Array, PortRun, PortStudy

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
        square = float(np.mean((log - other) ** 2)) - _white(log - other)
        differ, spread = float(np.sqrt(max(square, 0.0))), float(np.std(other))
        if differ > _UNLIKE * spread + _LAST * float(np.abs(other).max()):
            yield port, differ, spread


def _white(r: Array) -> float:
    """Variance of the white noise in a residual, by its second differences: smooth signals have nearly none.

    Args:
        r: shape (n,), n at least 3.
    Returns: at most the mean square of r.
    """
    return min(float(np.mean(np.diff(r, 2) ** 2)) / 6.0, float(np.mean(r**2)))
