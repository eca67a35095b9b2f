"""The stiffness falls with time."""

from __future__ import annotations

from ..effect import Context, Effect, Parameter, Site, law
from ..written import start

_STIFFNESS = int(Context.STIFFNESS)
_DEPTH = int(Context.DEPTH)


@law
def _law(time, step, value, context, memory, theta):
    return value - theta[0] * time * context[_STIFFNESS] * context[_DEPTH]


EFFECT = Effect(
    id="contact.softening",
    equation="k = k_0 (1 - s t)",
    source="Fatigue or warming of an elastomer",
    parameters=(Parameter("rate", "1/s", 0.06, low=-0.3, high=0.3),),
    site=Site.CONTACT,
    apply=_law,
    written=lambda t, rig: start("contact", softening=(t["rate"], "1/s")),
)
