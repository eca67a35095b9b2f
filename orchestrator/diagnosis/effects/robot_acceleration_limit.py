"""The servo has a highest acceleration."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from ..effect import Effect, Parameter, Seen, Site, law
from ..written import start

# Ticks over which an acceleration is taken; it is bounded where commands ask for so many times as much.
_TICKS, _BOUNDED = 61, 1.5
# A servo that runs into its limit again and again goes far astray with a limit that is a little off: starts
# lie so far around the one seen, so many of them.
_AROUND, _STARTS = 0.04, 17


@law
def _law(time, step, value, context, memory, theta):
    return min(max(value, -theta[0]), theta[0])


def _propose(seen: Seen) -> Sequence[tuple[float, ...]]:
    """A limit shows as the size that the acceleration mostly has, while commands ask for more."""
    if min(map(len, seen.position)) <= _TICKS:
        return []
    found, asked = (
        np.abs(np.concatenate([_acceleration(one, seen.tick) for one in signals]))
        for signals in (seen.position, seen.commands)
    )
    highest = float(np.quantile(found, 0.99))
    if float(np.quantile(asked, 0.99)) < _BOUNDED * highest:
        return []
    limit = float(np.median(found[found > 0.5 * highest]))
    return [(limit * factor,) for factor in np.linspace(1.0 - _AROUND, 1.0 + _AROUND, _STARTS).tolist()]


def _acceleration(position: NDArray[np.float64], tick: float) -> NDArray[np.float64]:
    return savgol_filter(position, _TICKS, 2, deriv=2, delta=tick)


EFFECT = Effect(
    id="robot.acceleration-limit",
    equation="|x''| <= A",
    source="Slotine, Li: Applied Nonlinear Control, ch. 5",
    parameters=(Parameter("limit", "m/s2", 1.0, low=0.01, high=1000.0, starts=(0.1, 0.3, 0.8), shape=True),),
    site=Site.LIMIT,
    apply=_law,
    written=lambda t, rig: start("robot", acceleration_limit=(t["limit"], "m/s2")),
    propose=_propose,
)
