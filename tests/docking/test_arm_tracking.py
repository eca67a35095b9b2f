"""The bundled approach through the arm: joints and Cartesian response agree to second order in the speed."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.simulation.run import run


def difference(speed: float, *overrides: str) -> tuple[float, float]:
    """Largest distance of the two positions, and of the rod from its command at the end [m]."""
    approach = [f"approach.velocity={speed} mm/s", f"drift.velocity={-0.15 * speed} mm/s"]
    results = run("arm-tracking", overrides=[*approach, *overrides], halving=False).results
    arm, plain = (
        np.array([results[f"{name}.position[{axis}]"] for axis in (1, 2, 3)])
        for name in ("forward", "cartesian")
    )
    lag = results["approach.position"][-1] - results["forward.position[1]"][-1]
    return float(np.abs(arm - plain).max()), float(lag)


def test_joints_and_cartesian_response_agree_to_second_order_in_the_speed():
    slow, _ = difference(20.0)
    fast, _ = difference(40.0)
    assert 1e-11 < slow < 1e-9
    assert fast / slow == pytest.approx(4.0, rel=0.02)


def test_the_arm_lags_as_equation_17_says():
    """Ramp: tau_m + 2 xi_n/omega_n behind; gauss-seidel gives it the step's end at its begin."""
    _, lag = difference(20.0, "run.step_size=0.5 ms")
    assert lag == pytest.approx(0.02 * (2e-3 + 1.6 / 471.23889803846896 - 0.25e-3), rel=2e-3)


def test_a_rail_that_carries_all_moves_no_joint():
    results = run(
        "arm-tracking", overrides=["inverse.rail_share=1", "drift.velocity=0 m/s"], halving=False
    ).results
    for axis in range(2, 8):
        assert np.ptp(results[f"inverse.joint_command[{axis}]"]) < 1e-15
    assert results["inverse.joint_command[1]"][-1] - results["inverse.joint_command[1]"][0] == pytest.approx(
        0.04
    )
