"""Measured frequency responses of the bundled FMUs against their transfer functions."""

import foreign
import numpy as np
import pytest

from orchestrator.base.errors import ConfigError
from orchestrator.fmi import RunOptions, load_fmu
from orchestrator.frequency import sweep

FREQUENCIES = np.geomspace(0.1, 200, 30)


def deviation(measured, expected) -> tuple[float, float]:
    """Largest deviation of magnitude [dB] and phase [deg]."""
    ratio = measured.response / expected(1j * measured.omega)
    return np.max(np.abs(20 * np.log10(np.abs(ratio)))), np.max(np.abs(np.degrees(np.angle(ratio))))


def test_robot_response():
    measured = sweep(
        "RobotResponse", "command", "position", FREQUENCIES, step_size=2e-4, amplitude=0.01, periods=1
    )
    w, xi, tau = 471.23889803846896, 0.8, 2e-3
    magnitude, phase = deviation(
        measured, lambda s: w * w * np.exp(-tau * s) / (s * s + 2.0 * xi * w * s + w * w)
    )
    assert magnitude < 0.01 and phase < 0.1
    assert measured.coherence.min() > 0.9999


def test_force_sensor_with_delay_and_low_pass():
    start = {"tau_s": 1.5e-3, "cutoff": 150.0}
    measured = sweep(
        "ForceSensor",
        "force",
        "measured_force",
        FREQUENCIES[12:],
        step_size=1 / (FREQUENCIES[12] * 2**14),
        amplitude=10,
        start=start,
    )
    magnitude, phase = deviation(measured, lambda s: np.exp(-1.5e-3 * s) / (1.0 + s / (300.0 * np.pi)))
    assert magnitude < 0.01 and phase < 0.1


def contact(amplitude: float):
    step = 1 / (FREQUENCIES[20] * 4000)
    return sweep(
        "DockingContact",
        "position",
        "force",
        FREQUENCIES[20:],
        step_size=step,
        amplitude=amplitude,
        offset=0.006,
    )


def test_a_model_exchange_fmu_follows_the_sines_within_steps(tmp_path):
    """Speed over acceleration; held over steps of 10 ms, that of 2 Hz would be 6.6e-4 off."""
    fmu = load_fmu(foreign.bounce(tmp_path / "Bounce.fmu", 2, smooth=True), RunOptions(tolerance=1e-9))
    start = {"h": 5.0, "v": 0.0}
    measured = sweep(fmu, "u", "v", [1.0, 2.0], step_size=0.01, amplitude=0.1, start=start)
    assert measured.response == pytest.approx(1 / (1j * measured.omega), rel=1.2e-4)


def test_coherence_tells_a_contact_that_is_lost():
    held = contact(0.5e-3)
    magnitude, _ = deviation(held, lambda s: -176e3 + 0.0 * s)
    assert magnitude < 1e-3 and held.coherence.min() > 0.9999
    assert contact(3e-3).coherence.min() < 0.9


def test_refusals():
    with pytest.raises(ConfigError) as caught:
        sweep("RobotResponse", "comand", "position", [0.0, 1.0], step_size=-1.0, amplitude=1.0)
    lines = str(caught.value).splitlines()
    assert lines == [
        "DockingHIL.RobotResponse: no input comand",
        "  inputs: command. Did you mean command?",
        "DockingHIL.RobotResponse: a frequency is not positive",
        "  allowed: finite and positive [Hz]",
        "DockingHIL.RobotResponse: step_size = -1.0 s, amplitude = 1.0, periods = 2",
        "  all are to be positive",
    ]
    with pytest.raises(ConfigError, match=r"the period of 3 Hz is 333\.333 steps of 0\.001 s"):
        sweep("RobotResponse", "command", "position", [3.0], step_size=1e-3, amplitude=1.0)
    with pytest.raises(ConfigError, match="200 Hz has 5 steps in a period"):
        sweep("RobotResponse", "command", "position", [1.0, 200.0], step_size=1e-3, amplitude=1.0)
    with pytest.raises(ConfigError, match="no such FMU"):
        sweep("RobotRespons", "command", "position", [1.0], step_size=1e-3, amplitude=1.0)
