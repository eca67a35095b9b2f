"""Noise with memory."""

from __future__ import annotations

from ..effect import Effect, Parameter

EFFECT = Effect(
    id="sensor.coloured-noise",
    equation="F_m = F + n, n first-order autoregressive",
    source="Box, Jenkins: Time Series Analysis, ch. 3",
    parameters=(Parameter("deviation", "N", 2.0, low=0.0),),
    statistic="coloured-noise",
)
