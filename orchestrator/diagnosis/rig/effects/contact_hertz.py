"""Power-law stiffness."""

from __future__ import annotations

from ..config_changes import start
from ..effect import Context, Effect, Parameter, Site, law

_DEPTH = int(Context.DEPTH)
_STIFFNESS = int(Context.STIFFNESS)


@law
def _law(time, step, value, context, memory, theta):
    depth = context[_DEPTH]
    if depth <= 0.0:
        return value
    return value + context[_STIFFNESS] * depth * ((depth / theta[1]) ** theta[0] - 1.0)


EFFECT = Effect(
    id="contact.hertz",
    equation="F = k d_0 (d/d_0)^(1 + e), the calibrated stiffness holding at d_0",
    source="Johnson: Contact Mechanics, ch. 4",
    parameters=(
        Parameter("exponent", "1", 0.3, low=-0.5, high=2.0, starts=(0.2, -0.2)),
        Parameter("depth", "m", 0.5, low=5e-5, high=1e-2, starts=(5e-4, 1e-3), shape=True),
    ),
    site=Site.CONTACT,
    apply=_law,
    written=lambda t, rig: start(
        "contact", hertz_exponent=(t["exponent"], "1"), hertz_depth=(t["depth"], "m")
    ),
)
