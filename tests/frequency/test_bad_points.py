"""Systems that have no linear equations where they stand, or not all of them: what the report says."""

from __future__ import annotations

import numpy as np
import pytest
from modelica_texts import built_models

import orchestrator as orc
from orchestrator.base.errors import ConfigError
from orchestrator.cli.main import main

SIGN = """
model Sign "Driven towards 0 at a constant rate"
  input Real u(start = 0);
  output Real y;
  output Real x(start = 0, fixed = true);
equation
  der(x) = (if x > 0 then -1 else 1) + u;
  y = x;
end Sign;
"""
BEND = """
model Bend "A spring that is stiffer in one sense"
  input Real u(start = 0);
  output Real x(start = 0, fixed = true);
  output Real v(start = 0, fixed = true);
equation
  der(x) = v;
  der(v) = u - v - (if x > 0 then 3 * x else x) + x * x;
end Bend;
"""
SMOOTH = """
model Smooth "A law without a slope at rest"
  input Real u(start = 0);
  output Real x(start = 0, fixed = true);
equation
  der(x) = u - x - x * x - x * abs(x) * x;
end Smooth;
"""
HIDDEN = """
model Hidden "An unstable state that no output shows"
  input Real u(start = 0);
  output Real y;
  Real x(start = 0.1, fixed = true);
  Real h(start = 0.1, fixed = true);
equation
  der(x) = -x + u;
  der(h) = 0.3 * h + u;
  y = x;
end Hidden;
"""
GAIN = """
model Gain "Direct feedthrough"
  input Real u(start = 0);
  output Real y;
  output Real x(start = 0, fixed = true);
equation
  der(x) = u - x;
  y = u + x;
end Gain;
"""
BALL = """
model Ball "An undamped spring"
  input Real u(start = 0);
  output Real h(start = 0, fixed = true);
  output Real v(start = 0, fixed = true);
equation
  der(h) = v;
  der(v) = u;
end Ball;
"""


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    return built_models(tmp_path_factory.mktemp("models"), SIGN, BEND, SMOOTH, HIDDEN, GAIN, BALL)


def fed_back(models, name, output):
    system = orc.System(step_size="10 ms", stop_time="2 s")
    return system.add("one", models[name]).connect(f"one.{output}", "one.u", {"gain": -1.0})


def report(system, tmp_path, capsys):
    system.to_yaml(tmp_path / "system.yaml")
    assert main(["stability", str(tmp_path / "system.yaml")]) == 0
    return capsys.readouterr().out


@pytest.mark.parametrize(("name", "output", "what"), [("Sign", "y", "der(x)"), ("Bend", "x", "der(v)")])
def test_an_event_at_the_operating_point_is_named(models, name, output, what, tmp_path, capsys):
    printed = report(fed_back(models, name, output), tmp_path, capsys)
    assert ", without what one does beside its linear equations" in printed.splitlines()[1]
    assert f"note: one: {what} jumps or bends at the operating point, as at an event" in printed


def test_a_smooth_law_is_no_event(models):
    linear = orc.linearise(fed_back(models, "Smooth", "x"))
    assert not linear.breaks and linear.modes().modes[0].root == pytest.approx(-2.0, rel=1e-9)


def test_a_mode_that_no_output_shows_is_listed(models):
    modes = orc.linearise(fed_back(models, "Hidden", "y")).modes()
    assert [one.root for one in modes.modes] == pytest.approx([0.3, -2.0])
    assert modes.modes[0].participation[0][0] == "one.h"


def test_an_algebraic_loop_without_a_solution_is_named(models):
    system = orc.System(step_size="10 ms", stop_time="1 s", master={"name": "iterative", "tolerance": 1e-9})
    system.add("one", models["Gain"]).add("two", models["Gain"])
    system.connect("one.y", "two.u").connect("two.y", "one.u")
    with pytest.raises(ConfigError, match=r"algebraic loop through one\.u, two\.u has no solution"):
        orc.linearise(system).modes()


def test_a_root_on_the_axis_has_no_margin_and_is_reported(models, tmp_path, capsys):
    printed = report(fed_back(models, "Ball", "h"), tmp_path, capsys)
    assert printed.splitlines()[1].startswith("on the border: 2 roots without damping")
    assert "the machine is stable" not in printed
    (found,) = orc.linearise(fed_back(models, "Ball", "h")).margins().values()
    assert found.modulus_margin == 0.0 and found.sensitivity_peak == np.inf


def test_a_contact_that_just_begins_is_no_delay():
    system = orc.System(step_size="0.1 ms", stop_time="1 s")
    system.add("body", "SatelliteDynamics", mass="100 kg", velocity="20 mm/s")
    system.add("contact", "DockingContact", stiffness="176 N/mm", front="0 mm", rear="-50 mm")
    system.connect("body.position", "contact.position").connect("body.velocity", "contact.velocity")
    linear = orc.linearise(system.connect("contact.force", "body.force"))
    assert not linear.late and linear.breaks == ("contact",)
    assert any("contact: position acts at once in one direction only" in note for note in linear.notes)
