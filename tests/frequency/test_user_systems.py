"""Systems as users write them: roots against characteristic equations set up by hand."""

from __future__ import annotations

import numpy as np
import pytest
from modelica_texts import built_models
from scipy.optimize import newton

import orchestrator as orc
from orchestrator.frequency.from_system import linearise
from orchestrator.frequency.moving_point import momentary_roots
from orchestrator.frequency.system_report import system_stability, system_text
from orchestrator.frequency.trim import trim
from orchestrator.frequency.verify import verified
from orchestrator.simulation.run import prepare

PENDULUM = """
model Pendulum "Inverted pendulum on a cart"
  input Real force(unit = "N", start = 0);
  output Real position(unit = "m", start = 0, fixed = true);
  output Real velocity(unit = "m/s", start = 0, fixed = true);
  output Real angle(unit = "rad", start = 0.02, fixed = true);
  output Real rate(unit = "rad/s", start = 0, fixed = true);
equation
  der(position) = velocity;
  der(angle) = rate;
  1.35 * der(velocity) + 0.06 * cos(angle) * der(rate) =
    force - 0.3 * velocity + 0.06 * rate ^ 2 * sin(angle);
  0.4 * der(rate) + cos(angle) * der(velocity) = 9.81 * sin(angle);
end Pendulum;
"""
FEEDBACK = """
model Feedback "State feedback"
  input Real position(unit = "m", start = 0);
  input Real velocity(unit = "m/s", start = 0);
  input Real angle(unit = "rad", start = 0);
  input Real rate(unit = "rad/s", start = 0);
  output Real force(unit = "N");
equation
  force = 2 * position + 4 * velocity + 45 * angle + 8 * rate;
end Feedback;
"""
PLL = """
model Pll "A phase-locked loop whose phase arrives late, and which begins out of phase"
  parameter Real phase = 0.3;
  output Real angle(start = 0, fixed = true);
  Real i(start = 0, fixed = true);
  Real e;
equation
  e = sin(phase - delay(angle, 0.004));
  der(i) = 900 * e;
  der(angle) = 60 * e + i;
end Pll;
"""
SUM = """
model Sum "Direct feedthrough"
  input Real a(start = 0);
  input Real b(start = 0);
  output Real y;
equation
  y = 0.5 * a + b;
end Sum;
"""
LEAD = """
model Lead "A lead filter with direct feedthrough"
  input Real u(start = 0);
  output Real y;
  Real x(start = 0, fixed = true);
equation
  der(x) = 7.5 * (u - x);
  y = u + 3 * (u - x);
end Lead;
"""
PLANT = """
model Plant "A plant with direct feedthrough"
  input Real u(start = 0);
  output Real y;
  Real x1(start = 0.1, fixed = true);
  Real x2(start = 0, fixed = true);
equation
  der(x1) = x2;
  der(x2) = -2 * x1 - 3 * x2 + u;
  y = x1 + 0.1 * u;
end Plant;
"""
SWINGING = """
model Swinging "Its growth swings with time, and a fast sensor follows it"
  output Real sensed(start = 0.01, fixed = true);
  Real clock(start = 0, fixed = true);
  Real x(start = 0.01, fixed = true);
equation
  der(clock) = 1;
  der(x) = 0.5 * cos(3 * clock) * x;
  der(sensed) = 50 * (x - sensed);
end Swinging;
"""
TURNED = """
model Turned "An attitude as the two numbers of a quaternion about one axis"
  input Real torque(start = 0);
  output Real real_part;
  output Real axis_part;
  Real angle(start = 0, fixed = true);
  Real spin(start = 0, fixed = true);
equation
  der(angle) = spin;
  der(spin) = torque;
  real_part = cos(angle / 2);
  axis_part = sin(angle / 2);
end Turned;
"""
POINTING = """
model Pointing "A controller of an attitude"
  input Real real_part(start = 1);
  input Real axis_part(start = 0);
  output Real torque;
  Real filtered(start = 0, fixed = true);
equation
  der(filtered) = 20 * (real_part * axis_part - filtered);
  torque = -8 * filtered - 20 * 0.4 * (real_part * axis_part - filtered);
end Pointing;
"""


RUBBED = """
model Rubbed "A mass on a spring with steep friction"
  output Real x(start = 0.1, fixed = true);
  Real v(start = 0, fixed = true);
equation
  der(x) = v;
  der(v) = -100 * x - tanh(v / 0.001);
end Rubbed;
"""


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    texts = (PENDULUM, FEEDBACK, PLL, SUM, LEAD, PLANT, SWINGING, TURNED, POINTING, RUBBED)
    return built_models(tmp_path_factory.mktemp("models"), *texts)


def system_of(models, step, stop, master="gauss-seidel", **instances):
    system = orc.System(step_size=step, stop_time=stop, master=master)
    for name, model in instances.items():
        system.add(name, models[model])
    return system


def balanced(models):
    system = system_of(models, "2 ms", "5 s", cart="Pendulum", control="Feedback")
    system.connect("cart.position", "control.position")
    system.connect("cart.velocity", "control.velocity", {"low-pass": "20 Hz"})
    system.connect("cart.angle", "control.angle", {"delay": "15 ms"})
    system.connect("cart.rate", "control.rate", {"delay": "15 ms"})
    system.connect("control.force", "cart.force", {"saturate": {"low": "-30 N", "high": "30 N"}})
    return system.data


def test_a_balanced_pendulum_has_the_roots_of_its_linear_equations(models):
    report = system_stability(prepare(balanced(models), ["cart.angle=0 rad"]))

    def characteristic(s):
        # 1.35 v' + 0.06 w' = F - 0.3 v and 0.4 w' + v' = 9.81 angle, by their transfer functions to F.
        late, slow = np.exp(-0.015 * s), 1 / (1 + s / (2 * np.pi * 20))
        matrix = np.array(
            [
                [1.35 * s**2 + 0.3 * s - 2 - 4 * s * slow, 0.06 * s**2 - (45 + 8 * s) * late],
                [s**2, 0.4 * s**2 - 9.81],
            ]
        )
        return np.linalg.det(matrix)

    found = [complex(*one["root"]) for one in report["modes"]]
    assert found[:2] == pytest.approx(
        [newton(characteristic, one) for one in (-0.7 + 0.6j, -7.2 + 3.3j)], rel=1e-6
    )
    # The cart alone is unstable: what it does after seconds on its own is no sign of a nonlinear law.
    assert report["not_linear"] == []


def test_a_delay_within_an_fmu_is_found_where_the_fmu_does_not_rest(models):
    linear = orc.linearise(system_of(models, "1 ms", "2 s", pll="Pll").data)
    gain = np.cos(0.3)

    def characteristic(s):
        return s**2 + gain * (60 * s + 900) * np.exp(-0.004 * s)

    exact = [newton(characteristic, one) for one in (-24.0, -47.0)]
    assert linear.roots()[:2].real == pytest.approx(exact, rel=2e-3)


def test_an_algebraic_loop_is_solved_and_verified_with_steps_of_its_own(models):
    master = {"name": "iterative", "tolerance": 1e-10}
    system = system_of(models, "5 ms", "20 s", master, sum="Sum", lead="Lead", plant="Plant")
    system.connect("sum.y", "lead.u").connect("lead.y", "plant.u", {"gain": 1.5})
    system.connect("plant.y", "sum.b", {"gain": -1}).connect("lead.y", "sum.a", {"gain": -0.2})
    config = system.data
    config["instances"]["plant"]["step_size"] = "5 ms"
    linear = orc.linearise(config)
    # Lead (4 s + 7.5)/(s + 7.5), plant 1/((s + 1)(s + 2)) + 0.1, 1 + lead (0.1 + 1.5 plant) = 0.
    lead, of_lead = np.poly1d([4, 7.5]), np.poly1d([1, 7.5])
    plant, of_plant = np.poly1d([0.1, 0.3, 1.2]), np.poly1d([1, 3, 2])
    exact = (of_lead * of_plant + lead * (0.1 * of_plant + 1.5 * plant)).roots
    assert np.sort_complex(linear.roots()) == pytest.approx(np.sort_complex(exact), rel=1e-9)
    assert verified(config, linear)["steps"][-1]["difference"] < 0.01


def test_roots_that_hold_for_one_moment_only_are_distinguished_from_those_that_last(models):
    prepared = prepare(system_of(models, "5 ms", "10 s", one="Swinging").data)
    linear = linearise(prepared)
    (root, time), *others = momentary_roots(prepared, linear, linear.modes()).items()
    assert root == pytest.approx(0.5)
    assert not others  # that of the sensor, -50 1/s
    # cos(3 t) has fallen by 30 % here; it is looked at in ratios of 1.4.
    changed = np.arccos(0.7) / 3
    assert changed <= time <= 1.4 * changed + 0.005
    report = system_stability(prepared)
    assert "1 root with positive real part holds for this moment only" in report["verdict"]
    assert "-50 1/s: real; one.sensed" in system_text(report)


def test_a_system_at_rest_has_no_momentary_roots(models):
    prepared = trim(prepare(balanced(models))).prepared
    linear = linearise(prepared)
    assert momentary_roots(prepared, linear, linear.modes()) == {}


def test_the_real_part_of_a_quaternion_is_a_smooth_law(models):
    system = system_of(models, "5 ms", "20 s", body="Turned", control="Pointing")
    system.connect("body.real_part", "control.real_part").connect("body.axis_part", "control.axis_part")
    report = system_stability(prepare(system.connect("control.torque", "body.torque").data))
    # s^2 (s + 20) + (8 20 + 8 s) / 2 = 0, of a body with unit inertia and half the angle on the axis.
    exact = np.roots([1, 20, 4, 80])
    assert complex(*report["modes"][0]["root"]) == pytest.approx(
        max(exact, key=lambda one: one.real), rel=1e-6
    )
    assert report["not_linear"] == []


def test_steep_friction_is_no_memory_and_an_undamped_pair_counts_twice(models):
    system = system_of(models, "1 ms", "1 s", mass="Rubbed")
    report = system_stability(prepare(system.data))
    assert not any("before" in note for note in report["notes"])
    rates = np.roots([1.0, 1000.0, 100.0])
    assert [complex(*one["root"]) for one in report["modes"]] == pytest.approx(sorted(rates)[::-1], rel=1e-6)
