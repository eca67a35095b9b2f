"""Samples are lost with a probability; the last one holds."""

from __future__ import annotations

from ..config_changes import READING, SEED, through, with_unit
from ..effect import Effect, Parameter

EFFECT = Effect(
    id="sensor.dropout",
    equation="F_m[n] = F_m[n-1] with probability p",
    source="Gilbert: Capacity of a burst-noise channel, memoryless case",
    parameters=(Parameter("probability", "1", 0.15, low=0.0, high=1.0),),
    statistic="dropout",
    written=lambda t, rig: through(
        READING, dropout=t["probability"], period=with_unit(rig["tick"], "s"), seed=SEED
    ),
)
