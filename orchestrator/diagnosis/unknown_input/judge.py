"""Replay held-out runs with an answer inserted, and tell how much of the gap it closes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .model import Inserted
from .places import Runs
from .smoother import simulated

__all__ = ["Judged", "replayed"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Judged:
    """What open replays of runs leave.

    Attributes:
        remains: root mean square of the residual over the noise, of all compared samples.
        loglik: of the runs in the filter, with constants fixed.
    """

    remains: float
    loglik: float


def replayed(
    runs: Runs, laws: Sequence[Inserted], constants: Array, *, as_configured: bool = False
) -> Judged:
    """Replay runs with fixed constants from the start state that the whole run makes likely.

    Args:
        constants: parameters, then the laws' numbers.
        as_configured: begin where the study says instead.
    """
    model, settled = runs.model, runs.model.study.settled
    count = len(model.nominal)
    numbers = constants[count:]
    priors = [(float(one), 1.0) for one in numbers]
    tiny = np.diag((1e-9 * np.abs(constants) + 1e-15) ** 2)
    squares, total, value = 0.0, 0, 0.0
    for index, (ext, held, logged, start) in enumerate(runs.data):
        nh = sum(one.states for one in laws)
        z = np.concatenate([start, np.zeros(nh), constants])
        if not as_configured:
            one = runs.passes(laws, priors, constants=(constants, tiny), smooth=True, only=[index])[0]
            value += one.loglik
            if np.isfinite(one.loglik):
                z = one.path[0].copy()
                z[-len(constants) :] = constants
        found, _ = simulated(model, ext, held, z, runs.sub_of(laws), laws)
        left = ((found - logged) / model.noise)[settled:]
        left = np.where(np.isnan(logged[settled:]), 0.0, left)
        left = np.nan_to_num(left, nan=1e6, posinf=1e6, neginf=-1e6)
        squares += float((np.clip(left, -1e6, 1e6) ** 2).sum())
        total += int((~np.isnan(logged[settled:])).sum())
    return Judged(float(np.sqrt(squares / max(total, 1))), value)


def closed(before: float, after: float) -> float:
    """Share of the gap's size beyond the noise that is closed; 0 where there was no gap."""
    gap = np.sqrt(max(before**2 - 1.0, 0.0))
    return float(1.0 - np.sqrt(max(after**2 - 1.0, 0.0)) / gap) if gap > 0.3 else 0.0
