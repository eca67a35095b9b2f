"""The servo has a highest speed."""

from __future__ import annotations

from ..effect import Effect, Parameter, Site, law
from ..written import start


@law
def _law(time, step, value, context, memory, theta):
    return min(max(value, -theta[0]), theta[0])


EFFECT = Effect(
    id="robot.rate-limit",
    equation="|x'| <= V",
    source="Slotine, Li: Applied Nonlinear Control, ch. 5",
    parameters=(Parameter("limit", "m/s", 1.0, low=0.001, high=10.0, starts=(0.015, 0.022), shape=True),),
    site=Site.RATE,
    apply=_law,
    written=lambda t, rig: start("robot", rate_limit=(t["limit"], "m/s")),
)
