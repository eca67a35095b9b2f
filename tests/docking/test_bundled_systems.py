"""The bundled docking systems against the characteristic roots of the loop, with every master."""

import cmath
import math

import pytest

from orchestrator.run import run

MASS = 279.06976744186045
STIFFNESS = 176e3


def growth_per_contact(omega_n: float, xi_n: float, tau_m: float) -> float:
    """exp(pi sigma/omega) of the root near the contact frequency of

        m s^2 (s^2 + 2 xi_n omega_n s + omega_n^2) + k omega_n^2 exp(-tau_m s) = 0.

    A half-oscillation of the closed loop is one contact. Newton's method from the undelayed root.
    """
    s = 1j * math.sqrt(STIFFNESS / MASS)
    for _ in range(50):
        denominator = s * s + 2 * xi_n * omega_n * s + omega_n**2
        delay = STIFFNESS * omega_n**2 * cmath.exp(-tau_m * s)
        value = MASS * s * s * denominator + delay
        slope = MASS * (2 * s * denominator + s * s * (2 * s + 2 * xi_n * omega_n)) - tau_m * delay
        s -= value / slope
    assert abs(value) < 1e-6 * abs(delay)
    return math.exp(math.pi * s.real / s.imag)


def ratios(result) -> list[float]:
    return [contact["rebound_velocity_ratio"] for contact in result.summary["contacts"]]


@pytest.mark.parametrize(
    ("frequency", "tau_ms", "published"),
    [(75, 2, 1.2356), (75, 4, 1.3346), (75, 6, 1.4400), (25, 2, 1.592), (50, 2, 1.319), (100, 2, 1.1956)],
)
def test_uncompensated_rebounds_grow_as_the_roots_say(frequency, tau_ms, published):
    expected = growth_per_contact(2 * math.pi * frequency, 0.8, tau_ms * 1e-3)
    assert expected == pytest.approx(published, rel=3e-4)
    overrides = [f"robot.tau_m={tau_ms} ms", f"robot.omega_n={frequency} Hz", "run.stop_time=2.4 s"]
    result = run("docking-1d-uncompensated", overrides=overrides)
    found = ratios(result)
    assert len(found) >= 4
    for index, ratio in enumerate(found[:8], start=1):
        assert ratio == pytest.approx((-expected) ** index, rel=1e-3 * index)
    changes = [entry["rebound_velocity_ratio"] for entry in result.summary["numerics"]["contacts"]]
    assert all(abs(change) < 1e-3 * abs(ratio) for change, ratio in zip(changes, found, strict=False))
