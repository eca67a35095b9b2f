"""The closed forms of the ideal contact against numerical integration."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from orchestrator.docking.theory import contact_frequency, ideal_peak_force, ideal_restitution

MASS = 279.06976744186045
SPEED = 0.02


def integrate_contact(stiffness: float, damping: float) -> tuple[float, float]:
    """Restitution and peak force of m x'' = -(k x + c x'), left where the force is zero."""

    def force(state):
        return stiffness * state[0] + damping * state[1]

    def leaves(_time, state):
        return force(state)

    leaves.terminal = True
    leaves.direction = -1
    period = 2 * math.pi * math.sqrt(MASS / stiffness)
    zeta = damping / (2 * math.sqrt(stiffness * MASS))
    solution = solve_ivp(
        lambda _time, state: [state[1], -force(state) / MASS],
        (0, period * (1 + 4 * zeta)),
        [0.0, SPEED],
        events=leaves,
        rtol=1e-11,
        atol=1e-15,
        dense_output=True,
    )
    assert solution.status == 1, "the contact must end"
    fine = solution.sol(np.linspace(0, solution.t[-1], 200_001))
    return -solution.y[1, -1] / SPEED, float(np.max(stiffness * fine[0] + damping * fine[1]))


@pytest.mark.parametrize(
    ("stiffness", "damping"),
    [(176e3, 1e-6), (70e3, 100.0), (176e3, 2000.0), (70e3, 8000.0), (70e3, 8839.4), (70e3, 12_000.0)],
)
def test_closed_forms_agree_with_integration(stiffness, damping):
    restitution, peak = integrate_contact(stiffness, damping)
    assert ideal_restitution(stiffness, damping, MASS) == pytest.approx(restitution, rel=1e-7)
    assert ideal_peak_force(stiffness, damping, MASS, SPEED) == pytest.approx(peak, rel=1e-7)


def test_undamped_contact_returns_all_energy():
    assert ideal_restitution(176e3, 0.0, MASS) == 1.0
    assert ideal_peak_force(176e3, 0.0, MASS, SPEED) == pytest.approx(140.17, abs=0.01)


def test_contact_frequency_is_the_papers():
    assert contact_frequency(70e3, MASS) == pytest.approx(2.52, abs=0.005)


def test_virtual_wall_restitution_is_the_papers():
    assert ideal_restitution(70e3, 100.0, MASS) == pytest.approx(0.965, abs=0.001)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0.0, 1.0, 1.0), "stiffness must be positive, got 0.0 N/m"),
        ((1.0, -1.0, 1.0), "damping must not be negative, got -1.0 N.s/m"),
        ((1.0, 1.0, math.nan), "mass must be positive, got nan kg"),
    ],
)
def test_refusals(arguments, message):
    with pytest.raises(ValueError, match=message):
        ideal_restitution(*arguments)
