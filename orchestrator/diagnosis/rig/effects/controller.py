"""Effects of the controller in software."""

from __future__ import annotations

from ..effect import Effect, Parameter

EFFECTS = (
    Effect(
        id="controller.lead",
        words="The lead time is mis-set",
        equation="F_l = F + (T_l + d) dF/dt",
        source="Eq. 25 of the docking source",
        parameters=(Parameter("lead", "s", 0.001, low=-0.005, high=0.02),),
        changes={"lead": "lead"},
    ),
    Effect(
        id="controller.stiffness-gain",
        words="The stiffness estimate is scaled",
        equation="k = (1 + g) k_est",
        source="Eq. 29 of the docking source",
        parameters=(Parameter("gain", "1", 0.2, low=-0.95, high=3.0),),
        changes={"stiffness_gain": "gain"},
    ),
)
