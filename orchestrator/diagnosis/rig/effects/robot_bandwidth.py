"""The natural frequency is another than calibrated."""

from __future__ import annotations

from ..effect import Effect, Parameter

EFFECT = Effect(
    id="robot.bandwidth",
    equation="omega = omega_n (1 + r)",
    source="Eq. 17 of the docking source",
    parameters=(Parameter("relative", "1", 0.3, low=-0.9, high=4.0),),
    changes={"*natural_frequency": "relative"},
)
