"""A second stiffness engages at some depth."""

from __future__ import annotations

from ..config_changes import start
from ..effect import Context, Effect, Parameter, Site, law

_DEPTH = int(Context.DEPTH)
_STIFFNESS = int(Context.STIFFNESS)


@law
def _law(time, step, value, context, memory, theta):
    return value + theta[0] * context[_STIFFNESS] * max(context[_DEPTH] - theta[1], 0.0)


EFFECT = Effect(
    id="contact.second-contact",
    equation="F = k d + r k max(0, d - d_2)",
    source="Piecewise linear contact",
    parameters=(
        Parameter("relative", "1", 0.4, low=-0.9, high=10.0, starts=(0.4,)),
        Parameter("depth", "m", 0.6, low=2e-05, high=0.005, starts=(0.0002, 0.0005, 0.0008), shape=True),
    ),
    site=Site.CONTACT,
    apply=_law,
    written=lambda t, rig: start(
        "contact", second_stiffness=(t["relative"], "1"), second_depth=(t["depth"], "m")
    ),
)
