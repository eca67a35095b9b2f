"""The servo has a highest speed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from ..config_changes import start
from ..effect import Effect, Parameter, Seen, Site, law

# Ticks over which a speed is taken, and the share of the highest one at which a servo counts as limited.
_TICKS, _AT = 61, 0.99
# A limit lies there or a little above: a servo is faster for a moment after each command, and the limit then
# shows in its mean speed alone.
_ABOVE = (1.0, 1.0025, 1.005, 1.01, 1.02)


@law
def _law(time, step, value, context, memory, theta):
    return min(max(value, -theta[0]), theta[0])


def _propose(seen: Seen) -> Sequence[tuple[float, ...]]:
    """A limit shows as the speed that the robot has wherever it is fast.

    A servo at its limit falls behind: with a limit that is a little off a replay is soon far away, and no
    derivative leads from there to the right one.
    """
    if min(map(len, seen.position)) <= _TICKS:
        return []
    found = np.abs(np.concatenate([_speed(one, seen.tick) for one in seen.position]))
    highest = float(np.quantile(found, 0.995))
    if highest == 0.0:
        return []
    shown = float(np.median(found[found > _AT * highest]))
    return [(factor * shown,) for factor in _ABOVE]


def _speed(position: NDArray[np.float64], tick: float) -> NDArray[np.float64]:
    return savgol_filter(position, _TICKS, 2, deriv=1, delta=tick)


EFFECTS = (
    Effect(
        id="robot.rate-limit",
        words="The servo has a highest speed",
        equation="|x'| <= V",
        source="Slotine, Li: Applied Nonlinear Control, ch. 5",
        parameters=(Parameter("limit", "m/s", 1.0, low=0.001, high=10.0, starts=(0.015, 0.022), shape=True),),
        site=Site.RATE,
        apply=_law,
        written=lambda t, rig: start("robot", rate_limit=(t["limit"], "m/s")),
        propose=_propose,
    ),
)
