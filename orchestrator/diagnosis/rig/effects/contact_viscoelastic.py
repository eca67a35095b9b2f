"""A relaxing force in parallel (Maxwell element)."""

from __future__ import annotations

import math

from ..config_changes import start
from ..effect import Context, Effect, Parameter, Site, law

_DEPTH = int(Context.DEPTH)
_DEPTH_RATE = int(Context.DEPTH_RATE)
_STIFFNESS = int(Context.STIFFNESS)


@law
def _law(time, step, value, context, memory, theta):
    if context[_DEPTH] <= 0.0:
        memory[0] = 0.0
        return value
    keep = math.exp(-step / theta[1])
    memory[0] = keep * memory[0] + theta[1] * (1.0 - keep) * context[_DEPTH_RATE]
    return value + theta[0] * context[_STIFFNESS] * memory[0]


EFFECT = Effect(
    id="contact.viscoelastic",
    equation="z' = d' - z/T, F = k d + r k z",
    source="Flugge: Viscoelasticity, ch. 1",
    parameters=(
        Parameter("relative", "1", 0.3, low=-0.9, high=5.0, starts=(0.2,)),
        Parameter("time", "s", 0.8, low=0.001, high=2.0, starts=(0.01, 0.03, 0.1), shape=True),
    ),
    site=Site.CONTACT,
    apply=_law,
    memory=1,
    written=lambda t, rig: start("contact", maxwell=(t["relative"], "1"), maxwell_time=(t["time"], "s")),
)
