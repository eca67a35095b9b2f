"""The bundled systems with other controllers: what docking-1d is compared with."""

import pytest

from orchestrator.simulation.run import run


def speeds(name, stop_time, *overrides):
    result = run(name, overrides=[f"run.stop_time={stop_time} s", *overrides], halving=False)
    return [abs(contact["rebound_velocity_ratio"]) for contact in result.summary["contacts"]]


def test_plain_admittance_diverges():
    # By the characteristic roots; the output's hold is what gauss-seidel takes off again.
    assert speeds("docking-1d-admittance", 2)[3] == pytest.approx(1.2356**4, rel=5e-3)


@pytest.mark.parametrize(
    ("name", "deviation"),
    [("docking-1d-osaki", 0.015), ("docking-1d-smith", 1e-3), ("docking-1d-passivity", 1e-3)],
)
def test_peers_that_know_enough_stop_the_divergence(name, deviation):
    found = speeds(name, 3)
    assert len(found) >= 4
    assert found == pytest.approx([1.0] * len(found), abs=deviation)


@pytest.mark.parametrize(
    ("name", "stable"),
    [
        ("docking-1d-osaki", False),
        ("docking-1d-smith", False),
        ("docking-1d-passivity", True),
        ("docking-1d", True),
    ],
)
def test_a_slower_robot_that_nobody_reported_them_of(name, stable):
    """The source's claim: without a model of the robot."""
    found = speeds(name, 3, "robot.tau_m=6 ms")
    if stable:
        assert found == pytest.approx([1.0] * len(found), abs=5e-3)
    else:
        assert found[3] > 1.5
