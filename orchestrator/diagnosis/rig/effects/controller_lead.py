"""The lead time is mis-set."""

from __future__ import annotations

from ..effect import Effect, Parameter

EFFECT = Effect(
    id="controller.lead",
    equation="F_l = F + (T_l + d) dF/dt",
    source="Eq. 25 of the docking source",
    parameters=(Parameter("lead", "s", 0.001, low=-0.005, high=0.02),),
    changes={"lead": "lead"},
)
