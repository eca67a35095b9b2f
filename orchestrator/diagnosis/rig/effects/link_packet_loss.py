"""A command is lost with a probability; the last one holds."""

from __future__ import annotations

from ..config_changes import held
from ..effect import Effect, Parameter, Site, law


@law
def _law(time, step, value, context, memory, theta):
    # What arrives in the mean: each command lost leaves the one before.
    if memory[1] == 0.0:
        memory[0], memory[1] = value, 1.0
    memory[0] = theta[0] * memory[0] + (1.0 - theta[0]) * value
    return memory[0]


EFFECT = Effect(
    id="link.packet-loss",
    equation="c[n] = c[n-1] with probability p",
    source="Gilbert: Capacity of a burst-noise channel, memoryless case",
    parameters=(Parameter("probability", "1", 0.1, low=0.0, high=0.95),),
    site=Site.COMMAND,
    apply=_law,
    memory=2,
    statistic="packet-loss",
    written=lambda t, rig: held("dropout", t["probability"], rig),
)
