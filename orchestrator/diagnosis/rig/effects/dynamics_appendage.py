"""A flexible appendage."""

from __future__ import annotations

from ..effect import law
from ._oscillator import body_force, hanging

_DAMPING = 0.01  # ratio
# From 2 to 100 rad/s: a mode that hardly decays is only found from within a turn over the run or so.
_STARTS = tuple(2.0 * 50.0 ** (place / 63) for place in range(64))


@law
def _law(time, step, value, context, memory, theta):
    return body_force(step, value, context, memory, theta[0], theta[1], _DAMPING)


EFFECTS = (
    hanging(
        "dynamics.appendage",
        "A flexible appendage",
        "Hughes: Spacecraft Attitude Dynamics, ch. 3",
        _law,
        _DAMPING,
        _STARTS,
    ),
)
