"""Replay held-out runs with an answer inserted, and state how much of the gap it closes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .evaluation import Inserted
from .places import Runs
from .polish import Replays, polished

Array = NDArray[np.float64]


@dataclass(frozen=True)
class HeldOutReplay:
    """What open replays of runs leave.

    Attributes:
        remains: root mean square of the residual over the noise, of all compared samples.
        found: compared signals of each run, shape (samples, compared).
    """

    remains: float
    found: list[Array]


def replayed(
    runs: Runs, laws: Sequence[Inserted], constants: Array, *, as_configured: bool = False
) -> HeldOutReplay:
    """Replay runs with fixed constants, from the start states that suit each run best.

    Args:
        constants: parameters, then the laws' numbers.
        as_configured: begin where the study says instead.
    """
    starts = [one[3] for one in runs.data]
    if not as_configured:
        starts = likely(runs, laws, constants)
        starts = polished(runs, laws, constants, starts, trials=8, fixed=True).starts
    replays = Replays(runs, laws, starts=starts)
    found = [replays.found(k, start, constants) for k, start in enumerate(starts)]
    left = np.concatenate([replays.compared(k, one) for k, one in enumerate(found)])
    return HeldOutReplay(float(np.sqrt(np.mean(left**2))), found)


def likely(runs: Runs, laws: Sequence[Inserted], constants: Array) -> list[Array]:
    """Start states of the study, or those of a filter and smoother where these suit a run better."""
    nx, count = len(runs.model.states), len(runs.model.nominal)
    priors = [(float(one), 1.0) for one in constants[count:]]
    tiny = np.diag((1e-9 * np.abs(constants) + 1e-15) ** 2)
    replays, found = Replays(runs, laws), []
    for index, (*_, start) in enumerate(runs.data):
        if not runs.model.filters:
            found.append(start.copy())
            continue
        one = runs.passes(laws, priors, constants=(constants, tiny), smooth=True, only=[index])[0]
        tried = [start]
        if np.isfinite(one.loglik) and np.isfinite(one.path[0]).all():
            tried.append(one.path[0][:nx].copy())
        found.append(min(tried, key=lambda x: float((replays.left(index, x, constants) ** 2).sum())))
    return found


def closed(before: float, after: float, least: float = 0.3) -> float:
    """Share of the gap's size beyond the noise that is closed; 0 where there was none of `least` size."""
    gap = np.sqrt(max(before**2 - 1.0, 0.0))
    return float(1.0 - np.sqrt(max(after**2 - 1.0, 0.0)) / gap) if gap > least else 0.0
