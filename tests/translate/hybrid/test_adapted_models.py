"""FMUs of models that the compiler takes after a rewrite, against exact solutions and scipy."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import Akima1DInterpolator, RegularGridInterpolator

pytest.importorskip("rumoca", reason="needs the extra build")

from orchestrator.base.errors import BuildError
from orchestrator.translate.build import build
from orchestrator.translate.hybrid.tables import read_table
from orchestrator.translate.package import this_platform
from orchestrator.translate.rewriting.adapted import adapted
from orchestrator.translate.rewriting.external_objects import external_objects
from tests.translate.hybrid.test_hybrid_models import bounced, made, run


def test_functions_with_while_break_and_return(tmp_path):
    fmu = made(tmp_path, """
model M
  function root "Newton's method"
    input Real a;
    input Integer n = 2;
    output Real x;
    output Integer turns;
  protected
    Real before;
  algorithm
    x := a;
    turns := 0;
    while true loop
      before := x;
      x := x - (x^n - a)/(n*x^(n - 1));
      turns := turns + 1;
      if abs(x - before) <= 1e-15*abs(x) then
        break;
      end if;
    end while;
  end root;
  function first
    input Real v[:];
    input Real least;
    output Integer place;
  algorithm
    place := 0;
    for i in 1:size(v, 1) loop
      if v[i] >= least then
        place := i;
        return;
      end if;
    end for;
  end first;
  function factorial
    input Integer n;
    output Real y;
  algorithm
    if n < 2 then
      y := 1;
      return;
    end if;
    y := n*factorial(n - 1);
  end factorial;
  function running "Partial sums"
    input Real v[:];
    output Real s[size(v, 1)];
  protected
    Integer k = 1;
  algorithm
    s := v;
    while k < size(v, 1) loop
      k := k + 1;
      s[k] := s[k - 1] + v[k];
    end while;
  end running;
  parameter Real big = 5;
  Real x(start=1, fixed=true);
  Real y;
  Real z;
  Integer n;
  Integer k;
  Real f;
  Real s[3];
equation
  der(x) = 1;
  (y, n) = root(x, 3);
  z^3 + root(z + x) = 20;
  k = first({0, time, 2*time + 0.1}, 1);
  f = factorial(integer(big));
  s = running({x, x^2, 1});
end M;
""")  # fmt: skip
    found = run(fmu, 2.0, 0.25, "x", "y", "z", "k", "f", "s[1]", "s[2]", "s[3]", start_values={"big": 6.0})
    time, x = found["time"], found["time"] + 1
    assert found["y"] == pytest.approx(np.cbrt(x), abs=1e-14)
    assert found["z"] ** 3 + np.sqrt(found["z"] + x) == pytest.approx(20, abs=1e-9)
    assert (found["k"] == np.where(2 * time + 0.1 < 1, 0, np.where(time < 1, 3, 2))).all()
    assert (found["f"] == 720).all()
    assert found["s[2]"] == pytest.approx(x + x**2) and found["s[3]"] == pytest.approx(x + x**2 + 1)


def test_an_assertion_in_a_function_ends_the_run(tmp_path):
    fmu = made(tmp_path, """
model M
  function f
    input Real u;
    output Real y;
  algorithm
    assert(u < 0.5, "u is too large");
    y := u;
    while y > 1 loop
      y := y/2;
    end while;
  end f;
  Real x(start=0, fixed=true);
equation
  der(x) = 1 + 1e-9*f(x);
end M;
""")  # fmt: skip
    with pytest.raises(Exception, match="fmi2DoStep failed"):
        run(fmu, 1.0, 0.1, "x")


def test_derivatives_of_expressions_add_no_state(tmp_path):
    """A tank whose contents are written as m = rho*A*h; the second derivative is that of a difference."""
    fmu = made(tmp_path, """
model M
  parameter Real area = 2;
  Real h(start=3);
  Real a(start=1, fixed=true);
  Real b(start=0, fixed=true);
  Real d;
equation
  der(area*h^2) = -2*h;
  der(a) = -b;
  der(b) = a;
  d = der(a - b*sin(time));
end M;
""")  # fmt: skip
    found = run(fmu, 1.0, 0.05, "h", "d")
    time = found["time"]
    assert found["h"] == pytest.approx(3 - time / 2, abs=1e-9)
    exact = -np.sin(time) - (np.cos(time) * np.sin(time) + np.sin(time) * np.cos(time))
    assert found["d"] == pytest.approx(exact, abs=1e-8)


def test_the_derivative_of_an_expression_of_an_input_is_refused(tmp_path):
    with pytest.raises(BuildError, match="the input u would have to be differentiated"):
        made(tmp_path, "model M\ninput Real u;\nReal y;\nequation\ny = der(2*u);\nend M;\n")


def test_a_component_is_redeclared_by_one_of_equal_parts(tmp_path):
    """The two classes have no common ancestor; Modelica compares their parts only."""
    source = tmp_path / "P.mo"
    source.write_text("""
package P
  partial model Source
    output Real y;
  end Source;
  model Ramp
    parameter Real k = 1;
    output Real y;
  equation
    y = k*time;
  end Ramp;
  partial model System
    replaceable Source source;
    Real x(start=0, fixed=true);
  equation
    der(x) = source.y;
  end System;
  model M
    extends System(redeclare Ramp source(k=3));
  end M;
end P;
""")
    fmu = tmp_path / "M.fmu"
    build(source, fmu, model="P.M", platforms=(this_platform(),))
    found = run(fmu, 1.0, 0.1, "x")
    assert found["x"] == pytest.approx(1.5 * found["time"] ** 2, abs=1e-9)


# The external functions of the Modelica Standard Library, as a library of another name declares them.
TABLES = """
  type Smoothness = enumeration(Linear, Akima, Constant, FritschButland, Steffen, ModifiedAkima);
  type Extrapolation = enumeration(Hold, LastTwoPoints, Periodic, None);
  type TimeEvents = enumeration(Always, AtDiscontinuities, None);
  class Table1D
    extends ExternalObject;
    function constructor
      input String tableName;
      input String fileName;
      input Real table[:, :];
      input Integer columns[:];
      input M.Smoothness smoothness;
      input M.Extrapolation extrapolation;
      output Table1D id;
      external "C" id = ModelicaStandardTables_CombiTable1D_init3(fileName, tableName, table, columns);
    end constructor;
    function destructor
      input Table1D id;
      external "C" ModelicaStandardTables_CombiTable1D_close(id);
    end destructor;
  end Table1D;
  class Table2D
    extends ExternalObject;
    function constructor
      input Real table[:, :];
      input M.Smoothness smoothness;
      input M.Extrapolation extrapolation;
      output Table2D id;
      external "C" id = ModelicaStandardTables_CombiTable2D_init3(table);
    end constructor;
    function destructor
      input Table2D id;
      external "C" ModelicaStandardTables_CombiTable2D_close(id);
    end destructor;
  end Table2D;
  class TimeTable
    extends ExternalObject;
    function constructor
      input Real table[:, :];
      input Real startTime;
      input Integer columns[:];
      input M.Smoothness smoothness;
      input M.Extrapolation extrapolation;
      input Real shiftTime;
      input M.TimeEvents timeEvents;
      output TimeTable id;
      external "C" id = ModelicaStandardTables_CombiTimeTable_init3(table);
    end constructor;
    function destructor
      input TimeTable id;
      external "C" ModelicaStandardTables_CombiTimeTable_close(id);
    end destructor;
  end TimeTable;
  pure function value
    input Table1D id;
    input Integer column;
    input Real u;
    output Real y;
    external "C" y = ModelicaStandardTables_CombiTable1D_getValue(id, column, u);
  end value;
  pure function surface
    input Table2D id;
    input Real a;
    input Real b;
    output Real y;
    external "C" y = ModelicaStandardTables_CombiTable2D_getValue(id, a, b);
  end surface;
  pure function timed
    input TimeTable id;
    input Integer column;
    input Real t;
    input Real event;
    input Real before;
    output Real y;
    external "C" y = ModelicaStandardTables_CombiTimeTable_getValue(id, column, t, event, before);
  end timed;
  pure function nextEvent
    input TimeTable id;
    input Real t;
    output Real event;
    external "C" event = ModelicaStandardTables_CombiTimeTable_nextTimeEvent(id, t);
  end nextEvent;
"""
POINTS = np.array([[0, 0, 5], [0.5, 1, 4], [1, 4, 4], [1.5, 3, 1], [2.5, 3, 0], [3, -1, 2]])
MATRIX = "[" + "; ".join(", ".join(map(str, row)) for row in POINTS) + "]"


@pytest.mark.parametrize(
    ("smoothness", "expected"),
    [
        ("Linear", lambda x, y: lambda u: np.interp(u, x, y)),
        ("Constant", lambda x, y: lambda u: y[np.searchsorted(x, u, side="right") - 1]),
        ("Akima", lambda x, y: Akima1DInterpolator(x, y)),
        ("ModifiedAkima", lambda x, y: Akima1DInterpolator(x, y, method="makima")),
    ],
)
def test_a_table_interpolates(tmp_path, smoothness, expected):
    fmu = made(tmp_path, f"""
model M
{TABLES}
  parameter Real k = 1;
  final parameter Table1D id = Table1D("none", "none", {MATRIX}, {{3, 2}}, Smoothness.{smoothness},
    Extrapolation.Hold);
  Real y;
  Real z;
  Real w;
equation
  y = value(id, 2, time);
  z = value(id, 1, k*time);
  w = value(id, 1, 5 + time) + 10*value(id, 1, -time - 0.01);
end M;
""")  # fmt: skip
    found = run(fmu, 2.99, 0.0997, "y", "z", "w")
    x, first, second = POINTS.T
    if smoothness == "Akima":  # the end slopes of the library differ where two slopes are equal
        first = first.copy()
    assert found["y"] == pytest.approx(expected(x, first)(found["time"]), abs=1e-12)
    assert found["z"] == pytest.approx(expected(x, second)(found["time"]), abs=1e-12)
    assert found["w"] == pytest.approx(2 + 50)


def test_a_table_of_two_variables_interpolates(tmp_path):
    a, b = np.array([0.0, 1.0, 3.0]), np.array([-1.0, 0.0, 2.0, 5.0])
    z = np.array([[1.0, 2, 4, 3], [0, 5, 1, 2], [7, 1, 1, 8]])
    rows = [[0, *b], *([x, *row] for x, row in zip(a, z, strict=True))]
    matrix = "[" + "; ".join(", ".join(map(str, row)) for row in rows) + "]"
    fmu = made(tmp_path, f"""
model M
{TABLES}
  final parameter Table2D id = Table2D({matrix}, Smoothness.Linear, Extrapolation.LastTwoPoints);
  Real x(start=0, fixed=true);
  Real y;
  Real d;
equation
  der(x) = 1;
  y = surface(id, x, 2*x - 1);
  d = der(y);
end M;
""")  # fmt: skip
    found = run(fmu, 3.4, 0.0999, "y", "d")
    time = found["time"]
    expected = RegularGridInterpolator((a, b), z, bounds_error=False, fill_value=None)
    assert found["y"] == pytest.approx(expected(np.column_stack([time, 2 * time - 1])), abs=1e-6)
    at = [expected(np.column_stack([one, 2 * one - 1])) for one in (time, time + 1e-6)]
    rise = at[1] - at[0]
    assert found["d"] == pytest.approx(rise / 1e-6, abs=1e-4)


@pytest.mark.parametrize("extrapolation", ["LastTwoPoints", "Periodic"])
def test_a_time_table_jumps_when_it_must(tmp_path, extrapolation):
    """Its integral tells the instants of the jumps; it begins at 0.25 s and is shifted by 0.25 s."""
    fmu = made(tmp_path, f"""
model M
{TABLES}
  parameter TimeTable id = TimeTable([0, 0; 0.5, 1; 0.5, 3; 1, 3; 1, 0; 1.2, 0.4], 0.25, {{2}},
    Smoothness.Linear, Extrapolation.{extrapolation}, 0.25, TimeEvents.AtDiscontinuities);
  discrete Real event(start=0, fixed=true);
  Real y;
  Real integral(start=0, fixed=true);
equation
  when {{time >= pre(event), initial()}} then
    event = nextEvent(id, time);
  end when;
  y = timed(id, 1, time, event, pre(event));
  der(integral) = y;
end M;
""")  # fmt: skip
    found = run(fmu, 3.0, 0.0501, "y", "integral")

    def rate(u: float) -> float:
        if u < 0:
            return 0
        if extrapolation == "Periodic":
            u = u % 1.2
        return 2 * u if u < 0.5 else 3 if u < 1 else 2 * (u - 1)

    for time, value, total in zip(found["time"], found["y"], found["integral"], strict=True):
        assert value == pytest.approx(rate(time - 0.25), abs=1e-9)
        edges = [k * 1.2 + at + 0.25 for k in range(3) for at in (0, 0.5, 1)]
        begin = [0.0, *(one for one in edges if one < time), time]
        # Linear between the edges.
        exact = sum((b - a) * rate((a + b) / 2 - 0.25) for a, b in pairwise(begin))
        assert total == pytest.approx(exact, abs=1e-8)


def test_tables_are_read_from_files(tmp_path):
    (tmp_path / "a.txt").write_text(
        "#1\n# a comment\ndouble one(2,2)\n0 1\n2 3\nfloat two(2, 3)\n1 2 3 # end\n4,5,6\n"
    )
    assert (read_table(tmp_path / "a.txt", "two") == [[1, 2, 3], [4, 5, 6]]).all()
    (tmp_path / "b.csv").write_text("time,value\n0,1\n1,2.5\n")
    assert (read_table(tmp_path / "b.csv", "any") == [[0, 1], [1, 2.5]]).all()
    with pytest.raises(BuildError, match="no table three"):
        read_table(tmp_path / "a.txt", "three")


def test_a_table_comes_from_a_file_beside_the_model(tmp_path):
    (tmp_path / "t.txt").write_text("#1\ndouble tab(3,2)\n0 1\n1 3\n2 2\n")
    fmu = made(tmp_path, f"""
model M
{TABLES}
  parameter Boolean tableOnFile = true;
  parameter String tableName = "tab";
  parameter String fileName = "t.txt";
  final parameter Table1D id = Table1D(tableName, fileName, fill(0.0, 0, 2), {{2}}, Smoothness.Linear,
    Extrapolation.LastTwoPoints);
  Real y;
equation
  y = value(id, 1, time);
end M;
""")  # fmt: skip
    found = run(fmu, 3.0, 0.1, "y")
    time = found["time"]
    assert found["y"] == pytest.approx(np.where(time < 1, 1 + 2 * time, 4 - time), abs=1e-12)


def test_a_brake_sticks_and_slides(tmp_path):
    """Coulomb friction as a state machine, in the manner of the Modelica Standard Library; force sin(t)."""
    fmu = made(tmp_path, """
model M
  Real v(start=0, fixed=true);
  Real a;
  Real sa;
  Real f;
  Boolean startForward(start=false, fixed=true);
  Boolean startBackward(start=false, fixed=true);
  Boolean locked(start=false);
  Integer mode(start=3, fixed=true);
  constant Real slide = 0.5;
  constant Real stick = 0.6;
equation
  der(v) = a;
  a = sin(time) - f;
  startForward = pre(mode) == 0 and (sa > stick or pre(startForward) and sa > slide) or initial() and v > 0;
  startBackward = pre(mode) == 0 and (sa < -stick or pre(startBackward) and sa < -slide)
    or initial() and v < 0;
  locked = not (pre(mode) == 1 or startForward or pre(mode) == -1 or startBackward);
  a = if locked then 0 else if startForward then sa - stick else if startBackward then sa + stick
    else if pre(mode) == 1 then sa - stick else sa + stick;
  f = if locked then sa else if startForward then slide else if startBackward then -slide
    else if pre(mode) == 1 then slide else -slide;
  mode = if (pre(mode) == 1 or startForward) and v > 0 then 1
    else if (pre(mode) == -1 or startBackward) and v < 0 then -1 else 0;
end M;
""")  # fmt: skip
    found = run(fmu, 6.0, 0.05, "v", "locked")
    begin = math.asin(0.6)
    slide = lambda t, z: [math.sin(t) - 0.5]  # noqa: E731
    stop = lambda t, z: z[0] + (t < begin + 0.01)  # noqa: E731
    stop.terminal = True
    ahead = solve_ivp(slide, (begin, 6), [0.0], events=stop, rtol=1e-12, atol=1e-13, dense_output=True)
    still = ahead.t[-1]
    moving = (found["time"] > begin) & (found["time"] < still)
    assert found["v"][moving] == pytest.approx(ahead.sol(found["time"][moving])[0], abs=1e-7)
    rest = (found["time"] < begin) | ((found["time"] > still) & (found["time"] < math.pi + begin))
    assert found["v"][rest] == pytest.approx(0, abs=1e-9)
    assert (found["locked"][rest & (found["time"] > 0)] == 1).all()


def test_rewrites_keep_the_lines_and_what_they_do_not_concern():
    text = "model A\n  Real x;\nequation\n  der(x) = 1;\nend A;\n"
    assert adapted(text, "A.mo") == text
    longer = "model A\n  Real x;\nequation\n  der(2*\n  x) = 1;\nend A;\n"
    assert adapted(longer, "A.mo").splitlines()[3].startswith("  der(")
    assert external_objects([TABLES])["Table2D"][0] == ("table", "Real", "[:, :]")


C_MODEL = """
model M
  {purity} function scaled
    input Real u;
    input Integer n;
    input Real v[:];
    output Real y;
    external "C" y = scaled_sum(u, n, v, size(v, 1)) annotation(Include="#include \\"{file}\\"");
  end scaled;
  Real x(start=0, fixed=true);
  Real y;
equation
  der(x) = 1;
  y = scaled(x, 3, {{1, x, 2}});
end M;
"""


def test_a_c_function_beside_the_model_is_compiled_into_the_fmu(tmp_path):
    (tmp_path / "scaled.c").write_text("""#include <stddef.h>
static double scaled_sum(double u, int n, const double *v, size_t size)
{
    double s = 0;
    for (size_t k = 0; k < size; k++) s += v[k];
    return u * n * s;
}
""")
    found = run(made(tmp_path, C_MODEL.format(purity="", file="scaled.c")), 2.0, 0.25, "x", "y")
    assert found["y"] == pytest.approx(3 * found["x"] * (3 + found["x"]), abs=1e-12)


@pytest.mark.parametrize(
    ("purity", "reported"), [("", "lost.c: no such file"), ("impure", "impure function")]
)
def test_a_c_function_without_source_or_with_memory_is_refused(tmp_path, purity, reported):
    with pytest.raises(BuildError) as caught:
        made(tmp_path, C_MODEL.format(purity=purity, file="lost.c"))
    assert reported in str(caught.value)


def test_what_is_imported_from_within_a_model_is_found(tmp_path):
    source = tmp_path / "P.mo"
    source.write_text("""
package P
  model Tank
    type Start = enumeration(full, empty);
    parameter Start start = Start.full;
    Real level;
  initial equation
    level = if start == Start.full then 2 else 0;
  equation
    der(level) = -level;
  end Tank;
  model M
    import P.Tank.Start.empty;
    import Begin = P.Tank.Start;
    Tank a(start=empty);
    Tank b(start=Begin.full);
  end M;
end P;
""")
    fmu = tmp_path / "M.fmu"
    build(source, fmu, model="P.M", platforms=(this_platform(),))
    found = run(fmu, 1.0, 0.1, "a.level", "b.level")
    assert found["b.level"] == pytest.approx(2 * np.exp(-found["time"]), abs=1e-8)
    assert (found["a.level"] == 0).all()


def test_elements_of_a_matrix_are_chosen_while_the_model_runs(tmp_path):
    fmu = made(tmp_path, """
model M
  function stamped
    input Integer n;
    output Real m[n, 2];
  algorithm
    m := zeros(n, 2);
    for i in 1:n loop
      m[i, 1] := i;
      m[i, 2] := 10*i;
    end for;
  end stamped;
  parameter Real table[3, 2] = stamped(3);
  Integer row(start=1, fixed=true);
  Integer column;
  Real y;
  Real z[2];
equation
  when sample(0.25, 0.5) then
    row = mod(pre(row), 3) + 1;
  end when;
  column = if time < 1 then 1 else 2;
  y = table[row, column];
  z = table[row, :];
end M;
""")  # fmt: skip
    found = run(fmu, 2.0, 0.1, "row", "y", "z[1]", "z[2]")
    time = found["time"]
    row = (np.floor((time - 0.25) / 0.5 + 1e-9) + 1) % 3 + 1
    assert (found["row"] == row).all() and (found["z[2]"] == 10 * row).all()
    inside = np.abs(time - 1) > 1e-6
    assert (found["y"] == np.where(time < 1, row, 10 * row))[inside].all()


def test_reinit_of_a_state_that_others_are_bound_to_moves_those(tmp_path):
    """Two bodies in rigid contact bounce as one, whichever velocity is set."""
    fmu = made(tmp_path, """
model M
  Real h(start=1, fixed=true);
  Real k;
  Real v(start=0, fixed=true);
  Real w;
  Real f;
equation
  der(h) = v;
  der(k) = w;
  k = h + 0.2;
  2*der(v) = -2*9.81 + f;
  3*der(w) = -3*9.81 - f;
  when h <= 0 then
    reinit(v, -0.8*pre(v));
  end when;
end M;
""")  # fmt: skip
    found = run(fmu, 2.0, 0.01, "h", "v", "w")
    heights, _ = bounced(found["time"])
    assert found["h"] == pytest.approx(heights, abs=1e-8)
    assert found["w"] == pytest.approx(found["v"], abs=1e-9)


def test_initial_equations_begin_discrete_variables(tmp_path):
    fmu = made(tmp_path, """
model M
  Real x(start=2, fixed=true);
  Real top;
initial equation
  top = 3*x;
equation
  der(x) = -x;
  when x < 1 then
    top = pre(top) + x;
  end when;
end M;
""")  # fmt: skip
    found = run(fmu, 1.4, 0.1, "top")
    assert found["top"] == pytest.approx(np.where(found["time"] < math.log(2), 6, 7), abs=1e-9)


def test_algorithms_that_read_what_they_have_set_at_the_same_event(tmp_path):
    fmu = made(tmp_path, """
model M
  Boolean x(start=false, fixed=true);
  Integer n(start=0, fixed=true), m(start=0, fixed=true);
  Real T(start=10, fixed=true), d, e;
  Boolean heating(start=true, fixed=true);
algorithm
  when sample(0, 1) then
    x := not x;
    n := n + 1;
    if x then
      m := n;
      m := m + 10;
    elseif n > 100 then
      m := 0;
    end if;
    n := 2*n;
  elsewhen time > 4.2 then
    m := -m;
  end when;
equation
  der(T) = d;
algorithm
  when {T >= 22, T <= 19} then
    heating := T <= 20;
  end when;
  e := 5;
  if heating then
    d := e - T/5;
    d := d + 1;
  else
    d := -T/10;
  end if;
end M;
""")  # fmt: skip
    found = run(fmu, 5.75, 0.25, "x", "n", "m", "T", "heating")
    x, n, m, expected = False, 0, 0, []
    for time in found["time"]:
        if time == int(time):
            x, n = not x, n + 1
            m = n + 10 if x else 0 if n > 100 else m
            n *= 2
        elif time == 4.25:
            m = -m
        expected.append((x, n, m))
    assert np.column_stack([found[one] for one in "xnm"]).tolist() == np.array(expected, dtype=float).tolist()
    warm = 5 * math.log(20 / 8)  # 30 - 20 exp(-t/5) comes to 22
    time = found["time"]
    exact = np.where(time <= warm, 30 - 20 * np.exp(-time / 5), 22 * np.exp(-(time - warm) / 10))
    assert found["T"] == pytest.approx(exact, abs=1e-7)
    assert (found["heating"] == (time <= warm)).all()


def test_texts_choose_equations_and_values(tmp_path):
    fmu = made(tmp_path, """
model M
  model Part
    parameter String kind = "slow";
    parameter Real k = if kind == "slow" then 1 else 5;
    Real x(start=1, fixed=true);
  equation
    if kind == "slow" then
      der(x) = -k*x;
    else
      der(x) = -k*x^2;
    end if;
  end Part;
  function rate
    input String kind;
    output Real r;
  algorithm
    if kind <> "fast" then
      r := 2;
    else
      r := 3;
    end if;
  end rate;
  parameter String other = "fast";
  Part a, b(kind=other);
  Real y = rate(other)*time;
  Boolean late(start=false, fixed=true);
equation
  when time > 0.5 then
    late = true;
  end when;
end M;
""")  # fmt: skip
    found = run(fmu, 1.0, 0.25, "a.x", "b.x", "y")
    time = found["time"]
    assert found["a.x"] == pytest.approx(np.exp(-time), abs=1e-8)
    assert found["b.x"] == pytest.approx(1 / (1 + 5 * time), abs=1e-8)
    assert found["y"] == pytest.approx(3 * time)


def test_packages_redeclared_within_modifications_are_no_classes_of_the_model(tmp_path):
    fmu = made(tmp_path, """
package P
  package A
    constant Real k = 1;
  end A;
  package B
    extends A(k=2);
  end B;
  model Part
    replaceable package Medium = A;
    Real x(start=1, fixed=true);
  equation
    der(x) = -Medium.k*x;
  end Part;
  model M
    Part one(redeclare package Medium = B);
    Part other(redeclare package Medium = B);
  end M;
end P;
""", model="P.M")  # fmt: skip
    found = run(fmu, 1.0, 0.5, "one.x", "other.x")
    assert found["other.x"] == pytest.approx(np.exp(-2 * found["time"]), abs=1e-8)


def test_annotations_of_functions_and_mod_within_them(tmp_path):
    fmu = made(tmp_path, """
package P
  function f
    input Real x;
    input Real k;
    output Real y;
  algorithm
    y := k*x^2;
    annotation(derivative(noDerivative=k) = df, inverse(x = g(y, k)), Inline=true);
  end f;
  function df
    input Real x;
    input Real k;
    input Real dx;
    output Real dy;
  algorithm
    dy := 2*k*x*dx;
  end df;
  function g
    input Real y;
    input Real k;
    output Real x;
  algorithm
    x := sqrt(y/k);
  end g;
  function wrapped
    input Real angle;
    output Real y;
  algorithm
    y := mod(angle, 2*2);
    y := if y > 2 then y - 2*2 else y;
  end wrapped;
  model M
    parameter Real k = 2;
    Real s, v, a, w;
    Real m(start=1, fixed=true), h;
    Boolean late(start=false, fixed=true);
  equation
    s = f(1 + time, k);
    v = der(s);
    a = der(v);
    w = wrapped(10*time + 1);
    der(m) = -1;
    h = semiLinear(m, 2.0, 3.0);
    when time > 0.5 then
      late = true;
    end when;
  end M;
end P;
""", model="P.M")  # fmt: skip
    found = run(fmu, 2.0, 0.13, "s", "v", "a", "w", "h")
    time = found["time"]
    assert found["s"] == pytest.approx(2 * (1 + time) ** 2)
    assert found["v"] == pytest.approx(4 * (1 + time))
    assert found["a"] == pytest.approx(4)
    angle = np.mod(10 * time + 1, 4)
    assert found["w"] == pytest.approx(np.where(angle > 2, angle - 4, angle))
    assert found["h"] == pytest.approx(np.where(time < 1, 2 * (1 - time), 3 * (1 - time)), abs=1e-9)


def test_modifiers_with_dotted_names_act_as_nested_ones(tmp_path):
    fmu = made(tmp_path, """
package P
  model Decay
    parameter Real rate = 1;
    Real x(start=1, fixed=true);
  equation
    der(x) = -rate*x;
  end Decay;
  model Pair
    Decay one, two;
  end Pair;
  model Faster
    extends Pair(one.rate = 2, two.rate = 3, two.x.start = 4);
  end Faster;
  model M
    Decay plain(x.start = 2);
    Decay both(x.start = 3, rate = 2,
      x.nominal = 5);
    Decay mixed(x(nominal = 5), x.start = 6);
    Pair pair(final one.x.start = sin(0.5), one.rate = 0.5, two.x.start = 7);
    Faster faster(one.x.start = 8);
    Decay many[2](x.start = {9, 10}, each rate = 3);
  end M;
end P;
""", model="P.M")  # fmt: skip
    exact = {
        "plain": (2, 1), "both": (3, 2), "mixed": (6, 1),
        "pair.one": (math.sin(0.5), 0.5), "pair.two": (7, 1),
        "faster.one": (8, 2), "faster.two": (4, 3), "many[1]": (9, 3), "many[2]": (10, 3),
    }  # fmt: skip
    found = run(fmu, 1.0, 0.5, *(f"{name}.x" for name in exact))
    for name, (start, rate) in exact.items():
        assert np.abs(found[f"{name}.x"] / start - np.exp(-rate * found["time"])).max() < 1e-8


def test_a_model_without_events_keeps_its_dotted_start_values(tmp_path):
    fmu = made(tmp_path, """
model M
  model Mass
    Real v(start=0, fixed=true);
  equation
    der(v) = -v;
  end Mass;
  Mass mass(v.start = 2);
end M;
""")  # fmt: skip
    assert abs(run(fmu, 1.0, 1.0, "mass.v")["mass.v"][-1] - 2 * math.exp(-1)) < 1e-8


def test_only_modifiers_are_nested():
    text = """model M
  Part a(b.c = 1, /* of two */ b.d.e = {f(g.h), 2}, redeclare Other o(p.q = 3)) "(r.s = 4)";
  Part t(each final u.v = 1, u.w = 2,

    k = 1.5);
equation
  (x, y) = f(a.b, n=c.d);
  connect(a.b, c.d) annotation(Line(points={{0, 0}}), e.f = 3);
  z = if (a.b == c.d) then 1 else 0;
end M;
"""
    new = adapted(text, "M.mo")
    assert [line for line in new.splitlines() if line] == [
        "model M",
        '  Part a(b(c = 1, d(e = { f ( g . h ) , 2 })), redeclare Other o (p(q = 3))) "(r.s = 4)";',
        "  Part t(u(each final v = 1, w = 2), k = 1.5)",
        ";",
        *[line for line in text.splitlines() if line][4:],
    ]
    assert new.count("\n") == text.count("\n")


def test_functions_may_stand_in_reductions_of_declarations(tmp_path):
    text = """package P
  function square
    input Real x;
    output Real y;
  algorithm
    y := x^2;
  end square;
  partial block Part
    parameter Integer n = 3;
    Real a[n] = {time, 2, 3};
    output Real x(min = 0) = sum({square(a[k]) for k in 1:n}) "of squares"
      annotation(Dialog(tab = "a"));
    Real z = product(square(a[k] + 1) for k in 1:n);
    Real s = sum({integer(1.5*k)*a[2] for k in 1:n});
    annotation(Documentation(info = "text"));
  end Part;
  model M
    extends Part;
    Real w[2] = {square(a[k]) for k in 1:2};
  protected
    Real v = 1 + 2*max({square(k - a[1]) for k in 1:n});
    Real q(start = 0, fixed = true);
    output Real u = v;
  equation
    der(q) = x;
  end M;
end P;
"""
    found = run(made(tmp_path, text, model="P.M"), 1.0, 0.125, "x", "z", "s", "w[1]", "u")
    t = found["time"]
    assert np.abs(found["x"] - (t**2 + 13)).max() < 1e-12
    assert np.abs(found["s"] - 2 * (1 + 3 + 4)).max() < 1e-12
    assert np.abs(found["z"] - 144 * (t + 1) ** 2).max() < 1e-11
    assert np.abs(found["w[1]"] - t**2).max() < 1e-12
    assert np.abs(found["u"] - (1 + 2 * np.maximum((1 - t) ** 2, (3 - t) ** 2))).max() < 1e-12
