"""Responses of whole co-simulations against the exact loop and the sampled one."""

import numpy as np
import pytest

from orchestrator.base.errors import ConfigError
from orchestrator.docking.stability import ContactLoop
from orchestrator.frequency import sweep_system

PLAIN = "docking-1d-uncompensated"
# The rod begins at rest in the frame.
IN_CONTACT = [
    "satellite.position=10 mm",
    "satellite.velocity=0 m/s",
    "robot.position=10 mm",
    "contact.damping=1500 N.s/m",
    "run.step_size=0.5 ms",
]
FREQUENCIES = np.geomspace(2, 100, 12)


@pytest.mark.parametrize("master", ["jacobi", "gauss-seidel"])
def test_the_open_loop_tends_to_the_exact_one(master):
    overrides = [*IN_CONTACT, f"run.master={master}"]
    loop = ContactLoop.of(PLAIN, overrides)

    def measured(limit: bool):
        given = {"amplitude": 20.0, "overrides": overrides, "limit": limit}
        return sweep_system(PLAIN, "satellite.force", "contact.force", FREQUENCIES, **given)["contact.force"]

    stepped = measured(False)
    assert stepped.coherence.min() > 0.999999
    small = measured(True)
    ratio = -small.response / loop.linear.system.open_loop(loop.back, small.omega)
    assert np.max(np.abs(20 * np.log10(np.abs(ratio)))) < 0.01
    assert np.max(np.abs(np.angle(ratio, deg=True))) < 0.1
    np.testing.assert_allclose(small.step_effect, stepped.response / small.response - 1, rtol=1e-9)


def test_added_to_what_feeds_the_input_it_measures_the_closed_loop():
    """A constant force keeps the rod in contact, 5 mm deep."""
    hold = "connections[satellite.force].through=[{offset: 880 N}]"
    overrides = [*IN_CONTACT, "contact.damping=3000 N.s/m", "robot.tau_m=1 ms", hold]
    (found,) = sweep_system(
        PLAIN,
        "satellite.force",
        "contact.force",
        FREQUENCIES,
        amplitude=20.0,
        overrides=overrides,
        cut=False,
        settle=4,
        limit=True,
    ).values()
    loop = ContactLoop.of(PLAIN, overrides)
    gain = loop.linear.system.open_loop(loop.back, found.omega)
    ratio = -found.response * (1 + gain) / gain
    assert found.coherence.min() > 0.999
    assert np.max(np.abs(20 * np.log10(np.abs(ratio)))) < 0.01
    assert np.max(np.abs(np.angle(ratio, deg=True))) < 0.1


def test_coherence_tells_that_the_contact_is_left():
    (found,) = sweep_system(
        PLAIN,
        "satellite.force",
        "contact.force",
        FREQUENCIES,
        amplitude=20.0,
        overrides=IN_CONTACT,
        cut=False,
    ).values()
    assert found.coherence.min() < 0.9


def test_refusals():
    with pytest.raises(ConfigError) as caught:
        sweep_system(PLAIN, "robot.comand", "contact.forces", [0.0], amplitude=1.0, periods=1)
    lines = str(caught.value).splitlines()
    assert lines[0] == f"{PLAIN}: no numeric input robot.comand"
    assert lines[1].endswith("Did you mean robot.command?")
    assert lines[2] == f"{PLAIN}: no numeric output contact.forces"
    assert lines[4:] == [
        f"{PLAIN}: periods = 1, settle = 1",
        "  at least 2 periods are needed, settle >= 0",
        f"{PLAIN}: a frequency is not positive",
        "  allowed: finite and positive [Hz]",
    ]
