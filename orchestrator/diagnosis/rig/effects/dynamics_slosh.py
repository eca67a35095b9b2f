"""A sloshing mass."""

from __future__ import annotations

from ..effect import law
from ._oscillator import body_force, hanging

_DAMPING = 0.12  # ratio
_STARTS = (0.8, 1.1, 1.5, 2.1, 3.0, 4.2, 6.0, 8.5)


@law
def _law(time, step, value, context, memory, theta):
    return body_force(step, value, context, memory, theta[0], theta[1], _DAMPING)


EFFECTS = (
    hanging("dynamics.slosh", "A sloshing mass", "Abramson: NASA SP-106, ch. 6", _law, _DAMPING, _STARTS),
)
