"""Algorithm sections with arrays, loops and events, against what their statements come to by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

pytest.importorskip("rumoca", reason="needs the extra build")

from orchestrator.base.errors import BuildError
from orchestrator.translate.show import show_model
from tests.translate.hybrid.test_hybrid_models import made, run


def test_loops_over_arrays(tmp_path):
    fmu = made(tmp_path, """
model M
  parameter Integer n = 3;
  Real x[n](start={1, 2, 3}, each fixed=true);
  Real y[n], A[n, n];
  output Real s, largest;
  output Integer place;
algorithm
  s := 0;
  for i in 1:n loop
    y[i] := 2*x[i];
    s := s + y[i]*y[i];
    for j in 1:i loop
      A[i, j] := y[i] - x[j];
      A[j, i] := -A[i, j];
    end for;
  end for;
  y[2] := y[2] + 1;
  A[:, 1] := A[:, 1] + y;
  largest := -1;
  place := 0;
  for i in 1:size(x, 1) loop
    if x[i] > largest then
      largest := x[i];
      place := i;
    end if;
  end for;
equation
  for i in 1:n loop
    der(x[i]) = -i*x[i];
  end for;
end M;
""")  # fmt: skip
    names = [f"x[{i}]" for i in (1, 2, 3)]
    cells = [f"A[{i},{j}]" for i in (1, 2, 3) for j in (1, 2, 3)]
    found = run(fmu, 1.0, 0.1, *names, "s", "y[2]", "largest", "place", *cells)
    time = found["time"]
    x = np.array([1, 2, 3])[:, None] * np.exp(-np.outer([1, 2, 3], time))
    y = 2 * x
    assert found["s"] == pytest.approx((y**2).sum(0), rel=1e-7)
    y[1] += 1
    assert found["y[2]"] == pytest.approx(y[1], rel=1e-7)
    assert found["largest"] == pytest.approx(x.max(0), rel=1e-7)
    steady = np.abs(np.diff(np.sort(x, 0), axis=0)).min(0) > 1e-6
    assert (found["place"] == x.argmax(0) + 1)[steady].all()
    a = np.zeros((3, 3, len(time)))
    for i in range(3):
        for j in range(i + 1):
            a[i, j] = 2 * x[i] - x[j]
            a[j, i] = -a[i, j]
    a[:, 0] += y
    assert np.array([found[one] for one in cells]) == pytest.approx(a.reshape(9, -1), abs=1e-7)


@pytest.mark.parametrize("word", ["pre(buffer[i - 1])", "buffer[i - 1]"])
def test_a_shift_register_holds_the_last_samples(tmp_path, word):
    fmu = made(tmp_path, f"""
model M
  discrete Real buffer[4](each start=0, each fixed=true);
  discrete output Real mean(start=0, fixed=true);
algorithm
  when sample(0, 0.125) then
    for i in 4:-1:2 loop
      buffer[i] := {word};
    end for;
    buffer[1] := time^2;
    mean := sum(buffer)/4;
  end when;
end M;
""")  # fmt: skip
    found = run(fmu, 1.0, 0.0625, "mean")
    ticks = np.floor(found["time"] / 0.125) * 0.125
    expected = sum(np.clip(ticks - 0.125 * k, 0, None) ** 2 for k in range(4)) / 4
    assert found["mean"] == pytest.approx(expected, abs=1e-14)


def test_a_loop_of_unknown_length_is_a_function(tmp_path):
    fmu = made(tmp_path, """
model M
  output Real root, u;
  Integer turns;
algorithm
  u := 2 + time;
  root := u;
  turns := 0;
  while abs(root*root - u) > 1e-12*u loop
    root := 0.5*(root + u/root);
    turns := turns + 1;
    if turns > 50 then
      break;
    end if;
  end while;
end M;
""")  # fmt: skip
    found = run(fmu, 2.0, 0.25, "root", "turns")
    assert found["root"] == pytest.approx(np.sqrt(2 + found["time"]), rel=1e-12)
    assert set(found["turns"]) <= {4.0, 5.0}


def test_relations_within_loops_are_events(tmp_path):
    """The count changes exactly when the sine passes each level."""
    fmu = made(tmp_path, """
model M
  parameter Real levels[3] = {0.2, 0.5, 0.9};
  Integer above;
  Real area(start=0, fixed=true);
algorithm
  above := 0;
  for i in 1:3 loop
    if sin(time) > levels[i] then
      above := above + 1;
    end if;
  end for;
equation
  der(area) = above;
end M;
""")  # fmt: skip
    found = run(fmu, 3.0, 0.5, "area")
    passed = [math.asin(one) for one in (0.2, 0.5, 0.9)]
    expected = [sum(min(max(t - p, 0), math.pi - 2 * p) for p in passed) for t in found["time"]]
    assert found["area"] == pytest.approx(expected, abs=1e-9)


def test_components_with_sections_enumerations_functions_and_reinit(tmp_path):
    fmu = made(tmp_path, """
package P
  type Mode = enumeration(low, high);
  function scaled
    input Real v[:];
    input Real k = 2;
    output Real w[size(v, 1)];
  algorithm
    for i in 1:size(v, 1) loop
      w[i] := k*v[i];
    end for;
  end scaled;
  model Part
    parameter Real rate = 1;
    Real x(start=0, fixed=true);
    Mode mode(start=Mode.low, fixed=true);
    Integer count(start=0, fixed=true);
    Real w[2];
  equation
    der(x) = rate;
  algorithm
    when x > 1 then
      count := count + 1;
      for i in 1:2 loop
        count := count + i;
      end for;
      mode := if count > 7 then Mode.high else Mode.low;
      reinit(x, 0);
    end when;
    w := scaled({x, 1}, k=3);
    if mode == Mode.high then
      w[2] := -w[2];
    end if;
  end Part;
  model M
    Part part[2](rate={1, 2});
    output Real sum;
  algorithm
    sum := 0;
    for i in 1:2 loop
      sum := sum + part[i].x;
    end for;
  end M;
end P;
""", model="P.M")  # fmt: skip
    names = ["part[1].count", "part[2].count", "part[2].mode", "part[2].w[1]", "part[2].w[2]", "sum"]
    found = run(fmu, 2.2, 0.1, *names)
    time = found["time"]
    off = (np.abs(time % 0.5) > 1e-6) & (np.abs(time % 0.5 - 0.5) > 1e-6)
    assert (found["part[1].count"] == 4 * np.floor(time))[off].all()
    assert (found["part[2].count"] == 4 * np.floor(2 * time))[off].all()
    high = found["part[2].count"] > 7
    assert (found["part[2].mode"] == 1 + high).all()
    assert found["part[2].w[1]"][off] == pytest.approx((3 * ((2 * time) % 1))[off], abs=1e-9)
    assert (found["part[2].w[2]"] == np.where(high, -3, 3)).all()
    assert found["sum"][off] == pytest.approx((time % 1 + (2 * time) % 1)[off], abs=1e-9)


def test_an_initial_algorithm_with_a_loop(tmp_path):
    fmu = made(tmp_path, """
model M
  parameter Real c[3](each fixed=false);
  Real x(start=5);
initial algorithm
  c[1] := 1;
  for i in 2:3 loop
    c[i] := c[i - 1]*i;
  end for;
  x := sum(c);
equation
  der(x) = -c[3]*x;
end M;
""")  # fmt: skip
    found = run(fmu, 0.5, 0.125, "x")
    assert found["x"] == pytest.approx(9 * np.exp(-6 * found["time"]), rel=1e-6)


def test_what_ends_and_asserts_within_algorithms(tmp_path):
    fmu = made(tmp_path, """
model M
  Real x[2](each start=1, each fixed=true);
equation
  der(x) = {-1, 1};
algorithm
  for i in 1:2 loop
    assert(x[i] < 1.5, "too large");
  end for;
end M;
""")  # fmt: skip
    with pytest.raises(Exception, match="DoStep"):
        run(fmu, 1.0, 0.1, "x[1]")
    assert run(fmu, 0.4, 0.1, "x[1]")["x[1]"][-1] == pytest.approx(0.6)


def test_what_a_section_cannot_hold_is_refused_at_its_line(tmp_path):
    with pytest.raises(BuildError, match=r"M\.mo:\d+.*a loop of unknown length that assigns a.x"):
        made(tmp_path, """
model M
  record A
    Real x;
  end A;
  A a;
algorithm
  a.x := time;
  while a.x > 0.1 loop
    a.x := a.x/2;
  end while;
end M;
""")  # fmt: skip


def test_terminal_never_holds_and_the_build_says_so(tmp_path):
    from orchestrator.translate.build import build
    from orchestrator.translate.package import this_platform

    source = tmp_path / "M.mo"
    source.write_text("""
model M
  Real x(start=1, fixed=true);
  Real last(start=0, fixed=true);
equation
  der(x) = -x;
  when terminal() then
    last = x;
  end when;
end M;
""")
    report = build(source, tmp_path / "M.fmu", platforms=(this_platform(),))
    assert any("terminal()" in one for one in report.notes)
    assert run(tmp_path / "M.fmu", 1.0, 0.5, "x", "last")["last"].tolist() == [0, 0, 0]


def test_the_check_of_a_model_takes_what_the_build_takes(tmp_path):
    from orchestrator.translate.check import check_model

    source = tmp_path / "M.mo"
    text = "model M\n  Real y[2];\nalgorithm\n  for i in 1:2 loop\n    y[i] := i*time;\n  end for;\nend M;\n"
    source.write_text(text)
    assert not check_model(source).findings
    source.write_text(text.replace("Real y[2];", "Real y[2], z;"))
    assert "z" in check_model(source).findings[0].fault.what


def test_when_within_for_sets_and_reinits_elements(tmp_path):
    """Three balls from 1, 2 and 3 m; each notes when it hits the ground first, and how often it has."""
    text = """
model M
  parameter Integer n = 3;
  Real h[n](start={1, 2, 3}, each fixed=true), v[n](each start=0, each fixed=true);
  discrete Real first[n](each start=0, each fixed=true);
  Integer hits[n](each start=0, each fixed=true);
equation
  for i in 1:n loop
    der(h[i]) = v[i];
    when h[i] <= 0 then
      reinit(v[i], -0.8*pre(v[i])); // bounces
      first[i] = if hits[i] == 1 then time else pre(first[i]);
      hits[i] = pre(hits[i]) + 1;
    end when;
    der(v[i]) = -9.81;
  end for;
end M;
"""
    heights, firsts = [f"h[{k}]" for k in (1, 2, 3)], [f"first[{k}]" for k in (1, 2, 3)]
    found = run(made(tmp_path, text), 1.0, 1.0, *heights, *firsts, "hits[1]")
    for k in range(3):
        fall = math.sqrt(2 * (k + 1) / 9.81)
        after = 1 - fall
        assert found[firsts[k]][-1] == pytest.approx(fall, rel=1e-9)
        expected = 0.8 * 9.81 * fall * after - 9.81 * after**2 / 2
        assert found[heights[k]][-1] == pytest.approx(expected, rel=1e-7)
    assert found["hits[1]"][-1] == 1


def test_show_flat_holds_the_sections_that_the_compiler_does_not_see(tmp_path):
    """Its text is a model again, with the same solution."""
    source = tmp_path / "Whole.mo"
    source.write_text("""model Whole
  model Part
    parameter Integer n = 3;
    Real x(start=1, fixed=true), s, a[n];
  algorithm
    s := 0;
    for i in 1:n loop
      a[i] := i*x;
      if a[i] > s then
        s := a[i];
      end if;
    end for;
  equation
    der(x) = -s;
  end Part;
  Part p, q(x(start=2));
end Whole;
""")
    text = show_model(source, "flat", model="Whole")
    assert "'q.a'[i] := i*'q.x';" in text
    found = run(made(tmp_path, text, model="Whole"), 1.0, 0.5, "'p.x'", "'q.a'[3]")
    assert found["'p.x'"] == pytest.approx(np.exp(-3 * found["time"]), rel=1e-6)
    assert found["'q.a'[3]"] == pytest.approx(6 * np.exp(-3 * found["time"]), rel=1e-6)


def test_quoted_members_of_an_enumeration_that_a_file_imports_under_another_name(tmp_path):
    fmu = made(tmp_path, """
package P
  package Digital
    type Logic = enumeration('U' "not set", 'X', '0', '1');
  end Digital;
  model Part
    import L = P.Digital.Logic;
    parameter Integer n = 3;
    input Real u;
    output L bits[n](each start=L.'X', each fixed=true);
    Integer z(start=0, fixed=true);
  algorithm
    when sample(0.5, 1) then
      z := integer(u);
      for i in 1:n loop
        bits[i] := if mod(z, 2) > 0 then L.'1' else L.'0';
        z := div(z, 2);
      end for;
    end when;
  end Part;
  model M
    Part part(u=3 + 2*time);
  end M;
end P;
""", model="P.M")  # fmt: skip
    found = run(fmu, 3.0, 0.25, "part.bits[1]", "part.bits[3]")
    for time, first, last in zip(*found.values(), strict=True):
        if time % 1 == 0.5:
            continue
        # 4 is 100, 6 is 110 and 8 is 000 in three bits; 0 and 1 are members 3 and 4, X is 2
        ticks = int(np.floor(time + 0.5))
        assert (first, last) == [(2, 2), (3, 4), (3, 4), (3, 3)][ticks]
