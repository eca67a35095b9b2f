"""Noise with memory."""

from __future__ import annotations

import math

from ..config_changes import READING, SEED, ConfigChanges, through, with_unit
from ..effect import Effect, Parameter

_KEEP = 0.9  # of the noise per tick; statistics estimate its deviation only


def _written(t, rig) -> ConfigChanges:
    correlation = -rig["tick"] / math.log(_KEEP)
    return through(
        READING,
        noise=with_unit(t["deviation"], "N"),
        period=with_unit(rig["tick"], "s"),
        correlation=with_unit(correlation, "s"),
        seed=SEED,
    )


EFFECT = Effect(
    id="sensor.coloured-noise",
    equation="F_m = F + n, n first-order autoregressive",
    source="Box, Jenkins: Time Series Analysis, ch. 3",
    parameters=(Parameter("deviation", "N", 2.0, low=0.0),),
    statistic="coloured-noise",
    written=_written,
)
