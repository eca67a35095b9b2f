"""A flexible appendage."""

from __future__ import annotations

from ..effect import Effect, Parameter, Site, law
from ..written import start
from ._oscillator import body_force

_DAMPING = 0.01  # ratio
# From 2 to 100 rad/s: a mode that hardly decays is only found from within a turn over the run or so.
_STARTS = tuple(2.0 * 50.0 ** (place / 63) for place in range(64))


@law
def _law(time, step, value, context, memory, theta):
    return body_force(step, value, context, memory, theta[0], theta[1], _DAMPING)


EFFECT = Effect(
    id="dynamics.appendage",
    equation="m_a (q'' + 2 z w q' + w^2 q) = -m_a x'', (m - m_a) x'' = F - m_a (x'' + q''), z = 0.01",
    source="Hughes: Spacecraft Attitude Dynamics, ch. 3",
    parameters=(
        Parameter("mass", "1", 0.1, low=0.0, high=0.9, starts=(0.05,)),
        Parameter("frequency", "rad/s", 0.8, low=0.5, high=400.0, starts=_STARTS, shape=True),
    ),
    site=Site.BODY,
    apply=_law,
    memory=3,
    written=lambda t, rig: start(
        "satellite",
        hanging_share=(t["mass"], "1"),
        hanging_frequency=(t["frequency"], "rad/s"),
        hanging_damping=(_DAMPING, "1"),
    ),
)
