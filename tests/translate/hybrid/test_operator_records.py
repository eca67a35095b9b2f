"""Records with operators, and complex numbers, against numpy's."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rumoca", reason="needs the extra build")

from orchestrator.base.errors import BuildError
from tests.translate.hybrid.test_hybrid_models import made, run

# A record as that of the Standard Library, in the words of this test.
NUMBERS = """
  operator record Complex "a number of two parts"
    replaceable Real re;
    replaceable Real im;
    encapsulated operator 'constructor'
      function fromReals
        import P.Complex;
        input Real re;
        input Real im = 0;
        output Complex z(re = re, im = im);
      algorithm
      end fromReals;
    end 'constructor';
    encapsulated operator '-'
      function one
        import P.Complex;
        input Complex a;
        output Complex c;
      algorithm
        c := Complex(-a.re, -a.im);
      end one;
      function two
        import P.Complex;
        input Complex a;
        input Complex b;
        output Complex c;
      algorithm
        c := Complex(a.re - b.re, a.im - b.im);
      end two;
    end '-';
    encapsulated operator function '0'
      import P.Complex;
      output Complex c;
    algorithm
      c := Complex(0);
    end '0';
    encapsulated operator function '+'
      import P.Complex;
      input Complex a;
      input Complex b;
      output Complex c;
    algorithm
      c := Complex(a.re + b.re, a.im + b.im);
    end '+';
    encapsulated operator function '*'
      import P.Complex;
      input Complex a;
      input Complex b;
      output Complex c;
    algorithm
      c := Complex(a.re*b.re - a.im*b.im, a.re*b.im + a.im*b.re);
    end '*';
    encapsulated operator function '/'
      import P.Complex;
      input Complex a;
      input Complex b;
      output Complex c;
    protected
      Real square = b.re^2 + b.im^2;
    algorithm
      c := Complex((a.re*b.re + a.im*b.im)/square, (a.im*b.re - a.re*b.im)/square);
    end '/';
    encapsulated operator function '=='
      import P.Complex;
      input Complex a;
      input Complex b;
      output Boolean same;
    algorithm
      same := a.re == b.re and a.im == b.im;
    end '==';
    encapsulated operator function 'String'
      import P.Complex;
      input Complex a;
      output String text;
    algorithm
      text := String(a.re) + " + j*" + String(a.im);
    end 'String';
  end Complex;
  final constant Complex j = Complex(0, 1);
  function conj
    input Complex c;
    output Complex r = Complex(c.re, -c.im);
  algorithm
  end conj;
  function exp
    input Complex c;
    output Complex r;
  algorithm
    r := Complex(.exp(c.re)*cos(c.im), .exp(c.re)*sin(c.im));
  end exp;
  function polynomial "1 + z + z^2/2 + z^3/3"
    input Complex z;
    output Complex sum;
  protected
    Complex power;
  algorithm
    sum := Complex(1);
    power := Complex(1);
    for k in 1:3 loop
      power := power*z;
      sum := sum + power/k;
    end for;
  end polynomial;
"""


def values(
    tmp_path: Path, declared: str, equations: str, *names: str, more: str = ""
) -> dict[str, np.ndarray]:
    """The complex variables of a model beside its time."""
    text = f"package P{NUMBERS}{more}\n  model M\n{declared}\n  equation\n{equations}\n  end M;\nend P;\n"
    parts = [f"{name}.{part}" for name in names for part in ("re", "im")]
    found = run(made(tmp_path, text, model="P.M"), 2.0, 0.25, *parts)
    return {"t": found["time"]} | {name: found[f"{name}.re"] + 1j * found[f"{name}.im"] for name in names}


def test_operators_convert_numbers_and_bind_as_they_should(tmp_path):
    found = values(
        tmp_path,
        """    Complex a, b, c, d, e, f(re(start = 1)), g = -a*b + 2, h = (a + b)*(a - b)/3;
    parameter Complex k = 2*exp(0.3*j) "evaluated before";
    parameter Real r = 3;""",
        """    a = Complex(time, 1);
    b = Complex(im = time^2, re = 2);
    c = a - b - r*k;
    d = k/a*conj(b) + 1;
    e = if time > 1 then a*b else -a;
    a + f*a = b "solved for f";
    """,
        *"abcdefgh",
    )
    t = found["t"]
    a, b, k = t + 1j, 2 + 1j * t**2, 2 * np.exp(0.3j)
    expected = {
        "a": a, "b": b, "c": a - b - 3 * k, "d": k / a * b.conj() + 1, "e": np.where(t > 1, a * b, -a),
        "f": (b - a) / a, "g": -a * b + 2, "h": (a + b) * (a - b) / 3,
    }  # fmt: skip
    for name, value in expected.items():
        assert np.abs(found[name] - value).max() < 1e-12, name


def test_connectors_with_flow_make_an_alternating_current_circuit(tmp_path):
    parts = """
  type Voltage = Real(unit = "V");
  operator record ComplexVoltage = Complex(redeclare Voltage re, redeclare Voltage im) "with a unit";
  connector Pin
    ComplexVoltage v;
    flow Complex i;
  end Pin;
  partial model TwoPins
    Pin p, n;
    ComplexVoltage v = p.v - n.v;
  equation
    p.i + n.i = Complex(0);
  end TwoPins;
  model Impedance
    extends TwoPins;
    parameter Complex Z = Complex(1);
  equation
    v = Z*p.i;
  end Impedance;
  model Source
    extends TwoPins;
    parameter Real w = 3;
  equation
    v = 10*exp(j*w*time);
  end Source;
  model Ground
    Pin p;
  equation
    p.v = Complex(0, 0);
  end Ground;
"""
    found = values(
        tmp_path,
        """    Source s(w = 2);
    Impedance a(Z = 3 + 4*j), b(Z = 1/(2*j)), c;
    Ground g;
    Complex power = -s.v*conj(s.p.i);""",
        """    connect(s.p, a.p);
    connect(a.n, b.p);
    connect(a.n, c.p);
    connect(b.n, s.n);
    connect(c.n, s.n);
    connect(s.n, g.p);""",
        "a.p.i", "c.v", "power",
        more=parts,
    )  # fmt: skip
    voltage = 10 * np.exp(2j * found["t"])
    parallel = 1 / (2j + 1)
    current = voltage / (3 + 4j + parallel)
    assert np.abs(found["a.p.i"] - current).max() < 1e-12
    assert np.abs(found["c.v"] - current * parallel).max() < 1e-12
    assert np.abs(found["power"] - voltage * current.conj()).max() < 1e-11


def test_arrays_are_taken_element_by_element(tmp_path):
    found = values(
        tmp_path,
        """    parameter Integer n = 3;
    Complex u[n], v[n], w[n] = {u[k]*u[k] for k in 1:n}, x[3], y[3], z[2] = {j, 2*j}, total, q[3];
    Real parts[3] = v.re;""",
        """    for k in 1:n loop
      u[k] = k*exp(j*time) + (if k > 1 then j else -j);
    end for;
    v = 2*u - w/j;
    x = if time > 1 then u else -v;
    y = conj(u + {j, j, 2*j});
    q = {k*j for k in 1:n} + u;
    total = sum(u)/2 - sum(q) + sum(parts);""",
        "u[2]", "v[3]", "w[1]", "x[2]", "y[3]", "z[2]", "q[3]", "total",
    )  # fmt: skip
    t = found["t"]
    u = [k * np.exp(1j * t) + (1j if k > 1 else -1j) for k in (1, 2, 3)]
    v = [2 * one - one**2 / 1j for one in u]
    expected = {
        "u[2]": u[1], "v[3]": v[2], "w[1]": u[0] ** 2, "x[2]": np.where(t > 1, u[1], -v[1]),
        "y[3]": np.conj(u[2] + 2j), "z[2]": 2j + 0 * t, "q[3]": 3j + u[2],
        "total": -sum(u) / 2 - 6j + sum(v).real,
    }  # fmt: skip
    for name, value in expected.items():
        assert np.abs(found[name] - value).max() < 1e-12, name


def test_functions_and_events_with_complex_numbers(tmp_path):
    found = values(
        tmp_path,
        """    Complex a = Complex(time, 0.5), b = polynomial(a), r, s(re(start = 1, fixed = true));
    parameter Complex k = Complex(1, 2);
    parameter Boolean same = k == 1 + 2*j;
    Complex chosen = if same then a else j;""",
        """    when time > 1 then
      r = a;
    end when;
  algorithm
    when time > 1 then
      s := a*a;
    end when;""",
        "b", "chosen", "r", "s",
    )  # fmt: skip
    t = found["t"]
    a = t + 0.5j
    assert np.abs(found["b"] - (1 + a + a**2 / 2 + a**3 / 3)).max() < 1e-12
    assert np.abs(found["chosen"] - a).max() == 0
    after = t > 1
    assert np.abs(found["s"] - np.where(after, (1 + 0.5j) ** 2, 1)).max() < 1e-9
    assert np.abs(found["r"] - np.where(after, 1 + 0.5j, 0)).max() < 1e-9


def test_the_constructor_of_the_record_is_taken_wherever_it_stands(tmp_path):
    """That of polar coordinates has as many arguments as the record has members."""
    text = """package P
  operator record Polar
    Real x;
    Real y;
    encapsulated operator function 'constructor'
      import P.Polar;
      input Real radius;
      input Real angle;
      output Polar z(x = radius*cos(angle), y = radius*sin(angle));
    algorithm
    end 'constructor';
  end Polar;
  model Part
    parameter Polar z = Polar(1, 0);
    Real a = z.y*time;
  end Part;
  model Shorter = Part(z = Polar(1, 1));
  model Whole
    replaceable model Inner = Part;
    Inner i;
  end Whole;
  model Replaceable
    replaceable Part r constrainedby Part(z = Polar(2, 1.5));
  end Replaceable;
  model NotUsed
    Polar z = Polar(1)*Polar(2);
  end NotUsed;
  model M
    Shorter s;
    Whole w(redeclare model Inner = Part(z = Polar(1, 2)));
    Replaceable e;
    Polar p;
  equation
    der(p) = Polar(time, 1);
  initial equation
    p = Polar(2, 0.5);
  end M;
end P;
"""
    found = run(made(tmp_path, text, model="P.M"), 1.0, 0.25, "s.a", "w.i.a", "e.r.a", "p.x", "p.y")
    t = found["time"]
    for name, factor in (("s.a", np.sin(1)), ("w.i.a", np.sin(2)), ("e.r.a", 2 * np.sin(1.5))):
        assert np.abs(found[name] - factor * t).max() < 1e-12, name
    assert np.abs(found["p.x"] - 2 * np.cos(0.5) - t**2 / 2 * np.cos(1)).max() < 1e-8
    assert np.abs(found["p.y"] - 2 * np.sin(0.5) - t**2 / 2 * np.sin(1)).max() < 1e-8


REFUSED = {
    "unknown.Type y; Complex a = j*y;": r"\d+:\d+: `\*` with `y`, whose type is not found, .* declare",
    "Complex a = j^2;": r"\d:\d+: `\^` of P.Complex and Integer, for which no operator .* an operator '\^'",
    'Complex a = j + "i";': r"`\+` of P.Complex and String, for which no operator of P.Complex could stand",
    "Complex a = Complex(1, 2, 3);": r"P.Complex\(\) with 3 arguments of these types is not supported; give",
    "Complex z[2, 1] = [Complex(1); j];": r"P.Complex\(\) in this expression is not supported; give its",
    "Complex z[2] = {j, j}, a = z*z;": r"`\*` of these arrays is not supported; write it for their elements",
    "Complex z[2] = {j, j}, a = product(z);": r"`product` of P.Complex is not supported; write it",
    "Complex a; equation when time > 1 then a = j*j; end when;": r"a when-equation of P.Complex .* algorithm",
}


@pytest.mark.parametrize("declared", REFUSED)
def test_what_has_no_meaning_or_is_not_known_is_refused(tmp_path, declared):
    text = f"package P{NUMBERS}\n  model M\n    {declared}\n  end M;\nend P;\n"
    with pytest.raises(BuildError) as caught:
        made(tmp_path, text, model="P.M")
    assert re.search(REFUSED[declared], str(caught.value)), str(caught.value)


def test_two_operators_that_fit_are_no_choice(tmp_path):
    """Both records could be made of the number that stands beside the other one."""
    texts = [
        f"""  operator record {name}
    Real x;
    encapsulated operator function 'constructor'
      import P.{name};
      import P.{other};
      input P.{other} o;
      output {name} r;
    algorithm
      r.x := o.x;
    end 'constructor';
    encapsulated operator function '+'
      import P.{name};
      input {name} a;
      input {name} b;
      output {name} c;
    algorithm
      c.x := a.x + b.x;
    end '+';
  end {name};
"""
        for name, other in (("A", "B"), ("B", "A"))
    ]
    model = "  model M\n    A a, c;\n    B b;\n  equation\n    a.x = 1;\n    b.x = 2;\n    c = a + b;\n"
    model += "  end M;"
    with pytest.raises(BuildError, match=r"`\+` of P.A and P.B, for which several operators .* a function"):
        made(tmp_path, f"package P\n{''.join(texts)}{model}\nend P;\n", model="P.M")
