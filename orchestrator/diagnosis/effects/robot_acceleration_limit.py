"""The servo has a highest acceleration."""

from __future__ import annotations

from ..effect import Effect, Parameter, Site, law
from ..written import start


@law
def _law(time, step, value, context, memory, theta):
    return min(max(value, -theta[0]), theta[0])


EFFECT = Effect(
    id="robot.acceleration-limit",
    equation="|x''| <= A",
    source="Slotine, Li: Applied Nonlinear Control, ch. 5",
    parameters=(Parameter("limit", "m/s2", 1.0, low=0.01, high=1000.0, starts=(0.1, 0.3, 0.8), shape=True),),
    site=Site.LIMIT,
    apply=_law,
    written=lambda t, rig: start("robot", acceleration_limit=(t["limit"], "m/s2")),
)
