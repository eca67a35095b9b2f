"""The robot rounds its commands to a step."""

from __future__ import annotations

import math

from ..effect import Effect, Parameter, Site, law
from ..written import COMMAND, through, with_unit


@law
def _law(time, step, value, context, memory, theta):
    return theta[0] * math.floor(value / theta[0] + 0.5)


EFFECT = Effect(
    id="robot.command-quantisation",
    equation="c = q round(command/q)",
    source="Widrow, Kollar: Quantization Noise, 2008",
    parameters=(
        Parameter(
            "step",
            "m",
            1e-05,
            low=2e-06,
            high=0.0002,
            starts=(5e-06, 1e-05, 2e-05, 5e-05, 0.0001),
            shape=True,
        ),
    ),
    site=Site.COMMAND,
    apply=_law,
    written=lambda t, rig: through(COMMAND, quantise=with_unit(t["step"], "m")),
)
