"""The satellite software runs with another mass."""

from __future__ import annotations

from ..config_changes import scaled
from ..effect import Effect, Parameter, Site, law


@law
def _law(time, step, value, context, memory, theta):
    return value / (1.0 + theta[0])


EFFECT = Effect(
    id="dynamics.mass",
    equation="m = m_0 (1 + r)",
    source="Eq. 6 of the docking source",
    parameters=(Parameter("relative", "1", 0.05, low=-0.5, high=2.0),),
    site=Site.BODY,
    apply=_law,
    written=lambda t, rig: scaled(mass=1.0 + t["relative"]),
)
