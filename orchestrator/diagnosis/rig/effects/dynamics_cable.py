"""A spring on the body."""

from __future__ import annotations

from ..config_changes import start
from ..effect import Context, Effect, Parameter, Site, law

_POSITION = int(Context.POSITION)


@law
def _law(time, step, value, context, memory, theta):
    return value - theta[0] * context[_POSITION]


EFFECT = Effect(
    id="dynamics.cable",
    equation="F = F_0 - k x",
    source="Hooke",
    parameters=(Parameter("stiffness", "N/m", 1000.0, low=-100000.0, high=100000.0),),
    site=Site.BODY,
    apply=_law,
    written=lambda t, rig: start("satellite", cable_stiffness=(t["stiffness"], "N/m")),
)
