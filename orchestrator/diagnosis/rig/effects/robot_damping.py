"""The damping ratio is another than calibrated."""

from __future__ import annotations

from ..effect import Effect, Parameter

EFFECT = Effect(
    id="robot.damping",
    equation="xi = xi_n (1 + r)",
    source="Eq. 17 of the docking source",
    parameters=(Parameter("relative", "1", 0.3, low=-0.9, high=4.0),),
    changes={"*damping_ratio": "relative"},
)
