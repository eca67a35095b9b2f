"""A constant error."""

from __future__ import annotations

from ..effect import Effect, Parameter

EFFECT = Effect(
    id="sensor.bias",
    equation="F_m = F + b",
    source="ISO/IEC Guide 98-3 (GUM)",
    parameters=(Parameter("bias", "N", 1.5, low=-50.0, high=50.0),),
    changes={"force_bias": "bias"},
)
