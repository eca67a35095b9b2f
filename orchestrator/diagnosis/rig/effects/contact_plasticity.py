"""A permanent set: unloading is steeper than loading."""

from __future__ import annotations

from ..config_changes import start
from ..effect import Context, Effect, Parameter, Site, law

_DEPTH = int(Context.DEPTH)
_STIFFNESS = int(Context.STIFFNESS)


@law
def _law(time, step, value, context, memory, theta):
    depth = context[_DEPTH]
    if depth <= 0.0:
        memory[0] = 0.0
        return value
    memory[0] = max(memory[0], depth)
    if depth >= memory[0]:
        return value
    return value + context[_STIFFNESS] * ((depth - theta[0] * memory[0]) / (1.0 - theta[0]) - depth)


EFFECT = Effect(
    id="contact.plasticity",
    equation="unloading from d_m: F = k d_m (d - p d_m)/(d_m (1 - p))",
    source="Johnson: Contact Mechanics, ch. 6",
    parameters=(Parameter("set", "1", 0.05, low=0.0, high=0.9, starts=(0.03,)),),
    site=Site.CONTACT,
    apply=_law,
    memory=1,
    written=lambda t, rig: start("contact", plastic_set=(t["set"], "1")),
)
