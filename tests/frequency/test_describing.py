"""Limit cycles by describing functions against closed forms and against runs."""

from __future__ import annotations

import control
import numpy as np
import pytest

import orchestrator as orc
from orchestrator.cli.main import main
from orchestrator.effects.backlash import Backlash
from orchestrator.effects.dead_band import DeadBand
from orchestrator.effects.relay import Relay
from orchestrator.effects.saturate import Saturate
from orchestrator.frequency import limit_cycles, linearise
from orchestrator.frequency.describing import describing_function
from orchestrator.simulation.run import prepare


def clipped(ratio):
    """Describing function of a saturation at this share of the amplitude."""
    return 2.0 / np.pi * (np.arcsin(ratio) + ratio * np.sqrt(1.0 - ratio**2))


@pytest.mark.parametrize("amplitude", [1.2, 2.5, 30.0])
def test_describing_functions_are_those_of_the_books(amplitude):
    ratio = 1.0 / amplitude
    assert describing_function(Saturate(low=-1, high=1), amplitude) == pytest.approx(clipped(ratio), abs=1e-5)
    found = describing_function(DeadBand(threshold=1.0), amplitude)
    assert found == pytest.approx(1.0 - clipped(ratio), abs=1e-5)
    left = 1.0 - 2.0 * ratio
    real = (0.5 * np.pi + np.arcsin(left) + left * np.sqrt(1.0 - left**2)) / np.pi
    expected = complex(real, -4.0 * ratio / np.pi * (1.0 - ratio))
    assert describing_function(Backlash(width=2.0), amplitude) == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize(("amplitude", "width"), [(0.3, 0.0), (1.0, 0.5), (20.0, 4.0)])
def test_the_describing_function_of_a_relay_is_that_of_the_books(amplitude, width):
    """4 M/(pi A) (sqrt(1 - (w/(2 A))^2) - j w/(2 A))."""
    ratio = 0.5 * width / amplitude
    expected = 4.0 * 1.5 / (np.pi * amplitude) * (np.sqrt(1.0 - ratio**2) - 1j * ratio)
    found = describing_function(Relay(level=1.5, width=width), amplitude)
    assert found == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize(
    ("relay", "through"),
    [({"relay": 1.0}, []), ({"relay": 2.0, "width": 0.2}, [{"delay": "0.1 s"}])],
)
def test_a_relay_oscillates_as_predicted(relay, through, tmp_path, monkeypatch):
    """2/(s (s + 1) (s + 2)); by the first harmonic sqrt(2) rad/s and 8 M/(6 pi) without delay."""
    pytest.importorskip("casadi", reason="the build extra makes the FMUs of linear systems")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    system = orc.System(step_size="1 ms", stop_time="60 s")
    system.add("lags", control.tf([2.0], [1.0, 3.0, 2.0]), x1=0.3)
    system.add("integrator", control.tf([1.0], [1.0, 0.0]))
    system.connect("lags.y", "integrator.u", {"gain": -1.0}, relay, *through)
    system.connect("integrator.y", "lags.u")
    prepared = prepare(system.data)
    (found,) = limit_cycles(prepared, linearise(prepared))
    assert found.stable and found.balanced
    if not through:
        assert found.first_omega == pytest.approx(np.sqrt(2.0), rel=3e-3)
        assert found.first_amplitude == pytest.approx(4.0 * 2.0 / (6.0 * np.pi), rel=5e-3)
    result = orc.run(system, halving=False)
    frequency, amplitude = oscillation(result["lags.y"].time, result["lags.y"].values)
    assert found.frequency == pytest.approx(frequency, rel=2e-3)
    assert found.amplitude == pytest.approx(amplitude, rel=3e-3)
    assert abs(found.first_amplitude / amplitude - 1.0) > 0.02


def servo(*effects, start="1 um"):
    """A late robot that is commanded by its own position, against its sense."""
    system = orc.System(step_size="0.05 ms", stop_time="3 s")
    system.add("robot", "RobotResponse", omega_n="75 Hz", xi_n=0.8, tau_m="3.33 ms", position=start)
    return system.connect("robot.position", "robot.command", *effects)


def oscillation(time, signal):
    """Frequency and half of the range of the second half of a signal."""
    kept = time > 0.5 * time[-1]
    time, signal = time[kept], signal[kept] - np.mean(signal[kept])
    up = np.flatnonzero((signal[:-1] < 0.0) & (signal[1:] >= 0.0))
    return 1.0 / np.mean(np.diff(time[up])), 0.5 * np.ptp(signal)


@pytest.mark.parametrize(
    "effects",
    [
        [{"gain": -3.0}, {"saturate": {"low": "-1 mm", "high": "1 mm"}}],
        [{"gain": -8.0}, {"saturate": {"low": "-1 mm", "high": "1 mm"}}],
        [{"saturate": {"low": "-1 mm", "high": "1 mm"}}, {"gain": -3.0}],
    ],
)
def test_a_saturated_servo_oscillates_as_predicted(effects):
    system = servo(*effects)
    prepared = prepare(system.data)
    (cycle,) = limit_cycles(prepared, linearise(prepared))
    assert cycle.stable and cycle.effect == "saturate"
    result = orc.run(system, halving=False)
    frequency, amplitude = oscillation(result.time, result["robot.position"].values)
    gain = abs(effects[0]["gain"]) if "gain" in effects[0] else 1.0
    assert cycle.balanced
    assert frequency == pytest.approx(cycle.frequency, rel=0.01)
    assert gain * amplitude == pytest.approx(cycle.amplitude, rel=0.02)


@pytest.mark.parametrize("delay", ["8 ms", "20 ms"])
def test_a_saturated_drive_with_delay_needs_more_than_the_first_harmonic(delay):
    """By the first harmonic alone the frequency is 8 to 17 % too high."""
    effects = [{"delay": delay}, {"saturate": {"low": "-0.5 V", "high": "0.5 V"}}]
    changes = {"connections[3].through": effects, "path.stroke": "0 m", "drive.velocity": "1 mm/s"}
    config = orc.load("emps").data
    config["connections"][3] = {
        "from": "controller.voltage",
        "to": "drive.voltage",
        "through": effects,
    }
    config["instances"]["path"]["start"]["stroke"] = "0 m"
    prepared = prepare(config)
    (cycle,) = limit_cycles(prepared, linearise(prepared))
    assert cycle.balanced and cycle.stable
    changes |= {"run.step_size": "0.1 ms", "run.stop_time": "6 s"}
    result = orc.run("emps", set=changes, halving=False)
    frequency, amplitude = oscillation(result.time, result["controller.voltage"].values)
    assert frequency == pytest.approx(cycle.frequency, rel=0.01)
    assert amplitude == pytest.approx(cycle.amplitude, rel=0.02)
    assert cycle.first_omega > 1.07 * cycle.omega


def test_an_unstable_limit_cycle_parts_growth_from_decay():
    """A dead band: below the cycle the loop rests, above it runs away."""
    effects = [{"dead-band": "1 mm"}, {"gain": -3.0}]
    prepared = prepare(servo(*effects).data)
    (cycle,) = limit_cycles(prepared, linearise(prepared))
    assert not cycle.stable
    for factor, grows in ((0.7, False), (1.5, True)):
        system = servo(*effects, start=f"{factor * cycle.amplitude} m")
        found = orc.run(system, set={"run.stop_time": "0.5 s"}, halving=False)["robot.position"].values
        assert (abs(found[-100:]).max() > factor * cycle.amplitude) == grows


def test_play_makes_a_stable_drive_oscillate(capsys):
    changes = {"connections[3].through": [{"delay": "4 ms"}, {"backlash": "0.5 V"}]}
    assert main(["stability", "emps", "--set", "connections[3].through=[{delay: 4 ms}, {backlash: 0.5 V}]",
                 "--limit-cycles"]) == 0  # fmt: skip
    printed = capsys.readouterr().out
    assert "backlash on controller.voltage" in printed and "20.82 Hz, amplitude 1.636" in printed
    times = {
        "path.stroke": "0 m",
        "drive.velocity": "10 mm/s",
        "run.step_size": "0.05 ms",
        "run.stop_time": "4 s",
    }
    result = orc.run("emps", set={**changes, **times}, halving=False)
    frequency, amplitude = oscillation(result.time, result["controller.voltage"].values)
    assert frequency == pytest.approx(20.82, rel=3e-3)
    assert amplitude == pytest.approx(1.636, rel=0.03)


def test_a_linear_loop_predicts_none(capsys):
    assert main(["stability", "emps", "--limit-cycles"]) == 0
    assert "no effect predicts a limit cycle" in capsys.readouterr().out
