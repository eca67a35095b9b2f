"""Play at the output of the drive."""

from __future__ import annotations

from ..config_changes import start
from ..effect import Effect, Parameter, Site, law


@law
def _law(time, step, value, context, memory, theta):
    half = 0.5 * theta[0]
    if memory[1] == 0.0:
        memory[0], memory[1] = value, 1.0
    memory[0] = min(max(memory[0], value - half), value + half)
    return memory[0]


EFFECT = Effect(
    id="robot.backlash",
    equation="|x_out - x| <= b/2, x_out moves only when pushed",
    source="Nordin, Gutman: Controlling mechanical systems with backlash, Automatica 38, 2002",
    parameters=(Parameter("width", "m", 0.0002, low=0.0, high=0.005, starts=(2e-05, 0.0001, 0.0003)),),
    site=Site.POSITION,
    apply=_law,
    memory=2,
    written=lambda t, rig: start("robot", backlash=(t["width"], "m")),
)
