"""The stiffness estimate is scaled."""

from __future__ import annotations

from ..effect import Effect, Parameter

EFFECT = Effect(
    id="controller.stiffness-gain",
    equation="k = (1 + g) k_est",
    source="Eq. 29 of the docking source",
    parameters=(Parameter("gain", "1", 0.2, low=-0.95, high=3.0),),
    changes={"stiffness_gain": "gain"},
)
