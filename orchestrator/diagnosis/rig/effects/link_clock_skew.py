"""The clock of the link drifts: the delay grows with time."""

from __future__ import annotations

from ..config_changes import start
from ..effect import Effect, Parameter, Site, law


@law
def _law(time, step, value, context, memory, theta):
    return max(value + theta[0] * time, 0.0)


EFFECT = Effect(
    id="link.clock-skew",
    equation="tau(t) = tau_m + s*t",
    source="Mills: RFC 5905, skew of clocks",
    parameters=(Parameter("skew", "1", 0.0003, low=-0.005, high=0.005, starts=(0.0001, -0.0001)),),
    site=Site.DELAY,
    apply=_law,
    written=lambda t, rig: start("robot", skew=(t["skew"], "1")),
)
