"""The measurement has more pure delay than calibrated."""

from __future__ import annotations

from ..effect import Effect, Parameter

EFFECT = Effect(
    id="sensor.delay",
    equation="F_m(t) = F(t - tau_s - d)",
    source="Eq. 25 of the docking source",
    parameters=(Parameter("delay", "s", 0.0005, low=-0.001, high=0.01),),
    changes={"sensor_delay": "delay"},
)
