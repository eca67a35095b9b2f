"""Delays between the states of an FMU: roots against closed forms and characteristic equations."""

from __future__ import annotations

import numpy as np
import pytest
from modelica_texts import built_models
from scipy.optimize import newton
from scipy.special import lambertw

import orchestrator as orc
from orchestrator.frequency import sampled_system
from orchestrator.frequency.trim import trim
from orchestrator.frequency.verify import verified
from orchestrator.simulation.run import prepare

SELF = """
model Self "Acts on itself after a delay"
  parameter Real gain(unit = "1/s") = 1;
  parameter Real late(unit = "s") = 1;
  input Real drive(start = 0);
  output Real x(start = 0, fixed = true);
equation
  der(x) = drive - gain * delay(x, late);
end Self;
"""
TWO = """
model Two "Two delays in one equation, one of them of an input, too"
  input Real drive(start = 0.5);
  output Real x(start = 0.1, fixed = true);
  output Real y(start = 0.1, fixed = true);
  output Real seen;
equation
  der(x) = y - 0.5 * delay(x, 0.7) - 0.3 * delay(y, 1.9) + drive;
  der(y) = -2 * x - y + 0.4 * delay(x + 2 * drive, 1.3) - 0.2 * drive;
  seen = x + delay(y, 0.45);
end Two;
"""
PIPE = """
model Pipe "A heated volume, measured behind a pipe"
  input Real heat(start = 0);
  output Real seen;
  output Real t(start = 0, fixed = true);
equation
  der(t) = heat - t - 0.1 * t ^ 3;
  seen = delay(t, 2);
end Pipe;
"""
CONTROL = """
model Control "An integrator"
  parameter Real wanted = 0.5;
  input Real seen(start = 0);
  output Real heat(start = 0, fixed = true);
equation
  der(heat) = 0.3 * (wanted - seen);
end Control;
"""


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    return built_models(tmp_path_factory.mktemp("models"), SELF, TWO, PIPE, CONTROL)


def alone(model, name, step="50 ms"):
    system = orc.System(step_size=step, stop_time="20 s", master="gauss-seidel")
    return system.add(name, model).data


def heated(models, **run):
    system = orc.System(step_size="100 ms", stop_time="60 s", **{"master": "gauss-seidel", **run})
    system.add("pipe", models["Pipe"]).add("control", models["Control"])
    return system.connect("pipe.seen", "control.seen").connect("control.heat", "pipe.heat").data


def test_an_equation_that_acts_on_itself_has_the_roots_of_lamberts_function(models):
    modes = orc.linearise(alone(models["Self"], "one")).modes(6)
    exact = [lambertw(-1.0, k) for k in range(4)]
    for mode, root in zip(modes.modes[:3], sorted(exact[:3], key=lambda one: -one.real), strict=True):
        assert abs(mode.root - complex(root.real, abs(root.imag))) < 1e-7


def test_several_delays_in_one_equation_are_parted(models):
    system = orc.System(step_size="20 ms", stop_time="20 s", master="gauss-seidel")
    system.add("two", models["Two"]).add("control", models["Control"], wanted=0.1)
    system.connect("two.seen", "control.seen").connect("control.heat", "two.drive")
    linear = orc.linearise(system.data)
    assert [round(one.delay, 6) for one in sorted(linear.inner["two"], key=lambda one: one.delay)] == [
        0.45,
        0.7,
        1.3,
        1.9,
    ]

    def det(s):
        late = {one: np.exp(-one * s) for one in (0.45, 0.7, 1.3, 1.9)}
        a = [
            [s + 0.5 * late[0.7], -1 + 0.3 * late[1.9], -1],
            [2 - 0.4 * late[1.3], s + 1, 0.2 - 0.8 * late[1.3]],
            [0.3, 0.3 * late[0.45], s],
        ]
        return np.linalg.det(np.array(a))

    for mode in linear.modes(6).modes:
        assert abs(newton(det, mode.root * (1 + 1e-4), tol=1e-13) - mode.root) < 1e-5 * abs(mode.root)


def test_the_loop_through_a_delay_of_a_state_has_its_margins(models):
    linear = orc.linearise(heated(models))
    (margins,) = {round(one.delay_margin, 6) for one in linear.margins().values()}

    def level(w):
        return 0.3 / abs(1j * w * (1j * w + 1)) - 1

    w = newton(level, 0.3)
    phase = np.pi - np.pi / 2 - np.arctan(w) - 2 * w
    assert margins == pytest.approx(phase / w, rel=1e-5)
    assert any("t acts on seen after a delay of 2 s within the FMU" in note for note in linear.notes)


def test_the_steady_state_lies_behind_the_delay(models):
    found = trim(prepare(heated(models)))
    assert found.states["pipe.t"].value == pytest.approx(0.5, abs=1e-9)
    assert found.states["control.heat"].value == pytest.approx(0.5 + 0.1 * 0.5**3, abs=1e-9)


@pytest.mark.parametrize("master", ["gauss-seidel", "jacobi"])
def test_a_run_moves_as_the_system_with_master_and_step(models, master):
    system = heated(models, master=master)
    at = trim(prepare(system))
    report = verified(system, orc.linearise(system, at="trim"), at.overrides)
    assert all(one["difference"] < 5e-4 for one in report["sampled"])
    assert report["steps"][-1]["difference"] < 1e-3


def test_where_the_delay_ends_stability_the_sampled_system_agrees(models):
    system = heated(models)
    system["instances"]["control"]["start"] = {"wanted": 0.0}
    linear = orc.linearise(system)
    margin = min(one.delay_margin for one in linear.margins().values())
    name = linear.system.loops()[0]
    assert linear.system.later(name, 0.99 * margin).modes().stable
    assert not linear.system.later(name, 1.01 * margin).modes().stable
    machine = linear.modes().dominant.root
    sampled = sampled_system(prepare(system, ["run.step_size=10 ms"]), linear).modes()[0].root
    assert abs(sampled - machine) < 0.02 * abs(machine)
