"""The stiffness falls with time."""

from __future__ import annotations

from ..config_changes import start
from ..effect import Effect, Parameter, Site, law


@law
def _law(time, step, value, context, memory, theta):
    return value * (1.0 - theta[0] * time)


EFFECT = Effect(
    id="contact.softening",
    equation="k = k_0 (1 - s t)",
    source="Fatigue or warming of an elastomer",
    parameters=(Parameter("rate", "1/s", 0.06, low=-0.3, high=0.3),),
    site=Site.STIFFNESS,
    apply=_law,
    written=lambda t, rig: start("contact", softening=(t["rate"], "1/s")),
)
