"""Stability of configured systems of any kind: what is linearised, measured, refused, and what comes out."""

from __future__ import annotations

import json
import re

import control
import numpy as np
import pytest

import orchestrator as orc
from orchestrator.cli.main import main
from orchestrator.frequency import DelaySystem


def late(delay, *more):
    """The positioning system with a delay before its drive."""
    data = orc.load("emps").data
    data["connections"][3] = {
        "from": "controller.voltage",
        "to": "drive.voltage",
        "through": [{"delay": f"{delay!r} s"}, *more],
    }
    return data


def feedback(gain):
    """A delayed robot that is commanded by its own position."""
    system = orc.System(step_size="0.1 ms", stop_time="1 s")
    system.add("robot", "RobotResponse", omega_n="75 Hz", xi_n=0.8, tau_m="3.33 ms")
    return system.connect("robot.position", "robot.command", {"gain": gain})


def test_modes_of_the_positioning_system_are_those_of_its_equations():
    """m x'' = k_f k_v (k_p (r - x) - x') - c x'."""
    mass, viscous, force, position, velocity = 95.1, 203.5, 35.150651882485466, 160.18, 243.45
    linear = orc.linearise("emps")
    expected = np.roots([mass, viscous + force * velocity, force * velocity * position])
    assert "path: no connection shows turned: the roots at 0 are left out" in linear.notes
    assert linear.modes().modes[0].root == pytest.approx(expected[np.argmax(expected.imag)], rel=1e-9)


def test_the_delay_margin_is_where_the_delayed_system_becomes_unstable():
    weakest = orc.linearise("emps").margins()["controller.voltage -> drive.voltage"]
    assert orc.linearise(late(0.999 * weakest.delay_margin)).modes().unstable == 0
    assert orc.linearise(late(1.001 * weakest.delay_margin)).modes().unstable == 2


@pytest.mark.parametrize("delay", [0.004, 0.0062])
def test_co_simulation_decays_and_oscillates_as_the_dominant_root(delay):
    """From a start beside the path's, with half the step as well."""
    root = orc.linearise(late(delay)).modes().modes
    root = next(one.root for one in root if one.root.imag > 0.0)
    rates = []
    for step in ("0.1 ms", "0.05 ms"):
        changes = {
            "run.step_size": step,
            "run.stop_time": "0.6 s",
            "path.stroke": "1e-12 m",
            "drive.position": "1 mm",
        }
        result = orc.run(late(delay), set=changes, halving=False)
        time, signal = result.time, result["drive.position"].values
        turns = np.flatnonzero(np.diff(np.sign(np.diff(signal))) != 0) + 1
        turns = turns[(time[turns] > 0.15) & (time[turns] < 0.5)]
        rate = np.polyfit(time[turns], np.log(abs(signal[turns])), 1)[0]
        frequency = np.pi / np.mean(np.diff(time[turns]))
        rates.append((rate, frequency))
    error = [abs(one[0] - root.real) for one in rates]
    assert error[1] < 0.62 * error[0] or error[1] < 2e-3 * abs(root)
    assert rates[1][0] == pytest.approx(root.real, abs=0.01 * abs(root))
    assert rates[1][1] == pytest.approx(root.imag, rel=0.01)


def test_a_delay_within_an_fmu_is_measured():
    made = orc.linearise(feedback(-0.5))
    (note,) = made.notes
    measured = float(re.search(r"after a delay of (\S+) s within the FMU", note)[1])
    assert measured == pytest.approx(3.33e-3, rel=1e-7)
    omega, xi, tau = 2.0 * np.pi * 75.0, 0.8, 3.33e-3
    loop = DelaySystem.loop(control.tf([0.5 * omega**2], [1.0, 2.0 * xi * omega, omega**2]), tau)
    for mode, other in zip(made.modes().modes[:2], loop.modes().modes[:2], strict=True):
        assert mode.root == pytest.approx(other.root, rel=1e-6)


def test_filters_become_states():
    made = orc.linearise(late(0.002, {"low-pass": "300 Hz"}))
    assert "drive.voltage filter" in made.system.states
    names = [name for name in made.margins() if name.endswith("drive.voltage")]
    assert len(names) == 1


def test_linear_systems_draw_their_loops():
    linear = orc.linearise("emps")
    name = "controller.voltage -> drive.voltage"
    assert linear.bode().axes[0].get_title() == "drive.position -> controller.position"
    upper, _ = linear.bode(name).axes
    hertz, level = upper.lines[0].get_data()
    expected = linear.system.to_response(name, 2.0 * np.pi * hertz).magnitude
    assert level == pytest.approx(20.0 * np.log10(expected), abs=1e-9)
    assert linear.nyquist(name).axes[0].get_title() == linear.nichols(name).axes[0].get_title() == name


def test_the_command_reports_and_draws(tmp_path, capsys):
    assert main(["stability", "emps", "--out", str(tmp_path), "--json"]) == 0
    reported = json.loads(capsys.readouterr().out)
    assert reported["files"] == [
        "stability.json",
        "stability.html",
        *(f"{name}.png" for name in ("roots", "participation", "bode", "nyquist", "nichols", "step")),
    ]
    assert all((tmp_path / name).stat().st_size > 1000 for name in reported["files"])
    page = (tmp_path / "stability.html").read_text(encoding="utf-8")
    assert page.count("data:image/png") == 6 and "5.26689" in page and "http:" not in page
    margins = reported["margins"]["controller.voltage -> drive.voltage"]
    assert margins["delay_margin"] == pytest.approx(5.267e-3, rel=1e-3)
    assert main(["stability", "emps", "--open", "drive.voltage"]) == 0
    text = capsys.readouterr().out
    assert "19.11 Hz, damping 0.3837" in text
    assert text.count("->") == 1


def test_what_cannot_be_opened_or_linearised_is_named(capsys):
    assert main(["stability", "emps", "--open", "drive.volt"]) == 2
    assert "nothing is connected to drive.volt" in capsys.readouterr().err
    held = "connections[3].through=[{jitter: 1 ms, period: 2 ms, seed: 1}]"
    assert main(["stability", "emps", "--set", held]) == 2
    assert "the effect jitter has no transfer function" in capsys.readouterr().err


def test_the_border_over_a_delay_is_the_delay_margin(tmp_path, capsys):
    """On top of 1 ms that the connection has."""
    found = orc.linearise(late(0.001)).margins()
    margin = next(one for name, one in found.items() if name.startswith("controller.voltage")).delay_margin
    orc.load(late(0.001)).to_yaml(tmp_path / "late.yaml")
    over = "connections[3].through[0].delay=1..9 ms"
    command = [
        "stability",
        str(tmp_path / "late.yaml"),
        "--over",
        over,
        "--points",
        "5",
        "--out",
        str(tmp_path / "o"),
    ]
    assert main(command) == 0
    report = json.loads((tmp_path / "o" / "stability.json").read_text())["over"]
    (border,) = report["borders"]
    assert border["unstable_above"]
    assert border["value"] == pytest.approx(1 + 1e3 * margin, abs=2e-3)
    assert (tmp_path / "o" / "over.png").stat().st_size > 0
    assert "over connections[3].through[0].delay from 1 to 9 ms: unstable above" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--over", "drive.mass=90"], "is no range of a parameter"),
        (["--over", "drive.mass=95..90 kg"], "is empty"),
        (["--over", "drive.mass=90 g..95 kg"], "has two units"),
        (["--over", "drive.mass=90..95 kg", "--points", "1"], "at least 3"),
        (["--at-time", "2"], "has no unit"),
        (["--at-time", "2000 s"], "lies outside the run"),
    ],
)
def test_ranges_and_times_that_make_no_sense_are_refused(options, message, capsys):
    assert main(["stability", "emps", *options]) == 2
    assert message in capsys.readouterr().err


def test_a_system_is_linearised_around_a_point_of_its_run():
    result = orc.run("emps", set={"run.stop_time": "0.5 s"}, halving=False)
    place = len(result.time) // 2
    linear = orc.linearise("emps", at_time=float(result.time[place]))
    assert linear.point["drive.position"] == pytest.approx(result["drive.position"].values[place], rel=1e-12)
    assert linear.point["drive.position"] != orc.linearise("emps").point["drive.position"]
    assert f"linear around t = {result.time[place]:.9g} s of the run" in linear.notes
    assert linear.modes().dominant.root == pytest.approx(
        orc.linearise("emps").modes().dominant.root, rel=1e-6
    )


@pytest.mark.parametrize("delay", [None, 0.004])
def test_a_co_simulation_verifies_the_dominant_root(delay, tmp_path, capsys):
    """Its error falls with the communication step, and what is extrapolated is near."""
    orc.load("emps" if delay is None else late(delay)).to_yaml(tmp_path / "system.yaml")
    assert main(["stability", str(tmp_path / "system.yaml"), "--verify", "--out", str(tmp_path / "out")]) == 0
    report = json.loads((tmp_path / "out" / "stability.json").read_text())["verify"]
    whole, half, none = (one["difference"] for one in report["steps"])
    assert 0.4 < half / whole < 0.6
    assert none < 0.005
    assert "extrapolated to step 0" in capsys.readouterr().out


def test_an_open_loop_is_python_controls():
    """Delays by Pade's approximation near the exact response, and the same margins."""
    linear = orc.linearise(late(0.004))
    name, margins = next(
        (name, one) for name, one in linear.margins().items() if name.startswith("controller.voltage")
    )
    omega = np.geomspace(1.0, 500.0, 60)
    exact = linear.system.open_loop(name, omega)
    loop = linear.system.to_control(name)
    assert np.abs(loop(1j * omega) / exact - 1).max() < 1e-6
    assert np.allclose(np.ravel(linear.system.to_response(name, omega).frdata), exact, rtol=1e-12)
    with np.errstate(invalid="ignore"):
        _, phase, _, crossover = control.margin(loop)
    assert phase == pytest.approx(margins.phase_margin, abs=1e-3)
    assert min(abs(crossover / one.omega - 1) for one in margins.crossovers) < 1e-4
    closed = control.feedback(loop, 1)
    dominant = next(one.root for one in linear.modes().modes if one.root.imag > 0)
    assert np.min(abs(closed.poles() - dominant)) < 1e-6 * abs(dominant)
