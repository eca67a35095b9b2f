"""A coarser resolution than specified."""

from __future__ import annotations

from ..config_changes import READING, through, with_unit
from ..effect import Effect, Parameter

EFFECT = Effect(
    id="sensor.quantisation",
    equation="F_m = q round(F/q)",
    source="Widrow, Kollar: Quantization Noise, 2008",
    parameters=(Parameter("step", "N", 1.0, low=0.2, high=20.0),),
    statistic="quantisation",
    written=lambda t, rig: through(READING, quantise=with_unit(t["step"], "N")),
)
