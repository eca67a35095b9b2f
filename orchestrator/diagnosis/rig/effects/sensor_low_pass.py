"""A further first-order filter."""

from __future__ import annotations

import math

from ..config_changes import FORCE, through, with_unit
from ..effect import Effect, Parameter, Site, law


@law
def _law(time, step, value, context, memory, theta):
    if theta[0] <= 0.0:
        return value
    keep = math.exp(-step / theta[0])
    out = keep * memory[0] + (1.0 - keep) * 0.5 * (value + memory[1])
    memory[0], memory[1] = out, value
    return out


EFFECT = Effect(
    id="sensor.low-pass",
    equation="T F_m' + F_m = F",
    source="Oppenheim, Willsky: Signals and Systems, ch. 6",
    parameters=(Parameter("time_constant", "s", 0.001, low=0.0, high=0.02, starts=(0.0003, 0.0015)),),
    site=Site.FORCE,
    apply=_law,
    memory=2,
    written=lambda t, rig: through(FORCE, low_pass={"time_constant": with_unit(t["time_constant"], "s")}),
)
