"""Hardening stiffness."""

from __future__ import annotations

from ..config_changes import start
from ..effect import Context, Effect, Parameter, Site, law

_DEPTH = int(Context.DEPTH)
_STIFFNESS = int(Context.STIFFNESS)


@law
def _law(time, step, value, context, memory, theta):
    depth = context[_DEPTH]
    return value + context[_STIFFNESS] * theta[0] * depth * (depth / 1e-3) ** 2


EFFECT = Effect(
    id="contact.cubic",
    equation="F = k d (1 + a (d/d_0)^2), d_0 = 1 mm",
    source="Nayfeh, Mook: Nonlinear Oscillations, Duffing",
    parameters=(Parameter("hardening", "1", 0.2, low=-0.5, high=5.0),),
    site=Site.CONTACT,
    apply=_law,
    written=lambda t, rig: start("contact", cubic=(t["hardening"], "1")),
)
