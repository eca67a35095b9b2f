"""The command link passes every n-th command only."""

from __future__ import annotations

from ..config_changes import COMMAND, ConfigChanges, through, with_unit
from ..effect import Effect, Parameter, Site, law


@law
def _law(time, step, value, context, memory, theta):
    every = round(theta[0])
    tick = round(time / step)
    if memory[1] == 0.0 or (tick + 1) % every == 0:
        memory[0] = value
        memory[1] = 1.0
    return memory[0]


def _written(t, rig) -> ConfigChanges:
    # A command is there from the end of its tick's first step on.
    period = round(t["every"]) * rig["tick"]
    phase = period - rig["tick"] + rig["step"]
    return through(COMMAND, sample_and_hold=with_unit(period, "s"), phase=with_unit(phase, "s"))


EFFECT = Effect(
    id="link.sample-and-hold",
    equation="c[n] = command[N*floor((n + 1)/N) - 1]",
    source="Astrom, Wittenmark: Computer-Controlled Systems, ch. 1",
    parameters=(Parameter("every", "1", 1.0, low=2.0, high=12.0, whole=True),),
    site=Site.COMMAND,
    apply=_law,
    memory=2,
    written=_written,
)
