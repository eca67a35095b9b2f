"""The system that a master steps: its predicted roots against those of real co-simulations."""

from __future__ import annotations

import numpy as np
import pytest

import orchestrator as orc
from orchestrator.base.errors import ConfigError
from orchestrator.cli.main import main
from orchestrator.frequency import sampled_modes
from orchestrator.frequency.from_system import linearise
from orchestrator.frequency.sampled_system import sampled_system
from orchestrator.frequency.step_report import largest_step, resting_roots, step_report
from orchestrator.frequency.verify import verified
from orchestrator.simulation.run import prepare

ITERATIVE = "{name: iterative, tolerance: 1e-10}"
INTERPOLATING = "{name: iterative, tolerance: 1e-10, interpolation: 1}"
MASTERS = [
    "jacobi",
    "gauss-seidel",
    ITERATIVE,
    INTERPOLATING,
    "{name: jacobi, extrapolation: 1}",
    "{name: gauss-seidel, extrapolation: 2}",
]


def servo(*through, **changes):
    """The positioning system with effects before its drive."""
    data = orc.load("emps").data
    data["connections"][3] = {"from": "controller.voltage", "to": "drive.voltage", "through": list(through)}
    for name, change in changes.items():
        data["instances"][name] |= change
    return data


def robot(gain, damping, delay, *through):
    """A robot with a delay within its FMU, commanded by its own position."""
    system = orc.System(step_size="1 ms", stop_time="1 s")
    system.add("robot", "RobotResponse", omega_n="75 Hz", xi_n=damping, tau_m=delay)
    return system.connect("robot.position", "robot.command", {"gain": gain}, *through).data


def settings(master, step):
    return (f"run.master={master}", f"run.step_size={step}", "run.stop_time=0.96 s")


def look(config, master, step):
    """Machine's modes, report on the step, and the comparison with co-simulations."""
    changes = settings(master, step)
    prepared = prepare(config, changes)
    linear = linearise(prepared)
    modes = linear.modes()
    return modes, step_report(prepared, linear, modes), verified(config, linear, changes)["sampled"]


@pytest.mark.parametrize("master", MASTERS)
@pytest.mark.parametrize(
    "config",
    [
        servo({"delay": "3.7 ms"}, {"low-pass": "80 Hz"}),
        servo({"sample-and-hold": {"period": "2.5 ms", "phase": "0.7 ms"}}, drive={"step_size": "0.25 ms"}),
        robot(-0.5, 0.8, "3.33 ms", {"delay": "1.4 ms"}),
    ],
    ids=["delay and low-pass", "hold and own step", "delay within the FMU"],
)
def test_runs_decay_as_the_sampled_system(config, master):
    changes = settings(master, "1 ms")
    compared = verified(config, linearise(prepare(config, changes)), changes)["sampled"]
    assert {one["step"] for one in compared} == {1e-3, 5e-4}
    assert max(one["difference"] for one in compared) < 1e-5


@pytest.mark.parametrize("master", MASTERS[:2])
@pytest.mark.parametrize("slow", ["controller", "drive"])
def test_instances_with_longer_steps(master, slow):
    _, report, compared = look(servo({"delay": "0.5 ms"}, **{slow: {"step_size": "2 ms"}}), master, "1 ms")
    assert report["period"] == pytest.approx(2e-3)
    assert max(one["difference"] for one in compared) < 1e-5


@pytest.mark.parametrize(("own", "share"), [("2 ms", 2.0), ("0.2 ms", 1.0)])
def test_own_steps_change_with_the_communication_step(own, share):
    """The controller alone acts in steps, so that its own are those that count, where they are the longer."""
    config = servo(controller={"step_size": own})
    prepared = prepare(config)
    linear = linearise(prepared)
    alone = prepare(servo())
    border = largest_step(alone, linearise(alone), 1, False, False)["value"]
    assert largest_step(prepared, linear, 1, False, False)["value"] == pytest.approx(border / share, rel=1e-3)
    report = verified(config, linear)
    assert max(one["difference"] for one in report["sampled"]) < 1e-6
    differences = [one["difference"] for one in report["steps"]]
    assert differences[1] < 0.55 * differences[0] and differences[2] < 0.15 * differences[1]


@pytest.mark.parametrize(
    ("config", "master", "step"),
    [
        (servo(), "jacobi", "5 ms"),
        (servo(), "gauss-seidel", "16 ms"),
        (servo(), "{name: jacobi, extrapolation: 1}", "5 ms"),
        (servo(), "{name: gauss-seidel, extrapolation: 2}", "8 ms"),
        (servo(), INTERPOLATING, "40 ms"),
        (robot(-0.3, 0.02, "8 ms"), ITERATIVE, "1 ms"),
    ],
)
def test_a_stable_machine_that_the_step_makes_unstable(config, master, step):
    modes, report, compared = look(config, master, step)
    assert modes.unstable == 0
    assert report["verdict"].startswith("unstable")
    assert compared[0]["found"][0] > 0.0  # it grows in the run
    assert max(one["difference"] for one in compared) < 1e-5


@pytest.mark.parametrize(
    ("config", "master"),
    [
        (servo(), "jacobi"),
        (servo(), "gauss-seidel"),
        (servo(), INTERPOLATING),
        (robot(-0.3, 0.02, "8 ms"), ITERATIVE),
    ],
)
def test_runs_grow_beyond_the_largest_stable_step_and_decay_below(config, master):
    prepared = prepare(config, settings(master, "0.5 ms"))
    linear = linearise(prepared)
    found = largest_step(prepared, linear, resting_roots(linear.modes()), False, False)
    for factor, grows in ((1.01, True), (0.99, False)):
        step = float(f"{factor * found['value']:.4g}")
        changes = (f"run.master={master}", f"run.step_size={step!r} s", f"run.stop_time={10 * step:.6g} s")
        compared = verified(config, linear, changes)["sampled"][0]
        assert (compared["found"][0] > 0.0) is grows
        assert compared["difference"] < 1e-5


@pytest.mark.parametrize("master", MASTERS)
@pytest.mark.parametrize(
    "config",
    [
        servo({"delay": "7.3 ms"}),
        servo({"delay": "23.6 ms"}, {"low-pass": "80 Hz"}),
        robot(-0.5, 0.8, "9.3 ms"),
    ],
    ids=["short", "long", "within the FMU"],
)
def test_long_delays_as_powers_give_the_same_roots(config, master, monkeypatch):
    """As the eigenvalues of the whole matrix."""
    prepared = prepare(config, settings(master, "0.5 ms"))
    linear = linearise(prepared)
    resting = resting_roots(linear.modes())
    whole = sampled_system(prepared, linear, resting)
    monkeypatch.setattr(sampled_modes, "_DENSE", 0)
    powers = sampled_system(prepared, linear, resting)
    assert powers.unstable == whole.unstable
    near = [one.root for one in whole.modes(3)]
    for root in near[:2]:
        assert min(abs(one.root - root) for one in powers.modes()) < 1e-9 * abs(root)


def test_a_delay_of_six_hundred_steps():
    changes = ("run.master=jacobi", "run.step_size=0.05 ms", "run.stop_time=1 s")
    config = servo({"delay": "30 ms"}, {"gain": 0.2})
    compared = verified(config, linearise(prepare(config, changes)), changes)["sampled"]
    prepared = prepare(config, changes)
    assert sampled_system(prepared, linearise(prepared)).size > 600
    assert max(one["difference"] for one in compared) < 1e-5


def test_small_steps_lead_to_the_machine():
    """Errors of held inputs fall with the step, those of extrapolated ones with its square."""
    linear = linearise(prepare("emps"))
    root = linear.modes().dominant.root
    for master, order in (("jacobi", 1), ("{name: gauss-seidel, extrapolation: 1}", 2), (INTERPOLATING, 2)):
        errors = [
            min(
                abs(one.root - root)
                for one in sampled_system(prepare("emps", settings(master, f"{step} ms")), linear, 1).modes()
            )
            for step in (0.2, 0.1)
        ]
        assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.1)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (("run.master={name: adaptive, tolerance: 1e-4}",), "adaptive vary"),
        (("connections[3].through=[{sample-and-hold: 3.14159 ms}]",), "3.14159 communication steps"),
        (
            ("connections[3].through=[{delay: 1 ms}]", "run.step_size=0.01 us", "run.stop_time=1 ms"),
            "so many steps",
        ),
    ],
)
def test_what_is_not_covered_is_named(changes, message, capsys):
    prepared = prepare("emps", changes)
    with pytest.raises(ConfigError, match=message):
        sampled_system(prepared, linearise(prepared))
    assert main(["stability", "emps", *(f"--set={one}" for one in changes)]) == 0
    assert "as co-simulated: not known" in capsys.readouterr().out


def test_the_border_over_the_step(capsys):
    command = ["stability", "emps", "--set", "run.master=jacobi", "--over", "run.step_size=1..8 ms"]
    assert main([*command, "--points", "5"]) == 0
    printed = capsys.readouterr().out
    assert "over run.step_size from 1 to 8 ms: stable throughout" in printed
    assert "  as co-simulated: unstable above 3.560" in printed
    assert "largest stable step: 3.56 ms" in printed


def test_slow_roots_beside_one_another_are_all_listed():
    """Two areas have roots -0.1401 and -0.1425 beside a root 0; their delays are many steps."""
    prepared = prepare("load-frequency", ["run.step_size=10 ms"])
    linear = linearise(prepared)
    made = sampled_system(prepared, linear, resting_roots(linear.modes()))
    assert made.size > 300
    every = np.log(np.linalg.eigvals(made.matrix).astype(complex)) / made.period
    moving = every[(every.imag >= 0.0) & (abs(every) > 1e-6)]
    expected = moving[np.argsort(-moving.real)][:6]
    found = np.array([one.root for one in made.modes()])
    assert found == pytest.approx(expected, rel=1e-6)
    assert found[:2].real == pytest.approx([-0.1402, -0.1426], abs=2e-4)


@pytest.mark.parametrize(("system", "time"), [("servo-compliant", 0.5), ("tank-level", 900.0)])
def test_a_pulse_shows_the_roots_at_a_time_of_a_run(system, time):
    found = verified(system, linearise(system, at_time=time))
    assert found["pulse"] and "." in found["changed"]
    assert all(one["difference"] < 2e-4 for one in found["sampled"])
    assert found["steps"][-1]["difference"] < 2e-4


def test_roots_that_hold_for_one_moment_are_not_looked_for():
    linear = linearise("servo-compliant")
    roots = [one.root for one in linear.modes().modes]
    found = verified("servo-compliant", linear, momentary=roots[:1])
    assert complex(*found["root"]) == roots[1] and not found["pulse"]
