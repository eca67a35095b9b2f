"""A force against the direction of penetration."""

from __future__ import annotations

import math

from ..config_changes import start
from ..effect import Context, Effect, Parameter, Site, law

_DEPTH_RATE = int(Context.DEPTH_RATE)


@law
def _law(time, step, value, context, memory, theta):
    return value * (1.0 + theta[0] * math.tanh(context[_DEPTH_RATE] / theta[1]))


EFFECT = Effect(
    id="contact.friction",
    equation="F = F_0 (1 + f tanh(d'/v_0))",
    source="Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30, 1994",
    parameters=(
        Parameter("coefficient", "1", 0.05, low=-0.9, high=0.9),
        Parameter("speed", "m/s", 0.7, low=1e-5, high=0.1, starts=(1e-3,), shape=True),
    ),
    site=Site.PUSH,
    apply=_law,
    written=lambda t, rig: start(
        "contact", friction=(t["coefficient"], "1"), friction_velocity=(t["speed"], "m/s")
    ),
)
