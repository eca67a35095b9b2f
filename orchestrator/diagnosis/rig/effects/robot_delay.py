"""The response has more pure delay than calibrated."""

from __future__ import annotations

from ..effect import Effect, Parameter

EFFECT = Effect(
    id="robot.delay",
    equation="tau = tau_m + d",
    source="Eq. 17 of the docking source",
    parameters=(Parameter("delay", "s", 0.002, low=-0.002, high=0.02),),
    changes={"response_delay": "delay"},
)
