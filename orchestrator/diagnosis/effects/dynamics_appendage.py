"""A flexible appendage."""

from __future__ import annotations

from ..effect import Context, Effect, Parameter, Site, law

_POSITION = int(Context.POSITION)
_VELOCITY = int(Context.VELOCITY)
_MASS = int(Context.MASS)


@law
def _law(time, step, value, context, memory, theta):
    w = theta[1]
    if memory[2] == 0.0:
        memory[0], memory[1], memory[2] = context[_POSITION], context[_VELOCITY], 1.0
    mass = theta[0] * context[_MASS]
    stretch, rate = memory[0] - context[_POSITION], memory[1] - context[_VELOCITY]
    pull = -(w * w * stretch + 0.02 * w * rate)
    memory[1] += step * pull
    memory[0] += step * memory[1]
    return (value - mass * pull) / (1.0 - theta[0])


EFFECT = Effect(
    id="dynamics.appendage",
    equation="m_a (q'' + 2 z w q' + w^2 q) = -m_a x'', (m - m_a) x'' = F - m_a (x'' + q''), z = 0.01",
    source="Hughes: Spacecraft Attitude Dynamics, ch. 3",
    parameters=(
        Parameter("mass", "1", 0.1, low=0.0, high=0.9, starts=(0.05,)),
        Parameter("frequency", "rad/s", 0.8, low=0.5, high=400.0, starts=(8.0, 25.0, 60.0), shape=True),
    ),
    site=Site.BODY,
    apply=_law,
    memory=3,
)
