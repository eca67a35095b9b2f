"""Damping in proportion to the penetration."""

from __future__ import annotations

from ..config_changes import start
from ..effect import Context, Effect, Parameter, Site, law

_DEPTH = int(Context.DEPTH)
_DEPTH_RATE = int(Context.DEPTH_RATE)


@law
def _law(time, step, value, context, memory, theta):
    return value + theta[0] * context[_DEPTH] * context[_DEPTH_RATE]


EFFECT = Effect(
    id="contact.hunt-crossley",
    equation="F = k d + h d d'",
    source="Hunt, Crossley, J. Applied Mechanics 42, 1975",
    parameters=(Parameter("damping", "N.s/m2", 150000.0, low=-500000.0, high=5000000.0),),
    site=Site.CONTACT,
    apply=_law,
    written=lambda t, rig: start("contact", hunt_crossley=(t["damping"], "N.s/m2")),
)
