"""Iterators over other things than ranges of Integers; sizes of arrays of components, and what they get."""

from __future__ import annotations

import math

import pytest

pytest.importorskip("rumoca", reason="needs the extra build")

from orchestrator.base.errors import BuildError
from orchestrator.translate.build import build
from orchestrator.translate.rewriting.iterators import with_plain_iterators
from tests.translate.hybrid.test_hybrid_models import made, run

KIND = "type Kind = enumeration(one, two, three);"
FUNCTION = "function f input Real u[:]; input Integer n = 3; output Real y; algorithm y := 0;"
DECAY = "model Decay parameter Real k = 1; Real x(start=1, fixed=true); equation der(x) = -k*x; end Decay;"

# What is tried -> model, and values at time 1, which are worked out by hand.
MODELS = {
    "equations over values": (
        """model M
  Real x[5](each start=0, each fixed=true);
equation
  for i in {2, 4} loop
    der(x[i]) = i;
  end for;
  for i in {1, 3, 5} loop
    der(x[i]) = -i*x[2];
  end for;
end M;""",
        {"x[2]": 2, "x[4]": 4, "x[1]": -1, "x[5]": -5},
    ),
    "comprehensions over values": (
        """model M
  Real y[2] = {i^2*time for i in {2, 4}};
  Real s = sum(i for i in {2, 4, 7});
  Real t = max(i^2 for i in {-3, 2})*time;
  Real u = product(v for v in {0.5, 3*time});
  Real w[5] = {v^2*time for v in 0:0.25:1};
end M;""",
        {"y[1]": 4, "y[2]": 16, "s": 13, "t": 9, "u": 1.5, "w[4]": 0.5625},
    ),
    "comprehensions with two iterators": (
        """model M
  Real x[2, 3] = {(10*i + j)*time for j in 1:3, i in 1:2};
  Real y[2, 2] = {(10*i + j)*time for j in {1, 4}, i in 1:2};
  Real s = sum(i*j for i in {1, 3}, j in 1:2);
end M;""",
        {"x[1,3]": 13, "x[2,1]": 21, "y[2,1]": 21, "y[1,2]": 14, "s": 12},
    ),
    "elements of arrays": (
        """model M
  parameter Real w[3] = {1, 2, 4};
  Real z = sum(v^2*time for v in w);
  Real y[3] = {2*v for v in w};
  Real a;
algorithm
  a := 0;
  for v in w loop
    a := 2*a + v*time;
  end for;
end M;""",
        {"z": 21, "y[3]": 8, "a": 12},
    ),
    "equations over enumerations": (
        f"""model M
  {KIND}
  Real x[Kind](each start=0, each fixed=true);
  Real y[Kind];
  Real z[3] = {{if e == Kind.two then 2*time else Integer(e) for e in Kind}};
equation
  y[Kind.one] = 7;
  for e in Kind loop
    der(x[e]) = Integer(e);
  end for;
  for e in Kind.two:Kind.three loop
    y[e] = time;
  end for;
end M;""",
        {"x[3]": 3, "y[1]": 7, "y[3]": 1, "z[1]": 1, "z[2]": 2, "z[3]": 3},
    ),
    "statements over enumerations and Booleans": (
        f"""model M
  {KIND}
  Real s, t;
algorithm
  s := 0;
  for e in Kind loop
    s := 2*s + (if e == Kind.two then 10 else 1)*time;
  end for;
  t := 0;
  for b in Boolean loop
    t := 3*t + (if b then 10 else 1)*time;
  end for;
end M;""",
        {"s": 25, "t": 13},
    ),
    "the number of a variable of an enumeration": (
        f"""model M
  {KIND}
  Kind k = if time > 0.5 then Kind.three else Kind.one;
  Integer n = Integer(k);
  Real x(start=0, fixed=true);
equation
  der(x) = Integer(k);
end M;""",
        {"n": 3, "x": 2},
    ),
    "functions": (
        f"""model M
  {FUNCTION}
    for i in {{1, 3}} loop
      y := 2*y + u[i];
    end for;
    for v in u loop
      y := y + 10*v;
    end for;
    for i in n:-1:1 loop
      y := 2*y + i;
    end for;
    for v in 0:0.5:1 loop
      y := y + 1000*v;
    end for;
  end f;
  Real y = f({{1, 2, 3*time}});
end M;""",
        {"y": ((65 * 2 + 3) * 2 + 2) * 2 + 1 + 1500},
    ),
    "several iterators of a loop, one over values": (
        """model M
  Real x[2, 4];
equation
  for i in 1:2, j in {1, 3} loop
    x[i, j] = (10*i + j)*time;
    x[i, j + 1] = -x[i, j];
  end for;
end M;""",
        {"x[1,3]": 13, "x[2,1]": 21, "x[2,4]": -23},
    ),
    "ranges that follow from subscripts": (
        """model M
  Real x[3](each start=0, each fixed=true), y[3];
equation
  for i loop
    der(x[i]) = i;
  end for;
algorithm
  for i loop
    y[i] := 2*i*time;
  end for;
end M;""",
        {"x[3]": 3, "y[2]": 4},
    ),
    "no elements": (
        """model M
  parameter Integer n = 0;
  Real x[n];
  Real p = product({i for i in 1:n}) + sum(x) + time;
equation
  for i in 1:n loop
    x[i] = i;
  end for;
end M;""",
        {"p": 2},
    ),
    "texts put together": (
        """model M
  parameter String mode = "fast";
  parameter String other = mode + "er";
  Real x(start=1, fixed=true);
equation
  der(x) = if other == "faster" then -2*x else -x;
  assert(other <> "slow" + "er", "is " + other);
end M;""",
        {"x": math.exp(-2)},
    ),
    "ranges and arithmetic for arrays of components": (
        f"""package M
  {DECAY}
  model M
    parameter Integer n = 3;
    parameter Real v[n] = {{1, 2, 4}};
    Decay a[n](k=1:n), b[n](k=2*(1:n)), c[n](k=linspace(1, 2, n)), d[n](k=v/2 - ones(n), x(start=3*v));
    Decay g[3](k=3:-1:1), h[3](each k=v[3]);
    parameter Real w[2, 3] = [1, 2, 3; 4, 5, 6];
    Decay e[3](k=w[2, :]/2), f[3](k=2*a.k);
    Real s = sum(one.k for one in a);
  end M;
end M;""",
        {
            "a[3].x": math.exp(-3),
            "b[2].x": math.exp(-4),
            "c[2].x": math.exp(-1.5),
            "d[3].x": 12 * math.exp(-1),
            "g[1].x": math.exp(-3),
            "h[2].x": math.exp(-4),
            "e[3].x": math.exp(-3),
            "f[2].x": math.exp(-4),
            "s": 6,
        },
    ),
    "arrays of components within others": (
        f"""package M
  {DECAY}
  model Three
    Decay a[3];
  end Three;
  model Some
    parameter Integer n = 2;
    Decay a[n];
  end Some;
  model Both
    Three three;
  end Both;
  model M
    extends Some(n=3, a(k=2*(1:3)));
    parameter Real v[3] = {{1, 2, 3}};
    Three b(a(k=3:-1:1));
    Both c(three(a(final k=2*v, x(each start=5))));
  end M;
end M;""",
        {"a[3].x": math.exp(-6), "b.a[1].x": math.exp(-3), "c.three.a[2].x": 5 * math.exp(-4)},
    ),
    "matrices for arrays of components": (
        """package M
  model Sum
    parameter Real k[2] = {1, 1};
    Real x = (k[1] + 2*k[2])*time;
  end Sum;
  model M
    Sum a[2](k=[1, 2; 3, -4]), b[2](each k={8, 9});
  end M;
end M;""",
        {"a[1].x": 5, "a[2].x": -5, "b[2].x": 26},
    ),
    "members of parts of arrays, and records that functions set in part": (
        """package M
  model Part
    Real x = time;
  end Part;
  record Pair
    Real a = 4;
    Real b = 2;
  end Pair;
  function f
    input Real u;
    output Pair r;
  algorithm
    r.a := u;
  end f;
  model M
    Part a[4];
    Real s = sum(a[2:3].x);
    Pair r = f(3*time);
    Real y = r.a + 10*r.b;
  end M;
end M;""",
        {"s": 2, "y": 23},
    ),
    "sizes that other components give": (
        f"""package M
  {DECAY}
  model M
    parameter Integer n = 3;
    Decay a[n](k={{1, 2, 3}});
    Decay b[size(a, 1)](each k=2), c2[size(a, 1)](k=2*(1:size(a, 1)));
    Real last = a[end].x + sum(a[i].k for i in 1:size(a, 1) - 1);
    Real c[size(a, 1)] = {{i*time for i in 1:size(a, 1)}};
    Real s = sum(b.x) + sum(c);
  end M;
end M;""",
        {
            "a[3].x": math.exp(-3),
            "b[3].x": math.exp(-2),
            "s": 3 * math.exp(-2) + 6,
            "last": math.exp(-3) + 3,
            "c2[3].x": math.exp(-6),
        },
    ),
}


@pytest.mark.parametrize("what", MODELS)
def test_values_are_those_worked_out_by_hand(tmp_path, what):
    text, wanted = MODELS[what]
    fmu = made(tmp_path, text, model="M.M" if text.startswith("package") else None)
    found = run(fmu, 1.0, 0.1, *wanted)
    assert {name: found[name][-1] for name in wanted} == pytest.approx(wanted, rel=1e-5)


@pytest.mark.parametrize("value", ["1:4", "2*(1:4)", "linspace(1, 2, 4)", "3*v"])
def test_another_number_of_values_is_refused(tmp_path, value):
    (tmp_path / "M.mo").write_text(
        f"package M\n{DECAY}\nmodel M\nparameter Real v[4] = {{1, 2, 3, 4}};\n"
        f"Decay a[3](k={value});\nend M;\nend M;\n"
    )
    with pytest.raises(BuildError, match=r"unbalanced|unlike types|supplies 4"):
        build(tmp_path / "M.mo", tmp_path / "M.fmu", model="M.M", platforms=())


def test_lines_stay_where_they_are():
    text = """model M
  Real x[3], y;
equation
  for i in
      {1, 3} loop
    x[i] = f(i=i) "first";
    // of i
  end for;
  y = 2;
end M;
"""
    changed = with_plain_iterators({"M.mo": text})["M.mo"].split("\n")
    copies = 'x[1] = f(i=1) "first"; x [ 3 ] = f ( i = 3 ) "first" ;'
    assert [line.strip() for line in changed[5:9]] == [copies, "", "", "y = 2;"]


@pytest.mark.parametrize(
    "loop",
    [
        "for i in {1, 2} loop x := i; if x > 1 then break; end if; end for;",  # would leave one copy only
        "for v in w loop w[2] := v; end for;",  # runs over what w was
        "for i in 1:3, j in i:4 loop x := i*j; end for;",
    ],
)
def test_loops_that_would_mean_something_else_stay(loop):
    assert not with_plain_iterators({"M.mo": f"model M\nalgorithm\n  {loop}\nend M;\n"})
