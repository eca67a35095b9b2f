"""Equation blocks with unknowns of very different sizes, bad guesses, vanishing derivatives: exact values."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

pytest.importorskip("rumoca", reason="needs the extra build")

from tests.translate.hybrid.test_hybrid_models import made, run

EVENT = "Boolean late(start=false, fixed=true);\nequation\nwhen time > 0.33 then late = true; end when;\n"


def test_a_saturation_current_is_as_exact_as_the_voltage_that_drives_it(tmp_path):
    """A diode warms itself: 1e-15 A, which grows with its temperature, counts beside an exponential of 40."""
    fmu = made(tmp_path, f"""
model M
  function expl input Real x; output Real y;
  algorithm y := if x > 40 then exp(40)*(1 + x - 40) else exp(x); end expl;
  output Real v, i(start=0), T(start=300), s, h, e;
  {EVENT}
  s = 1e-15*(T/300)^3*e;
  e = exp(h);
  h = 43*(T/300 - 1);
  i = s*(expl(v/(8.6e-5*T)) - 1) + 1e-15*v;
  6*time - v = 1800*i;
  T = 300 + 100*i*v;
end M;
""")  # fmt: skip
    found = run(fmu, 1.0, 0.05, "v", "i", "T", "s")

    def current(v: float, T: float) -> tuple[float, float]:
        x = v / (8.6e-5 * T)
        s = 1e-15 * (T / 300) ** 3 * np.exp(43 * (T / 300 - 1))
        return s * ((np.exp(40) * (x - 39) if x > 40 else np.exp(x)) - 1) + 1e-15 * v, s

    for time, v, i, T, s in zip(*(found[one] for one in ("time", "v", "i", "T", "s")), strict=True):

        def off(v: float, time: float = time) -> float:
            i = (6 * time - v) / 1800
            return i - current(v, 300 + 100 * i * v)[0]

        exact = float(brentq(off, 0, 6 * time + 1e-9, xtol=1e-15))
        i_exact = (6 * time - exact) / 1800
        assert v == pytest.approx(exact, abs=1e-9)
        assert T == pytest.approx(300 + 100 * i_exact * exact, abs=1e-6)
        assert s == pytest.approx(current(exact, 300 + 100 * i_exact * exact)[1], rel=1e-7)


def test_a_guess_may_divide_by_the_difference_of_two_unknowns(tmp_path):
    """Supplies of 15 and -15 V about a node at u/2: all guesses are 0, and i = p/(plus - minus)."""
    fmu = made(tmp_path, f"""
model M
  output Real plus, minus, node, i, p;
  {EVENT}
  plus - node = 15;
  minus - node = -15;
  p = 2*node + i*node;
  i = p/(plus - minus);
  node = (3 + time - i)/2;
end M;
""")  # fmt: skip
    found = run(fmu, 1.0, 0.1, "i", "plus")
    for time, i, plus in zip(found["time"], found["i"], found["plus"], strict=True):
        # 30 i = (2 + i)(3 + t - i)/2: of i^2 + (59 - t) i - 6 - 2 t = 0 the small solution
        half = (59 - time) / 2
        exact = -half + np.sqrt(half**2 + 6 + 2 * time)
        assert i == pytest.approx(exact, abs=1e-10)
        assert plus == pytest.approx(15 + (3 + time - exact) / 2, abs=1e-10)


def test_a_capacitor_of_zero_is_no_state(tmp_path):
    """Also where the capacitance is a variable, as that of a junction."""
    fmu = made(tmp_path, f"""
model M
  parameter Real C = 0 annotation(Evaluate=true);
  final parameter Real junction = 3*C;
  Real x(start=1, fixed=true);
  output Real v(start=0), w, i, c;
  {EVENT}
  C*der(v) + c*der(w) = i;
  c = junction*(1 + w^2);
  i = 2*sin(time) - v - w;
  c*der(w) = x - w;
  der(x) = -x;
end M;
""")  # fmt: skip
    found = run(fmu, 2.0, 0.1, "v", "w")
    w = np.exp(-found["time"])
    assert found["w"] == pytest.approx(w, abs=1e-7)
    assert found["v"] == pytest.approx(2 * np.sin(found["time"]) - w, abs=1e-7)


def test_a_solution_that_ends_with_the_state_is_followed_by_another(tmp_path):
    """An amplifier with limits and positive feedback charges a capacitor either way, without events."""
    fmu = made(tmp_path, f"""
model M
  output Real x(start=0, fixed=true), y(start=1), u(start=1);
  {EVENT}
  u = 0.5*y - x;
  y = noEvent(if 15000*u > 1 then 1 else if 15000*u < -1 then -1 else 15000*u);
  der(x) = y - x;
end M;
""")  # fmt: skip
    found = run(fmu, 5.5, 0.37, "x", "y")
    border = 0.5 - 1 / 15000
    first, half = -np.log(1 - border), np.log((1 + border) / (1 - border))
    for time, x, y in zip(found["time"], found["x"], found["y"], strict=True):
        turns = max(0, int(np.floor((time - first) / half)) + 1)
        sign = 1 if turns % 2 == 0 else -1
        since = time - first - (turns - 1) * half if turns else time
        begin = -sign * border if turns else 0.0
        assert y == sign
        assert x == pytest.approx(sign + (begin - sign) * np.exp(-since), abs=1e-6)
