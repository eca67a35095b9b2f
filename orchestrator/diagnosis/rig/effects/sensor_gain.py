"""A proportional error."""

from __future__ import annotations

from ..config_changes import READING, through
from ..effect import Effect, Parameter, Site, law


@law
def _law(time, step, value, context, memory, theta):
    return (1.0 + theta[0]) * value


EFFECT = Effect(
    id="sensor.gain",
    equation="F_m = (1 + g) F",
    source="ISO/IEC Guide 98-3 (GUM)",
    parameters=(Parameter("gain", "1", 0.1, low=-0.9, high=3.0),),
    site=Site.SAMPLE,
    apply=_law,
    written=lambda t, rig: through(READING, gain=1.0 + t["gain"]),
)
