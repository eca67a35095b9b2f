"""The contact line misses the centre of mass: the effective mass is lower."""

from __future__ import annotations

from ..config_changes import scaled
from ..effect import Effect, Parameter, Site, law


@law
def _law(time, step, value, context, memory, theta):
    return value * (1.0 + theta[0] * theta[0])


EFFECT = Effect(
    id="dynamics.mass-offset",
    equation="1/m_e = (1 + (o/r)^2)/m, r = 1 m",
    source="Eqs. 6 and 7 of the docking source",
    parameters=(Parameter("offset", "m", 0.4, low=0.0, high=5.0, starts=(0.2,)),),
    site=Site.BODY,
    apply=_law,
    written=lambda t, rig: scaled(mass=1.0 / (1.0 + t["offset"] ** 2)),
)
