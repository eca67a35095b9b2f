"""A pull-off force."""

from __future__ import annotations

from ..effect import Context, Effect, Parameter, Site, law
from ..written import start

_SIDE = int(Context.SIDE)


@law
def _law(time, step, value, context, memory, theta):
    if context[_SIDE] == 0.0:
        return value
    return value + context[_SIDE] * theta[0]


EFFECT = Effect(
    id="contact.adhesion",
    equation="F = max(0, k d) - A while in contact",
    source="Johnson: Contact Mechanics, ch. 5",
    parameters=(Parameter("force", "N", 2.0, low=0.0, high=100.0, starts=(1.0,)),),
    site=Site.FORCE,
    apply=_law,
    written=lambda t, rig: start("contact", adhesion=(t["force"], "N")),
)
