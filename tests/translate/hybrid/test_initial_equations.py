"""FMUs of models that give their start more than once, against exact solutions."""

from __future__ import annotations

import math

import fmpy
import pytest
from scipy.optimize import brentq

pytest.importorskip("rumoca", reason="needs the extra build")

from test_hybrid_models import made, run

from orchestrator.base.errors import BuildError

SURPLUS = """
model M
  parameter Real k = 3;
  Real x(start=2, fixed=true), y, z;
initial equation
  x = 2;
  y = k*x;
  der(z) = 0;
  z = 6;
equation
  der(x) = -x;
  der(y) = -y;
  der(z) = y - z;
end M;
"""
NONLINEAR = """
model M
  parameter Real e = 5;
  Real x, y;
initial equation
  x*x*x + x = 10;
  exp(y) = exp(e);
  y = x*x + 1;
equation
  der(x) = -x;
  der(y) = -2*y;
end M;
"""


def test_redundant_initial_equations_that_agree_are_accepted(tmp_path):
    """z' = y - z from z = y = 6: z = 6(1 + t) exp(-t)."""
    found = run(made(tmp_path, SURPLUS), 1.0, 0.5, "x", "y", "z")
    for k, t in enumerate((0.0, 0.5, 1.0)):
        assert found["x"][k] == pytest.approx(2 * math.exp(-t), rel=1e-6)
        assert found["z"][k] == pytest.approx(6 * (1 + t) * math.exp(-t), rel=1e-6)


def test_a_redundant_equation_that_a_parameter_breaks_ends_the_start(tmp_path):
    fmu = made(tmp_path, SURPLUS)
    said: list[str] = []
    with pytest.raises(fmpy.fmi1.FMICallException):
        run(fmu, 1.0, 0.5, "z", start_values={"k": 4.0}, logger=lambda *one: said.append(one[-1].decode()))
    assert any("contradict the initial equation of line 9 for z" in one for one in said)


def test_redundancy_behind_a_nonlinear_equation_is_checked_at_the_start(tmp_path):
    """x = 2 is the real root of x^3 + x = 10; then y = 5 on both ways."""
    fmu = made(tmp_path, NONLINEAR)
    found = run(fmu, 1.0, 1.0, "x", "y")
    assert found["x"][0] == pytest.approx(2, rel=1e-9)
    assert found["y"][-1] == pytest.approx(5 * math.exp(-2), rel=1e-6)
    said: list[str] = []
    with pytest.raises(fmpy.fmi1.FMICallException):
        run(fmu, 1.0, 1.0, "x", start_values={"e": 6.0}, logger=lambda *one: said.append(one[-1].decode()))
    assert any("contradict the initial equation" in one and "y" in one for one in said)


@pytest.mark.parametrize("gap", ["6.1", "6.003"])
def test_redundant_initial_equations_that_contradict_are_refused_by_name(tmp_path, gap):
    with pytest.raises(BuildError, match=r"M\.mo:9:3: too many initial .*: this one for z .* off by 0\."):
        made(tmp_path, SURPLUS.replace("z = 6", f"z = {gap}"))


def test_fixed_starts_of_a_rigid_coupling_have_to_agree(tmp_path):
    """Two masses that move as one: the second start is redundant, whether it agrees or not."""
    text = """
model M
  Real v(start=3, fixed=true), w(start=6, fixed=true), f;
equation
  der(v) = f - v;
  2*der(w) = -f;
  w = 2*v;
end M;
"""
    found = run(made(tmp_path, text), 1.0, 1.0, "v", "w")
    assert found["w"][-1] == pytest.approx(6 * math.exp(-1 / 5), rel=1e-6)
    with pytest.raises(BuildError, match="start value of w must not have fixed=true, since it is off by 1"):
        made(tmp_path, text.replace("start=6", "start=5"))


@pytest.mark.parametrize("start", (0.01, 2))
def test_a_calculated_parameter_stays_within_its_range(tmp_path, start):
    """Of the two solutions 0 and 1 the range has the second only."""
    text = f"""
model M
  parameter Real a(min=0.1, max=3, fixed=false, start={start});
  Real x(start=1, fixed=true);
initial equation
  a*(a - 1) = 0;
equation
  der(x) = -a*x;
end M;
"""
    fmu, lines = made(tmp_path, text), []
    if start == 2:
        assert run(fmu, 1.0, 0.5, "x")["x"][-1] == pytest.approx(math.exp(-1), rel=1e-6)
        return
    with pytest.raises(Exception, match="failed with status 3"):
        run(fmu, 1.0, 0.5, "x", logger=lambda *one: lines.append(one[-1].decode()))
    assert any("initialisation finds a beyond its min" in one for one in lines)


IMPULSE = """
model M
  parameter Real T1=10e-6, T2=350e-6;
  parameter Real eta(fixed=false, start=1), T(fixed=false, start=T2*T1/(T2 - T1)*log(T2/T1));
  parameter Real T10(fixed=false, start=0.01*T2*T1/(T2 - T1)*log(T2/T1));
  parameter Real tau1(fixed=false, start=T2), tau2(fixed=false, start=T1);
initial equation
  exp(-T/tau1)/tau1 = exp(-T/tau2)/tau2;
  eta = exp(-T/tau1) - exp(-T/tau2);
  0.1*eta = exp(-T10/tau1) - exp(-T10/tau2);
  0.9*eta = exp(-(T10 + 0.8*T1)/tau1) - exp(-(T10 + 0.8*T1)/tau2);
  0.5*eta = exp(-(T10 - 0.1*T1 + T2)/tau1) - exp(-(T10 - 0.1*T1 + T2)/tau2);
end M;
"""


def test_start_equations_whose_units_differ_by_orders_of_magnitude(tmp_path):
    """The time constants of a 10/350 us impulse; with tau1 = tau2 the equations hold for any times."""

    def times(tau1, tau2):
        def y(t):
            return math.exp(-t / tau1) - math.exp(-t / tau2)

        peak = math.log(tau1 / tau2) / (1 / tau2 - 1 / tau1)
        first = brentq(lambda t: y(t) - 0.1 * y(peak), 0, peak)
        last = brentq(lambda t: y(t) - 0.9 * y(peak), 0, peak)
        half = brentq(lambda t: y(t) - 0.5 * y(peak), peak, 1)
        front = (last - first) / 0.8
        return front, half - (first - 0.1 * front)

    found = run(made(tmp_path, IMPULSE), 1.0, 1.0, "tau1", "tau2", "T")
    tau1, tau2 = found["tau1"][0], found["tau2"][0]
    assert times(tau1, tau2) == pytest.approx((10e-6, 350e-6), rel=1e-6)
    assert found["T"][0] == pytest.approx(math.log(tau1 / tau2) / (1 / tau2 - 1 / tau1), rel=1e-6)


@pytest.mark.parametrize(("equations", "determined"), (("a*(b - 3) = 0", False), ("a*b = 0", True)))
def test_a_start_that_the_equations_leave_open_is_no_start(tmp_path, equations, determined):
    """a*(b - 2) = 0 and a*(b - 3) = 0 hold for a = 0 and any b; a*b = 0 and a*a + b*b = 0 for a = b = 0."""
    first = "a*a + b*b = 0" if determined else "a*(b - 2) = 0"
    text = f"""
model M
  parameter Real a(fixed=false, start=1), b(fixed=false, start=1.5);
  Real x(start=1, fixed=true);
initial equation
  {first};
  {equations};
equation
  der(x) = -(1 + b)*x;
end M;
"""
    fmu, lines = made(tmp_path, text), []
    if determined:
        assert run(fmu, 1.0, 1.0, "x")["x"][-1] == pytest.approx(math.exp(-1), rel=1e-6)
        return
    with pytest.raises(fmpy.fmi1.FMICallException):
        run(fmu, 1.0, 1.0, "x", logger=lambda *one: lines.append(one[-1].decode()))
    assert any("the equations cannot be solved for" in one for one in lines)


def test_equations_that_divide_by_an_unknown_without_a_start_value(tmp_path):
    """x = 6/y and y = x + 1 start from 0: x = 2, y = 3."""
    text = """
model M
  Real x, y, z(start=1, fixed=true);
equation
  x = 6/y;
  y = x + 1;
  der(z) = -z;
end M;
"""
    found = run(made(tmp_path, text), 1.0, 1.0, "x", "y")
    assert found["x"][0] * (found["x"][0] + 1) == pytest.approx(6, rel=1e-9)
    assert found["y"][-1] == pytest.approx(found["x"][-1] + 1, rel=1e-9)
