"""Growth per contact from the characteristic roots, and the delay that explains a growth."""

from __future__ import annotations

from functools import cache
from math import isfinite

from scipy.optimize import brentq

from ...base.errors import OrchestratorError
from ..stability import ContactLoop, predict_contact

_LONGEST = 0.05
_MICROSECOND = 1e-6


@cache
def growth_of_roots(system: str, overrides: tuple[str, ...] = ()) -> float:
    """Factor by which each contact of an undamped frame multiplies the velocity, from the rightmost root.

    Raises: OrchestratorError if no root oscillates.
    """
    growth = ContactLoop.of(system, overrides).growth
    if not isfinite(growth):
        raise OrchestratorError(f"{system}: no root oscillates, so there are no contacts that end")
    return growth


@cache
def delay_for_growth(system: str, growth: float, overrides: tuple[str, ...] = ()) -> float:
    """The robot's pure delay tau_m [s] at which a contact multiplies the velocity by `growth`.

    Of a contact that ends where the frame releases the rod, by the sum over characteristic roots; to a
    microsecond.

    Args:
        system: a docking system with a `robot`, without an active controller.
        growth: velocity after a contact over the velocity before.
        overrides: of the system; its own `robot.tau_m` does not matter.
    Raises: OrchestratorError if no delay up to 50 ms gives this growth.
    """

    def excess(delay: float) -> float:
        changed = ContactLoop.of(system, (*overrides, f"robot.tau_m={delay!r} s"))
        return predict_contact(changed).velocity_ratio - growth

    low, high = excess(0.0), excess(_LONGEST)
    if not low <= 0.0 <= high:
        raise OrchestratorError(
            f"{system}: no delay of the robot from 0 to {_LONGEST:g} s multiplies the velocity by "
            f"{growth:.5g} per contact; reached are {low + growth:.5g} to {high + growth:.5g}"
        )
    return float(brentq(excess, 0.0, _LONGEST, xtol=_MICROSECOND))
