"""Coulomb friction with a Stribeck excess in the servo."""

from __future__ import annotations

import math

from ..config_changes import start
from ..effect import Context, Effect, Parameter, Site, law

_VELOCITY = int(Context.VELOCITY)


@law
def _law(time, step, value, context, memory, theta):
    rate = context[_VELOCITY]
    excess = 1.0 + theta[1] * math.exp(-((rate / 2e-3) ** 2))
    return value - theta[0] * math.tanh(rate / 2e-4) * excess


EFFECT = Effect(
    id="robot.friction",
    equation="x'' = u - a tanh(x'/v0) (1 + s exp(-(x'/v_s)^2)), v0 = 0.2 mm/s, v_s = 2 mm/s",
    source="Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30, 1994",
    parameters=(
        Parameter("coulomb", "m/s2", 1.0, low=0.0, high=50.0, starts=(0.5,)),
        Parameter("stribeck", "1", 0.5, low=0.0, high=3.0, starts=(0.3,), shape=True),
    ),
    site=Site.ACCELERATION,
    apply=_law,
    written=lambda t, rig: start("robot", friction=(t["coulomb"], "m/s2"), stribeck=(t["stribeck"], "1")),
)
