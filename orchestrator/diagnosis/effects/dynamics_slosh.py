"""A sloshing mass."""

from __future__ import annotations

from ..effect import Effect, Parameter, Site, law
from ..written import start
from ._oscillator import body_force

_DAMPING = 0.12  # ratio


@law
def _law(time, step, value, context, memory, theta):
    return body_force(step, value, context, memory, theta[0], theta[1], _DAMPING)


EFFECT = Effect(
    id="dynamics.slosh",
    equation="m_a (q'' + 2 z w q' + w^2 q) = -m_a x'', (m - m_a) x'' = F - m_a (x'' + q''), z = 0.12",
    source="Abramson: NASA SP-106, ch. 6",
    parameters=(
        Parameter("mass", "1", 0.1, low=0.0, high=0.9, starts=(0.05,)),
        Parameter(
            "frequency",
            "rad/s",
            0.8,
            low=0.5,
            high=400.0,
            starts=(0.8, 1.1, 1.5, 2.1, 3.0, 4.2, 6.0, 8.5),
            shape=True,
        ),
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
