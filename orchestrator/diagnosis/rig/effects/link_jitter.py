"""Each command is delayed by a random time more."""

from __future__ import annotations

from ..config_changes import held, with_unit
from ..effect import Effect, Parameter, Site, law


@law
def _law(time, step, value, context, memory, theta):
    return value + 0.5 * theta[0]  # the mean


EFFECT = Effect(
    id="link.jitter",
    equation="tau[n] = tau_m + U(0, J)",
    source="Nilsson: Real-Time Control Systems with Delays, 1998",
    parameters=(Parameter("jitter", "s", 0.001, low=0.0, high=0.01),),
    site=Site.DELAY,
    apply=_law,
    statistic="jitter",
    written=lambda t, rig: held("jitter", with_unit(t["jitter"], "s"), rig),
)
