"""FMUs of hybrid models for model exchange, integrated by fmpy's CVODE; early ends and returns of steps."""

from __future__ import annotations

import math
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import FMU2Model
from fmpy.fmi3 import FMU3Model, FMU3Slave
from fmpy.validation import validate_fmu
from scipy.integrate import solve_ivp
from test_hybrid_models import BALL, bounced, fmpy_instance, made

pytest.importorskip("rumoca", reason="needs the extra build")

import orchestrator as orc

VERSIONS = pytest.mark.parametrize("version", ["2.0", "3.0"])


def exchanged(fmu: Path, stop: float, step: float, *outputs: str, **options) -> dict[str, np.ndarray]:
    """Signals at the regular points, integrated by CVODE."""
    found = fmpy.simulate_fmu(
        str(fmu), stop_time=stop, output_interval=step, output=list(outputs), fmi_type="ModelExchange",
        relative_tolerance=1e-9, record_events=False, **options,
    )  # fmt: skip
    return {name: found[name].astype(float) for name in ("time", *outputs)}


@VERSIONS
def test_a_ball_bounces_when_it_must(tmp_path, version):
    fmu = made(tmp_path, BALL, version)
    assert validate_fmu(str(fmu)) == []
    found = exchanged(fmu, 3.0, 0.01, "h", "bounces")
    heights, counts = bounced(found["time"])
    assert np.abs(found["h"] - heights).max() < 1e-6
    assert (found["bounces"] == counts).all()


SAMPLED = """
model M
  parameter Real T = 0.1;
  input Real r(start=1);
  output Real x(start=0, fixed=true);
  output Real u(start=0, fixed=true);
  output Integer ticks(start=0, fixed=true);
equation
  der(x) = -2*x + u;
  when sample(0, 0.1) then
    u = pre(u) + 0.5*(r - x);
    ticks = pre(ticks) + 1;
  end when;
end M;
"""


def sampled(times: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """State, output and ticks of the sampled controller, by the exact map from tick to tick."""
    x, u, rows, after = 0.0, 0.0, [], []
    for _ in range(int(times[-1] / 0.1) + 2):
        u += 0.5 * (1 - x)
        rows.append((x, u))
        x = u / 2 + (x - u / 2) * math.exp(-0.2)
    for time in times:
        tick = int(time / 0.1 + 1e-9)
        x, u = rows[tick]
        after.append((u / 2 + (x - u / 2) * math.exp(-2 * (time - 0.1 * tick)), u, tick + 1))
    return tuple(np.array(after).T)


@VERSIONS
def test_time_events_are_reported_beforehand(tmp_path, version):
    found = exchanged(made(tmp_path, SAMPLED, version), 2.0, 0.05, "x", "u", "ticks")
    state, output, ticks = sampled(found["time"])
    assert (found["ticks"] == ticks).all()
    assert np.abs(found["x"] - state).max() < 1e-6
    assert np.abs(found["u"] - output).max() < 1e-6


PENDULUM = """
model M
  parameter Real L = 1, g = 9.81, m = 1;
  output Real x(start=0.6, fixed=true), y(start=-0.8);
  output Real vx(start=0, fixed=true), vy;
  Real F;
equation
  der(x) = vx;
  der(y) = vy;
  m*der(vx) = -F*x;
  m*der(vy) = -F*y - m*g;
  x^2 + y^2 = L^2;
end M;
"""


@VERSIONS
def test_a_pendulum_stays_on_its_circle(tmp_path, version):
    """Index 3: the importer integrates all four states; events bring them back to the constraints."""
    found = exchanged(made(tmp_path, PENDULUM, version), 5.0, 0.05, "x", "y")
    angle = solve_ivp(
        lambda _, s: [s[1], -9.81 * math.sin(s[0])], (0, 5), [math.asin(0.6), 0.0], t_eval=found["time"],
        rtol=1e-11, atol=1e-12,
    ).y[0]  # fmt: skip
    assert np.abs(found["x"] - np.sin(angle)).max() < 1e-5
    assert np.abs(found["x"] ** 2 + found["y"] ** 2 - 1).max() < 1e-6


RELAY = """
model M
  input Real u(start=0);
  output Real x(start=0.5, fixed=true);
  output Real y;
  output Boolean on;
  Integer switched(start=0, fixed=true);
equation
  on = x + u > 1;
  when on then
    switched = pre(switched) + 1;
  end when;
  y = if on then -x^2 else 2*x + u;
  der(x) = y;
end M;
"""


def model_of(fmu: Path, tmp_path: Path, kind: type = FMU2Model):
    description = fmpy.read_model_description(str(fmu))
    one = kind(
        guid=description.guid, unzipDirectory=fmpy.extract(str(fmu), unzipdir=str(tmp_path / "unpacked")),
        modelIdentifier=description.modelExchange.modelIdentifier, instanceName="one",
    )  # fmt: skip
    one.instantiate()
    one.reference = {each.name: each.valueReference for each in description.modelVariables}
    return one


def test_modes_are_held_between_events(tmp_path):
    """Derivatives, indicators, the step's end and an event, called one by one; exact derivatives."""
    one = model_of(made(tmp_path, RELAY), tmp_path)
    ref = one.reference
    one.setupExperiment(startTime=0.0)
    one.enterInitializationMode()
    one.exitInitializationMode()
    more, ends, _, _, defined, _ = one.newDiscreteStates()
    assert not more and not ends and not defined
    one.enterContinuousTimeMode()

    def derivative(x: float) -> float:
        values = (fmpy.fmi2.fmi2Real * 1)(x)
        one.setContinuousStates(values, 1)
        one.getDerivatives(values, 1)
        return values[0]

    def indicator() -> float:
        values = (fmpy.fmi2.fmi2Real * 1)()
        one.getEventIndicators(values, 1)
        return values[0]

    assert derivative(0.5) == 1.0
    assert indicator() == pytest.approx(-0.5)
    # Beyond the event the equations are those of before, until the event is handled.
    assert derivative(1.25) == 2.5
    assert indicator() == pytest.approx(0.25)
    assert one.getBoolean([ref["on"]]) == [False]
    assert one.getDirectionalDerivative([ref["der(x)"]], [ref["x"]], [1.0]) == pytest.approx([2.0], rel=1e-8)
    enter, ends = one.completedIntegratorStep()
    assert enter and not ends
    state = one.getFMUState()
    saved = one.serializeFMUState(state)
    one.enterEventMode()
    one.newDiscreteStates()
    one.enterContinuousTimeMode()
    assert one.getBoolean([ref["on"]]) == [True]
    assert derivative(1.25) == -(1.25**2)
    assert one.getDirectionalDerivative([ref["der(x)"]], [ref["x"]], [1.0]) == pytest.approx([-2.5], rel=1e-8)
    # A saved state holds the modes and the kind of mode.
    one.setFMUState(one.deSerializeFMUstate(saved))
    assert derivative(1.25) == 2.5 and one.getBoolean([ref["on"]]) == [False]
    one.freeFMUState(state)
    one.terminate()
    one.freeInstance()


def test_an_event_just_before_its_root_is_seen(tmp_path):
    """An importer stops within its tolerance of the root, here 1e-14 before it: the event still happens."""
    one = model_of(made(tmp_path, BALL), tmp_path)
    one.setupExperiment(startTime=0.0)
    one.enterInitializationMode()
    one.exitInitializationMode()
    one.newDiscreteStates()
    one.enterContinuousTimeMode()
    hit = math.sqrt(2 / 9.81)
    one.setTime(hit)
    one.setContinuousStates((fmpy.fmi2.fmi2Real * 2)(1e-14, -9.81 * hit), 2)
    one.enterEventMode()
    _, _, _, changed, _, _ = one.newDiscreteStates()
    assert changed
    assert one.getReal([one.reference["v"]])[0] == pytest.approx(0.8 * 9.81 * hit, rel=1e-9)
    assert one.getInteger([one.reference["bounces"]]) == [1]
    one.freeInstance()


ENDING = """
model M
  output Real x(start=0, fixed=true);
  output Integer n(start=0, fixed=true);
equation
  der(x) = 1;
  when sample(0.25, 0.25) then
    n = pre(n) + 1;
  end when;
  when x > 0.7 then
    terminate("enough");
  end when;
end M;
"""


@VERSIONS
def test_terminate_ends_a_step_regularly(tmp_path, version):
    fmu = made(tmp_path, ENDING, version)
    result = orc.run(str(fmu), set={"run.stop_time": 2.0, "run.step_size": 0.1}, halving=False)
    assert "enough" in str(result.summary)
    assert 0.6 <= result["M.x"][-1] <= 0.7 + 1e-9
    found = exchanged(fmu, 2.0, 0.1, "x")
    assert found["time"][-1] <= 0.8 and found["x"][-1] == pytest.approx(found["time"][-1])


def test_fmi2_tells_when_and_that_a_model_ended(tmp_path):
    fmu = made(tmp_path, ENDING)
    description = fmpy.read_model_description(str(fmu))
    with fmpy_instance(fmu, description, tmp_path) as one:
        one.doStep(0.0, 0.5)
        with pytest.raises(Exception, match="discard"):
            one.doStep(0.5, 0.5)
        assert one.getBooleanStatus(fmpy.fmi2.fmi2Terminated)
        assert one.getRealStatus(fmpy.fmi2.fmi2LastSuccessfulTime) == pytest.approx(0.7, abs=1e-10)
        assert one.getReal([1])[0] == pytest.approx(0.7, abs=1e-10)


def test_fmi3_returns_early_at_events_where_allowed(tmp_path):
    fmu = made(tmp_path, ENDING, "3.0")
    description = fmpy.read_model_description(str(fmu))
    unpacked = fmpy.extract(str(fmu), unzipdir=str(tmp_path / "unpacked"))
    for allowed, stops in ((True, [0.25, 0.5, 0.6, 0.7]), (False, [0.6, 0.7])):
        one = FMU3Slave(
            guid=description.guid, unzipDirectory=unpacked, instanceName="one",
            modelIdentifier=description.coSimulation.modelIdentifier,
        )  # fmt: skip
        one.instantiate(earlyReturnAllowed=allowed)
        one.enterInitializationMode(startTime=0.0)
        one.exitInitializationMode()
        time, reached, ended = 0.0, [], False
        while not ended:
            end = 0.6 if time < 0.6 - 1e-9 else 2.0
            _, ended, early, time = one.doStep(time, end - time)
            assert early == (allowed and time not in (0.6, 2.0) and not ended)
            reached.append(time)
        assert reached == pytest.approx(stops, abs=1e-9)
        one.terminate()
        one.freeInstance()


@VERSIONS
def test_the_product_integrates_them_as_well(tmp_path, version):
    ball = {"fmu": str(made(tmp_path, BALL, version)), "interface": "model-exchange", "tolerance": 1e-9}
    config = {
        "run": {"master": "jacobi", "step_size": "10 ms", "stop_time": "2 s"},
        "instances": {"ball": ball},
    }
    found = orc.run(config, halving=False)
    heights, counts = bounced(np.arange(len(found["ball.h"])) * 0.01)
    assert np.abs(np.array(found["ball.h"]) - heights).max() < 1e-5
    assert (np.array(found["ball.bounces"]) == counts).all()


def test_calls_of_the_other_kind_are_refused(tmp_path):
    """Steps of an instance for model exchange, and times of one for co-simulation."""
    fmu = made(tmp_path, BALL, "3.0")
    one = model_of(fmu, tmp_path, FMU3Model)
    one.enterInitializationMode(startTime=0.0)
    one.exitInitializationMode()
    with pytest.raises(Exception, match="fmi3SetContinuousStates"):
        one.setContinuousStates((fmpy.fmi3.fmi3Float64 * 2)(1.0, 0.0), 2)  # in Event Mode
    one.updateDiscreteStates()
    one.enterContinuousTimeMode()
    one.setContinuousStates((fmpy.fmi3.fmi3Float64 * 2)(1.0, 0.0), 2)
    one.terminate()
    one.freeInstance()


def test_a_discrete_variable_that_no_relation_changes_asks_for_an_event(tmp_path):
    """Functions raise no events: the end of an integrator's step is where their Integer results change."""
    fmu = made(tmp_path, """
model M
  function level
    input Real u;
    output Integer k;
  algorithm
    k := if u < 0.25 then 0 elseif u < 0.6 then 1 else 2;
  end level;
  output Integer k;
  Real x(start=0, fixed=true);
  Integer n(start=0, fixed=true);
equation
  k = level(time);
  der(x) = 1;
  when x > 2 then
    n = pre(n) + 1;
  end when;
end M;
""")  # fmt: skip
    found = exchanged(fmu, 1.0, 0.05, "k")
    time = found["time"]
    away = (np.abs(time - 0.25) > 1e-6) & (np.abs(time - 0.6) > 1e-6)
    assert (found["k"] == np.where(time < 0.25, 0, np.where(time < 0.6, 1, 2)))[away].all()
