"""Effects of the structure between robot and rod."""

from __future__ import annotations

from ..config_changes import PLACE, RATE, ConfigChanges, start, through, with_unit
from ..effect import Context, Effect, Parameter, Site, law

_STIFFNESS = int(Context.STIFFNESS)


@law
def _compliance(time, step, value, context, memory, theta):
    return value / (1.0 + context[_STIFFNESS] * theta[0])


# Walls are 5 mm away: these move the contact by 5, 50 and 100 um.
_KINEMATIC_SCALE_STARTS = (1e-3, -1e-3, 1e-2, -1e-2, 2e-2, -2e-2)


@law
def _kinematic_scale(time, step, value, context, memory, theta):
    return (1.0 + theta[0]) * value


# Between these the depth of contacts, and with it the force, hardly says which way to go.
_OFFSET_STARTS = (1e-5, -1e-5, 1e-4, -1e-4, 3e-4, -3e-4)


@law
def _offset(time, step, value, context, memory, theta):
    return value - theta[0]


EFFECTS = (
    Effect(
        id="structure.compliance",
        words="An elastic mount between encoder and contact point",
        equation="F = F_0/(1 + k e)",
        source="Springs in series",
        parameters=(Parameter("compliance", "m/N", 5e-07, low=0.0, high=5e-05, starts=(1e-07, 1e-06)),),
        site=Site.PUSH,
        apply=_compliance,
        written=lambda t, rig: start("contact", compliance=(t["compliance"], "m/N")),
    ),
    Effect(
        id="structure.kinematic-scale",
        words="The kinematic model is off by a factor",
        equation="x_c = (1 + s) x",
        source="Mooring, Roth, Driels: Fundamentals of Manipulator Calibration, 1991",
        parameters=(Parameter("scale", "1", 0.01, low=-0.3, high=0.3, starts=_KINEMATIC_SCALE_STARTS),),
        site=Site.STRUCTURE,
        apply=_kinematic_scale,
        written=lambda t, rig: ConfigChanges(
            through={one: ({"gain": 1.0 + t["scale"]},) for one in (PLACE, RATE)}
        ),
    ),
    Effect(
        id="structure.offset",
        words="The contact point is off by a constant (sag)",
        equation="x_c = x - o",
        source="Mooring, Roth, Driels: Fundamentals of Manipulator Calibration, 1991",
        parameters=(Parameter("offset", "m", 0.0002, low=-0.005, high=0.005, starts=_OFFSET_STARTS),),
        site=Site.STRUCTURE,
        apply=_offset,
        written=lambda t, rig: through(PLACE, offset=with_unit(-t["offset"], "m")),
    ),
)
