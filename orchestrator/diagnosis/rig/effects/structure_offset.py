"""The contact point is off by a constant (sag)."""

from __future__ import annotations

from ..config_changes import PLACE, through, with_unit
from ..effect import Effect, Parameter, Site, law

# Between these the depth of contacts, and with it the force, hardly says which way to go.
_STARTS = (1e-5, -1e-5, 1e-4, -1e-4, 3e-4, -3e-4)


@law
def _law(time, step, value, context, memory, theta):
    return value - theta[0]


EFFECT = Effect(
    id="structure.offset",
    equation="x_c = x - o",
    source="Mooring, Roth, Driels: Fundamentals of Manipulator Calibration, 1991",
    parameters=(Parameter("offset", "m", 0.0002, low=-0.005, high=0.005, starts=_STARTS),),
    site=Site.STRUCTURE,
    apply=_law,
    written=lambda t, rig: through(PLACE, offset=with_unit(-t["offset"], "m")),
)
