"""A drag on the body."""

from __future__ import annotations

from ..config_changes import start
from ..effect import Context, Effect, Parameter, Site, law

_VELOCITY = int(Context.VELOCITY)


@law
def _law(time, step, value, context, memory, theta):
    return value - theta[0] * context[_VELOCITY]


EFFECT = Effect(
    id="dynamics.drag",
    equation="F = F_0 - b x'",
    source="Stokes",
    parameters=(Parameter("damping", "N.s/m", 60.0, low=-10000.0, high=10000.0),),
    site=Site.BODY,
    apply=_law,
    written=lambda t, rig: start("satellite", drag=(t["damping"], "N.s/m")),
)
