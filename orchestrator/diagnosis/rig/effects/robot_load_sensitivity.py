"""The contact force disturbs the servo."""

from __future__ import annotations

from ..config_changes import LOAD, ConfigChanges, with_unit
from ..effect import Context, Effect, Parameter, Site, law

_FORCE = int(Context.FORCE)


@law
def _law(time, step, value, context, memory, theta):
    return value + theta[0] * context[_FORCE]


EFFECT = Effect(
    id="robot.load-sensitivity",
    equation="x'' = u + g F",
    source="Siciliano, Sciavicco, Villani, Oriolo: Robotics, sec. 9.2",
    parameters=(Parameter("gain", "m/(s2.N)", 0.05, low=-1.0, high=1.0),),
    site=Site.ACCELERATION,
    apply=_law,
    written=lambda t, rig: ConfigChanges(
        start={"robot": {"load_sensitivity": with_unit(t["gain"], "m/(s2.N)")}}, adds=(LOAD,)
    ),
)
