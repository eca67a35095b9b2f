"""An elastic mount between encoder and contact point."""

from __future__ import annotations

from ..config_changes import start
from ..effect import Context, Effect, Parameter, Site, law

_STIFFNESS = int(Context.STIFFNESS)


@law
def _law(time, step, value, context, memory, theta):
    return value / (1.0 + context[_STIFFNESS] * theta[0])


EFFECT = Effect(
    id="structure.compliance",
    equation="F = F_0/(1 + k e)",
    source="Springs in series",
    parameters=(Parameter("compliance", "m/N", 5e-07, low=0.0, high=5e-05, starts=(1e-07, 1e-06)),),
    site=Site.PUSH,
    apply=_law,
    written=lambda t, rig: start("contact", compliance=(t["compliance"], "m/N")),
)
