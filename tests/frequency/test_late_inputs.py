"""Inputs that act on nothing at once at the operating point."""

from __future__ import annotations

import numpy as np
import pytest

import orchestrator as orc

BENT = """
model Bent "Answers the square of its input"
  input Real u(start = 0);
  output Real y(start = 0, fixed = true);
equation
  der(y) = -y + u ^ 2;
end Bent;
"""


def test_an_input_of_second_order_is_left_open(tmp_path):
    pytest.importorskip("casadi", reason="needs the extra build")
    (tmp_path / "Bent.mo").write_text(BENT, encoding="utf-8")
    model = str(orc.build(tmp_path / "Bent.mo", tmp_path / "Bent.fmu").path)
    system = orc.System(step_size="10 ms", stop_time="1 s", master="jacobi")
    system.add("one", model).add("two", model)
    system.connect("one.y", "two.u").connect("two.y", "one.u")
    linear = orc.linearise(system.data)
    assert [mode.root for mode in linear.modes().modes] == pytest.approx([-1.0, -1.0])
    assert any(note.startswith("one: nothing depends on u at the operating point") for note in linear.notes)


REFUSES = """
model Refuses "Late answer to an input that may hardly leave its place"
  input Real u(start = 1);
  output Real y(start = 1, fixed = true);
equation
  der(y) = 50 * (delay(u ^ 2, 0.002) - y);
  assert(abs(u - 1) < 2e-4, "u is no unit");
end Refuses;
"""


def test_a_step_that_the_fmu_refuses_becomes_smaller(tmp_path):
    """The usual step of 1e-3 is refused."""
    pytest.importorskip("casadi", reason="needs the extra build")
    (tmp_path / "Refuses.mo").write_text(REFUSES, encoding="utf-8")
    system = orc.System(step_size="1 ms", stop_time="1 s")
    system.add("one", str(orc.build(tmp_path / "Refuses.mo", tmp_path / "Refuses.fmu").path))
    system.connect("one.y", "one.u")
    linear = orc.linearise(system.data)
    assert linear.late["one.u"].delay == pytest.approx(2e-3, rel=1e-6)
    root = linear.modes(1).modes[0].root
    assert root == pytest.approx(50.0 * (2.0 * np.exp(-0.002 * root) - 1.0), rel=1e-3)


def test_what_a_solver_adds_late_in_a_run_is_no_answer():
    """Signals move at that time, so that the robot's solver takes other steps for other inputs."""
    linear = orc.linearise("docking-6d-uncompensated", at_time=0.31)
    late = {name: one.delay for name, one in linear.late.items() if name.startswith("robot.")}
    assert len(late) == 7
    assert list(late.values()) == pytest.approx(7 * [2e-3], rel=1e-6)
