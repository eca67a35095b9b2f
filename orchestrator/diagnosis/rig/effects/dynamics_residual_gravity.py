"""A constant acceleration on the body."""

from __future__ import annotations

from ..config_changes import BODY, through, with_unit
from ..effect import Context, Effect, Parameter, Site, law

_MASS = int(Context.MASS)


@law
def _law(time, step, value, context, memory, theta):
    return value + context[_MASS] * theta[0]


EFFECT = Effect(
    id="dynamics.residual-gravity",
    equation="F = F_0 + m g",
    source="Newton",
    parameters=(Parameter("acceleration", "m/s2", 0.002, low=-1.0, high=1.0),),
    site=Site.BODY,
    apply=_law,
    written=lambda t, rig: through(BODY, offset=with_unit(t["acceleration"] * rig["mass"], "N")),
)
