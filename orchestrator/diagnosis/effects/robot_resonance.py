"""A lightly damped mode of the structure, seen by the encoder."""

from __future__ import annotations

from ..effect import Context, Effect, Parameter, Site, law
from ..written import start

_ACCELERATION = int(Context.ACCELERATION)


@law
def _law(time, step, value, context, memory, theta):
    if step > 0.0:
        w = theta[1]
        memory[1] += step * (-theta[0] * context[_ACCELERATION] - w * w * memory[0] - 0.06 * w * memory[1])
        memory[0] += step * memory[1]
    return value + memory[0]


EFFECT = Effect(
    id="robot.resonance",
    equation="q'' + 2 z w q' + w^2 q = -g x'', x_out = x + q, z = 0.03",
    source="Spong: Modeling and control of elastic joint robots, 1987",
    parameters=(
        Parameter("gain", "1", 0.5, low=-5.0, high=5.0, starts=(0.2,)),
        Parameter(
            "frequency", "rad/s", 0.6, low=12.0, high=600.0, starts=(40.0, 85.0, 160.0, 300.0), shape=True
        ),
    ),
    site=Site.POSITION,
    apply=_law,
    memory=2,
    written=lambda t, rig: start(
        "robot", resonance_gain=(t["gain"], "1"), resonance_frequency=(t["frequency"], "rad/s")
    ),
)
