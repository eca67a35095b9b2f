"""Delays in models with events, against exact solutions."""

from __future__ import annotations

import math

import fmpy
import numpy as np
import pytest

pytest.importorskip("rumoca", reason="needs the extra build")

from orchestrator.base.errors import BuildError
from tests.translate.hybrid.test_hybrid_models import fmpy_instance, made, run

EVENT = "Boolean late(start=false, fixed=true);\nequation\nwhen time > 0.33 then late = true; end when;\n"


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_delayed_functions_of_time_and_states(tmp_path, version):
    fmu = made(tmp_path, f"""
model M
  parameter Real T = 0.4;
  Real x(start=1, fixed=true);
  output Real y, z, w;
  {EVENT}
  der(x) = -x;
  y = delay(x, T);
  z = delay(y, 2*T);
  w = delay(sin(20*time), 0.123);
end M;
""", version)  # fmt: skip
    found = run(fmu, 3.0, 0.05, "y", "z", "w", start_values={"T": 0.5})
    time = found["time"]
    assert found["y"] == pytest.approx(np.exp(-np.clip(time - 0.5, 0, None)), abs=2e-8)
    assert found["z"] == pytest.approx(np.exp(-np.clip(time - 1.5, 0, None)), abs=2e-8)
    assert found["w"] == pytest.approx(np.sin(20 * np.clip(time - 0.123, 0, None)), abs=2e-8)


def test_a_delay_differential_equation(tmp_path):
    """x' = -x(t - 1) with x = 1 before, by the method of steps."""
    fmu = made(tmp_path, f"""
model M
  Real x(start=1, fixed=true);
  {EVENT}
  der(x) = -delay(x, 1);
end M;
""")  # fmt: skip
    found = run(fmu, 4.0, 0.125, "x")

    def exact(t: float) -> float:
        return sum((-1) ** k * max(t - k + 1, 0) ** k / math.factorial(k) for k in range(6))

    assert found["x"] == pytest.approx([exact(t) for t in found["time"]], abs=1e-7)


def test_jumps_arrive_when_they_must(tmp_path):
    """The integral of a delayed pulse, and a count of its delayed edges, do not depend on the step."""
    text = """
model M
  Integer n(start=0, fixed=true), edges(start=0, fixed=true);
  Real area(start=0, fixed=true), pulse, late;
equation
  when sample(0.3, 0.7) then
    n = pre(n) + 1;
  end when;
  pulse = if mod(n, 2) > 0.5 then 1 + time else 0;
  late = delay(pulse, 0.25);
  der(area) = late;
  when late > 0.5 then
    edges = pre(edges) + 1;
  end when;
end M;
"""
    fmu = made(tmp_path, text)
    for step in (0.1, 1.5):
        found = run(fmu, 3.0, step, "area", "edges", "late")
        for time, area, edges in zip(found["time"], found["area"], found["edges"], strict=True):
            begins = [0.55, 1.95]
            exact = 0.0
            for begin in begins:
                a, b = min(max(time, begin), begin + 0.7), begin
                exact += (1 - 0.25) * (a - b) + (a**2 - b**2) / 2
            assert area == pytest.approx(exact, abs=1e-9)
            assert edges == sum(time >= one + 1e-9 for one in begins)


def test_a_saved_state_holds_the_history(tmp_path):
    fmu = made(tmp_path, f"""
model M
  Real x(start=1, fixed=true);
  output Real y;
  {EVENT}
  der(x) = -delay(x, 0.3);
  y = delay(x*x, 0.2);
end M;
""")  # fmt: skip
    description = fmpy.read_model_description(fmu)
    assert description.modelExchange is None
    numbers = {one.name: one.valueReference for one in description.modelVariables}
    with fmpy_instance(fmu, description, tmp_path) as one:
        one.doStep(0.0, 0.4)
        state = one.getFMUState()
        found = []
        for _ in range(2):
            one.doStep(0.4, 0.1)
            one.doStep(0.5, 0.3)
            found.append(one.getReal([numbers["x"], numbers["y"]]))
            one.setFMUState(state)
        assert found[0] == found[1]


def test_delays_that_cannot_be(tmp_path):
    head = f"model M\nparameter Real T = 0;\nReal x(start=1, fixed=true);\n{EVENT}"
    with pytest.raises(BuildError, match=r"M\.mo:7:.*delay\(\) with a delay time that changes"):
        made(tmp_path, f"{head}der(x) = -delay(x, x + 0.1, 2);\nend M;\n")
    fmu = made(tmp_path, f"{head}der(x) = -delay(x, T);\nend M;\n")
    with pytest.raises(Exception, match="ExitInitializationMode"):
        run(fmu, 1.0, 0.1, "x")
    assert run(fmu, 0.2, 0.1, "x", start_values={"T": 1.0})["x"][-1] == pytest.approx(0.8)


def test_a_delay_is_shown_as_the_model_writes_it(tmp_path):
    from orchestrator.translate.show import show_model

    source = tmp_path / "M.mo"
    source.write_text(
        f"model M\nReal x(start=1, fixed=true), y;\n{EVENT}der(x) = -x;\ny = delay(x, 0.5);\nend M;\n"
    )
    assert "y = delay(x, 0.5)" in show_model(source, "blocks")


def test_a_delay_that_is_long_beside_the_steps(tmp_path):
    """A wave on a line of 1 s, which a load of three times the line's impedance reflects by half."""
    fmu = made(tmp_path, f"""
model M
  parameter Real Z = 50, T = 1, R = 150;
  Real es(start=0), er(start=0), v1, i1, v2(start=0), i2;
  output Real load = v2;
  {EVENT}
  i1 = (v1 - es)/Z;
  i2 = (v2 - er)/Z;
  es = 2*delay(v2, T) - delay(er, T);
  er = 2*delay(v1, T) - delay(es, T);
  v1 = sin(230*time);
  v2 = -R*i2;
end M;
""")  # fmt: skip
    found = run(fmu, 4.5, 0.0501, "load")

    def exact(t: float) -> float:
        # at the load 1.5 of what arrives; the voltage source sends -1/2 of it back each 2 s
        return sum(1.5 * (-0.5) ** k * math.sin(230 * max(t - 1 - 2 * k, 0)) for k in range(2))

    assert found["load"] == pytest.approx([exact(t) for t in found["time"]], abs=1e-6)
