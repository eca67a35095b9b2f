"""A pull-off force."""

from __future__ import annotations

import math

from ..config_changes import start
from ..effect import Context, Effect, Parameter, Site, law

_SIDE, _DEPTH = int(Context.SIDE), int(Context.DEPTH)
_POSITION, _VELOCITY = int(Context.POSITION), int(Context.VELOCITY)


@law
def _law(time, step, value, context, memory, theta):
    if context[_SIDE] != 0.0:
        memory[0] = context[_SIDE]
        memory[1] = context[_POSITION] - context[_SIDE] * context[_DEPTH]  # surface of the frame
    side = memory[0]
    if side == 0.0 or side * context[_VELOCITY] >= 0.0:
        return value
    return value + side * theta[0] * math.exp(-abs(context[_POSITION] - memory[1]) / theta[1])


EFFECT = Effect(
    id="contact.adhesion",
    equation="A exp(-|g|/r) pulls while the surfaces part, g the gap, negative in contact",
    source="Israelachvili: Intermolecular and Surface Forces, ch. 17 (adhesion hysteresis)",
    parameters=(
        Parameter("force", "N", 2.0, low=0.0, high=100.0, starts=(1.0,)),
        Parameter("range", "m", 0.7, low=2e-6, high=1e-3, starts=(3e-5,), shape=True),
    ),
    site=Site.FORCE,
    apply=_law,
    memory=2,
    written=lambda t, rig: start("contact", adhesion=(t["force"], "N"), adhesion_range=(t["range"], "m")),
)
