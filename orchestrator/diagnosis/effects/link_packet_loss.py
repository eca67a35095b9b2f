"""A command is lost with a probability; the last one holds."""

from __future__ import annotations

from ..effect import Effect, Parameter

EFFECT = Effect(
    id="link.packet-loss",
    equation="c[n] = c[n-1] with probability p",
    source="Gilbert: Capacity of a burst-noise channel, memoryless case",
    parameters=(Parameter("probability", "1", 0.1, low=0.0, high=1.0),),
    statistic="packet-loss",
)
