"""Front and rear stiffness differ."""

from __future__ import annotations

from ..config_changes import start
from ..effect import Context, Effect, Parameter, Site, law

_SIDE = int(Context.SIDE)


@law
def _law(time, step, value, context, memory, theta):
    return value * (1.0 - theta[0] * context[_SIDE])


EFFECT = Effect(
    id="contact.asymmetry",
    equation="k = k_0 (1 - a) at the front frame, k_0 (1 + a) at the rear",
    source="Eq. 20 of the docking source, per frame",
    parameters=(Parameter("asymmetry", "1", 0.08, low=-0.9, high=0.9),),
    site=Site.STIFFNESS,
    apply=_law,
    written=lambda t, rig: start("contact", asymmetry=(t["asymmetry"], "1")),
)
