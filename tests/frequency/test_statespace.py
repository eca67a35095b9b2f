"""State spaces by directional derivatives against transfer functions."""

import numpy as np
import pytest

import orchestrator as orc
from orchestrator.base.errors import ConfigError
from orchestrator.frequency import linearise

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
    system = orc.System(step_size="1 ms", stop_time="1 s").add("robot", "RobotResponse", tau_m=0.0, **SERVO)
    found = orc.linearise(system.connect("robot.position", "robot.command", {"gain": 0.1})).parts["robot"]
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
    with pytest.raises(ConfigError, match=r"no connection 'sensor -> robot'\n  there are robot.position"):
        found.system.open_loop("sensor -> robot", OMEGA)
