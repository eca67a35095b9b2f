"""An error that grows with time."""

from __future__ import annotations

from ..config_changes import READING, through, with_unit
from ..effect import Effect, Parameter, Site, law


@law
def _law(time, step, value, context, memory, theta):
    return value + theta[0] * time


EFFECT = Effect(
    id="sensor.drift",
    equation="F_m = F + d t",
    source="ISO/IEC Guide 98-3 (GUM)",
    parameters=(Parameter("rate", "N/s", 0.5, low=-20.0, high=20.0),),
    site=Site.SAMPLE,
    apply=_law,
    written=lambda t, rig: through(READING, drift=with_unit(t["rate"], "N/s")),
)
