"""FMUs that sample: their law from step responses, and whether it moves as they do."""

from __future__ import annotations

import numpy as np
import pytest
from modelica_texts import built_models

from orchestrator.cli.main import main
from orchestrator.frequency import linearise
from orchestrator.frequency.linearity import unlike_parts
from orchestrator.simulation.run import prepare

PLANT = """
model Plant "first order, and a deviation from what is wanted"
  input Real u(start = 0);
  output Real e;
  output Real x(start = 0.1, fixed = true);
equation
  der(x) = 10 * (u - x);
  e = -x;
end Plant;
"""
SAMPLED = """
model Sampled "PI, with a filter"
  parameter Real kp = 2;
  parameter Real ki = 3;
  parameter Real T = 0.02;
  input Real e(start = 0);
  output Real u(start = 0, fixed = true);
  discrete Real s(start = 0, fixed = true);
  discrete Real d(start = 0, fixed = true);
equation
  when sample(T, T) then
    s = pre(s) + T * e;
    d = e + 0.5 * pre(d);
    u = kp * d + ki * s;
  end when;
end Sampled;
"""
RELAY = """
model Relay
  input Real e(start = 0);
  output Real u(start = 0, fixed = true);
equation
  when sample(0.01, 0.01) then
    u = if e > 0 then 2 * e else e;
  end when;
end Relay;
"""


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    return built_models(tmp_path_factory.mktemp("models"), PLANT, SAMPLED, RELAY)


def loop(models, controller, step="5 ms", master="gauss-seidel"):
    return {
        "run": {"master": master, "step_size": step, "stop_time": "2 s"},
        "instances": {"c": {"fmu": models[controller]}, "p": {"fmu": models["Plant"]}},
        "connections": ["p.e -> c.e", {"from": "c.u", "to": "p.u", "through": [{"delay": "12 ms"}]}],
    }


def test_a_sampled_law_has_the_response_of_its_difference_equations(models):
    found = linearise(loop(models, "Sampled"))
    (note,) = (one for one in found.notes if "samples every" in one)
    assert "samples every 0.02 s" in note and "2 states" in note
    law = found.laws["c"].sampled
    z = np.exp(0.02j * np.array([1.0, 20.0, 100.0]))
    eye = np.eye(len(law.states))
    # A sample takes its input at once: z x is the state after it.
    made = [(law.c @ np.linalg.solve(one * eye - law.a, law.b) + law.d)[0, 0] for one in z]
    expected = 2.0 / (1.0 - 0.5 / z) + 3.0 * 0.02 / (1.0 - 1.0 / z)
    assert made == pytest.approx(expected, rel=1e-8)
    # In the limit of short samples, what is held is half a period late.
    omega = np.array([1.0, 5.0])
    plant = 10.0 / (1j * omega + 10.0) * np.exp(-0.012j * omega)
    z = np.exp(0.02j * omega)
    held = 2.0 / (1.0 - 0.5 / z) + 3.0 * 0.02 / (1.0 - 1.0 / z)
    expected = plant * held * np.exp(-0.01j * omega)
    name = next(name for name in found.margins() if name.endswith("p.u"))
    assert found.system.open_loop(name, omega) == pytest.approx(expected, rel=6e-4)


@pytest.mark.parametrize("step", ["20 ms", "5 ms"])
@pytest.mark.parametrize("master", ["jacobi", "gauss-seidel"])
def test_runs_decay_as_master_step_and_samples_have_it(models, step, master):
    from orchestrator.frequency.verify import verified

    config = loop(models, "Sampled", step, master)
    found = verified(config, linearise(config))["sampled"]
    assert found and all(one["difference"] < 1e-4 for one in found)


def test_a_law_that_differs_by_sign_is_not_linear(models):
    config = loop(models, "Relay")
    config["instances"]["p"]["start"] = {"x": 0.0}
    linear = linearise(config)
    (one,) = unlike_parts(prepare(config), linear, linear.modes())
    assert (one.instance, one.output, one.drifts) == ("c", "u", False) and one.difference > 0.3


def test_a_point_that_moves_on_is_named_and_the_steady_state_is_not(capsys):
    assert main(["stability", "tank-level"]) == 0
    assert "tanks does not rest at its operating point" in capsys.readouterr().out
    assert main(["stability", "tank-level", "--trim"]) == 0
    assert "does not rest" not in capsys.readouterr().out
