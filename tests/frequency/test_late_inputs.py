"""Inputs that act on nothing at once at the operating point."""

from __future__ import annotations

import pytest

import orchestrator as orc
from orchestrator.base.errors import ConfigError

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
    assert "one.u acts on nothing at the start; it is left open" in linear.notes


def test_an_open_contact_is_not_taken_for_a_fault_of_the_model():
    with pytest.raises(ConfigError) as caught:
        orc.linearise("docking-6d")
    why = (
        "contact: at the operating point input orientation[1] changes no output and no state's derivative "
        "at once: an inactive part of the model, as an open contact, a delay or a sample lies between; it "
        "cannot be run on its own to look for a delay"
    )
    assert why in str(caught.value)
