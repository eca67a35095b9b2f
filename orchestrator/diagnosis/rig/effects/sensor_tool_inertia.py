"""The tool in front of the sensor adds its inertia force."""

from __future__ import annotations

from ..config_changes import TOOL, ConfigChanges, with_unit
from ..effect import Context, Effect, Parameter, Site, law

_ACCELERATION = int(Context.ACCELERATION)


@law
def _law(time, step, value, context, memory, theta):
    return value - theta[0] * context[_ACCELERATION]


EFFECT = Effect(
    id="sensor.tool-inertia",
    equation="F_m = F - m x''",
    source="Kubus, Kroger, Wahl: On-line estimation of inertial parameters, IROS 2008",
    parameters=(Parameter("mass", "kg", 5.0, low=-50.0, high=50.0),),
    site=Site.FORCE,
    apply=_law,
    # The robot, too: the tool feels a first command that does not continue the motion before the start.
    written=lambda t, rig: ConfigChanges(
        start={"sensor": {"tool_mass": with_unit(t["mass"], "kg")}, "robot": {}}, adds=(TOOL,)
    ),
)
