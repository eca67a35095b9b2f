"""The kinematic model is off by a factor."""

from __future__ import annotations

from ..config_changes import PLACE, RATE, ConfigChanges
from ..effect import Effect, Parameter, Site, law

# Walls are 5 mm away: these move the contact by 5, 50 and 100 um.
_STARTS = (1e-3, -1e-3, 1e-2, -1e-2, 2e-2, -2e-2)


@law
def _law(time, step, value, context, memory, theta):
    return (1.0 + theta[0]) * value


EFFECT = Effect(
    id="structure.kinematic-scale",
    equation="x_c = (1 + s) x",
    source="Mooring, Roth, Driels: Fundamentals of Manipulator Calibration, 1991",
    parameters=(Parameter("scale", "1", 0.01, low=-0.3, high=0.3, starts=_STARTS),),
    site=Site.STRUCTURE,
    apply=_law,
    written=lambda t, rig: ConfigChanges(
        through={one: ({"gain": 1.0 + t["scale"]},) for one in (PLACE, RATE)}
    ),
)
