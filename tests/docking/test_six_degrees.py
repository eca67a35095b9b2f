"""The bundled system in six degrees of freedom: conservation, energy with and without the controller."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.run import run


def stacked(results, name, length=3):
    return np.column_stack([results[f"{name}[{i}]"] for i in range(1, length + 1)])


def free_energies(results):
    """Kinetic energy before each contact, over the initial one."""
    touching = (stacked(results, "contact.force") != 0.0).any(axis=1)
    onsets = np.flatnonzero(np.diff(touching.astype(int), prepend=0) == 1)
    energy = results["satellites.kinetic_energy"]
    return energy[onsets - 1] / energy[0]


@pytest.mark.parametrize(
    ("mode", "time", "low", "high"), [("active", "4 s", 1.0, 1.0003), ("off", "2 s", 5.0, 12.0)]
)
def test_energy_is_bounded_with_the_controller_and_grows_without(mode, time, low, high):
    results = run("docking-6d", overrides=[f"controller.mode={mode}", f"run.stop_time={time}"]).results
    energies = free_energies(results)
    assert len(energies) >= 5
    assert low <= energies.max() <= high
    if mode == "active":
        assert energies.min() > 0.9997
    else:
        assert (np.diff(energies) > 0.3).all()
    # Contact is off the line of centres and oblique: both satellites begin to turn.
    turning = stacked(results, "satellites.angular_velocity_a")
    assert np.abs(turning).max() > 5e-4
    for momentum in ("satellites.linear_momentum", "satellites.angular_momentum"):
        values = stacked(results, momentum)
        # The parts of angular momentum are centimetres off a motion of 6 N.s, and cancel at the start.
        scale = max(np.abs(values[0]).max(), 6.0 * 0.03)
        assert np.abs(values - values[0]).max() < 1e-9 * scale
    assert results["controller.stiffness_estimate"][-1] == pytest.approx(176e3, rel=1e-4)


def test_noise_reaches_the_reading_and_is_the_seeds():
    noisy = ["noise.force_sigma=1 N", "noise.torque_sigma=0.05 N.m", "run.stop_time=0.2 s"]
    first, again, other = (
        run("docking-6d", overrides=[*noisy, f"noise.seed={seed}"]).results["sensor.measured_force[2]"]
        for seed in (3, 3, 4)
    )
    assert (first == again).all() and (first != other).any()
    assert np.std(first) == pytest.approx(1.0, abs=0.15)
