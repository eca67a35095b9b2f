"""State spaces by directional derivatives against transfer functions."""

import foreign
import numpy as np
import pytest

from orchestrator.base.errors import ConfigError
from orchestrator.frequency import linearise, state_space

OMEGA = 2 * np.pi * np.geomspace(0.1, 200, 40)
SERVO = {"omega_n": 471.23889803846896, "xi_n": 0.8}


def robot_response(s):
    w = SERVO["omega_n"]
    return w * w / (s * s + 2.0 * SERVO["xi_n"] * w * s + w * w)


# A force sensor in contact, fed back to the robot's command: an admittance.
ADMITTANCE = """
run: {master: jacobi, step_size: 1 ms, stop_time: 1 s}
instances:
  robot: {fmu: RobotResponse, start: {tau_m: 0 ms, position: 7 mm}}
  contact: {fmu: DockingContact, start: {stiffness: 176 N/mm, damping: 50 N.s/m}}
  sensor: {fmu: ForceSensor, start: {cutoff: 100 Hz}}
connections:
  - robot.position -> contact.position
  - robot.velocity -> contact.velocity
  - contact.force -> sensor.force
  - {from: sensor.measured_force, to: robot.command, through: [{gain: 0.002 mm/N}, {offset: 1 mm}]}
"""


def test_servo_without_delay():
    found = state_space("RobotResponse", start={"tau_m": 0.0})
    assert (found.states, found.inputs) == (("position", "velocity"), ("command",))
    expected = robot_response(1j * OMEGA)
    np.testing.assert_allclose(found.response("command", "position", OMEGA), expected, rtol=1e-12)
    poles = np.roots([1.0, 2 * 0.8 * SERVO["omega_n"], SERVO["omega_n"] ** 2])
    np.testing.assert_allclose(np.sort(found.control().poles()), np.sort(poles))


def test_system_in_a_loop(tmp_path):
    path = tmp_path / "admittance.yaml"
    path.write_text(ADMITTANCE, encoding="utf-8")
    found = linearise(path)
    assert found.system.states == ("robot.position", "robot.velocity", "sensor.filtered_force")
    s = 1j * OMEGA
    forward = -robot_response(s) * (176e3 + 50 * s) / (1 + s / (200 * np.pi)) * 2e-6
    name = "sensor.measured_force -> gain -> offset -> robot.command"
    np.testing.assert_allclose(found.system.open_loop(name, OMEGA), -forward, rtol=1e-9)
    with pytest.raises(ConfigError, match=r"no 'sensor -> robot'\n  there are robot.position -> contact"):
        found.system.open_loop("sensor -> robot", OMEGA)


def test_what_a_state_space_cannot_hold_is_refused():
    with pytest.raises(ConfigError) as caught:
        state_space("RobotResponse")
    assert str(caught.value) == (
        "DockingHIL.RobotResponse: input command acts on no state's derivative and no output at once\n"
        "  a delay, a sample or an inactive part of the model lies between. "
        "Measure the response with sweep or sweep_system."
    )
    with pytest.raises(ConfigError, match=r"no input comand\n  inputs: command"):
        state_space("RobotResponse", ["comand"])


def test_states_that_an_fmu_does_not_name_are_not_taken_for_none(tmp_path):
    """Y is the integral of u, z is 2 u."""
    path = foreign.flawed(tmp_path / "Flawed.fmu")
    with pytest.raises(ConfigError) as caught:
        state_space(path)
    told = (
        "no input acts on output y at once, and the FMU names no states\n"
        "  the states behind it are not known. "
        "Measure the response with sweep or sweep_system, or leave the output out."
    )
    assert str(caught.value) == f"Flawed: {told}"
    assert state_space(path, outputs=["z"]).d.tolist() == [[2.0]]
