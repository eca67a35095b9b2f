"""Each command is delayed by a random time more."""

from __future__ import annotations

from ..effect import Effect, Parameter

EFFECT = Effect(
    id="link.jitter",
    equation="tau[n] = tau_m + U(0, J)",
    source="Nilsson: Real-Time Control Systems with Delays, 1998",
    parameters=(Parameter("jitter", "s", 0.001, low=0.0),),
    statistic="jitter",
)
