"""`orchestrator build --show`: the flat model is Modelica again, and the blocks say how it is solved."""

from __future__ import annotations

import json
import re

import build_extra  # noqa: F401
import fmpy
import modelica_bench as bench
import numpy as np
import pytest

pytest.importorskip("rumoca", reason="needs the extra build")

from orchestrator.cli.main import main
from orchestrator.translate.build import build
from orchestrator.translate.package import this_platform
from orchestrator.translate.show import show_model

CIRCUIT = """model Model
  connector Pin
    Real v(unit="V");
    flow Real i(unit="A");
  end Pin;
  model Resistor
    Pin p, n;
    parameter Real r(unit="Ohm") = 2;
  equation
    p.i = (p.v - n.v)/r;
    p.i + n.i = 0;
  end Resistor;
  model Capacitor
    Pin p, n;
    parameter Real c(unit="F") = 1e-3;
    Real v(unit="V", start=1, fixed=true);
  equation
    v = p.v - n.v;
    c*der(v) = p.i;
    p.i + n.i = 0;
  end Capacitor;
  model Ground
    Pin p;
  equation
    p.v = 0;
  end Ground;
  function cubed "with a loop"
    input Real u;
    output Real y;
  algorithm
    y := u*u;
    y := y*u;
  end cubed;
  type Mode = enumeration(low, high);
  constant Integer n = 3;
  Resistor one(r=3), two;
  Capacitor store;
  Ground ground;
  Real x[n](each start=1, each fixed=true);
  Mode mode(start=Mode.low, fixed=true);
  discrete Real held(start=0, fixed=true);
  Real grid[2, 3] = {{(10*i + j)*time for j in 1:3} for i in 1:2};
  Real total = sum(i*x[i] for i in 1:n) + max(if i > 1 then x[i] else 0 for i in 1:n);
  output Real y = cubed(x[1]) - (if store.v > 0.5 then 2^2 else -1) + (-x[2])^2 - (x[1] - x[2]);
equation
  connect(store.p, one.p);
  connect(one.n, two.p);
  connect(two.n, ground.p);
  connect(store.n, ground.p);
  for i in 1:n loop
    der(x[i]) = -i*x[i];
  end for;
  when sample(0, 0.1) then
    held = pre(held) + x[1];
  end when;
  when store.v < 0.5 then
    mode = Mode.high;
    reinit(x[1], 2) "again";
  end when;
end Model;
"""
# The compiler takes no reinit of an element of an array.
CIRCUIT = CIRCUIT.replace('    reinit(x[1], 2) "again";\n', "    reinit(store.v, 0.8);\n")


def test_the_flat_model_translates_to_the_same_equations(tmp_path):
    """The printed model, built again, gives the same signals; printed again, the same text."""
    first = bench.model_file(tmp_path, CIRCUIT)
    flat = show_model(first, "flat")
    assert "connect" not in flat and "'two.p.v'" in flat
    (tmp_path / "again").mkdir()
    second = bench.model_file(tmp_path / "again", flat)
    assert show_model(second, "flat") == flat
    runs = []
    for path in (first, second):
        build(path, path.with_suffix(".fmu"), platforms=(this_platform(),))
        names = [one.name for one in fmpy.read_model_description(path.with_suffix(".fmu")).modelVariables]
        found = fmpy.simulate_fmu(
            path.with_suffix(".fmu"), stop_time=1, output_interval=0.05, output=names[1:]
        )
        runs.append({name.replace("'", ""): found[name].astype(float) for name in found.dtype.names})
    assert runs[0].keys() == runs[1].keys()
    for name, values in runs[0].items():
        np.testing.assert_allclose(runs[1][name], values, rtol=1e-8, atol=1e-10, err_msg=name)
    assert runs[0]["mode"][-1] == 2 and runs[0]["held"][-1] > 3


STATEMENTS = """model Model
  function f
    input Real u[3];
    output Real y;
    output Integer k = 1;
  protected
    Real t = 0;
  algorithm
    for i in 1:3 loop
      t := t + u[i];
    end for;
    if t > 1 then
      y := t;
    elseif t < -1 then
      y := -t;
    else
      y := 0;
    end if;
  end f;
  Real a[2](start = {1, 2}, each fixed = true);
  Real b[3, 2];
  Real z;
  Integer k;
  Integer n(start = 0);
equation
  der(a) = -a;
  b = [transpose([a]); 1, 2; 3, 4];
  (z, k) = f({a[1], a[2], 1});
algorithm
  when z > 1 then
    n := pre(n) + 1;
  end when;
end Model;
"""


def test_statements_and_matrices_are_shown_as_written(tmp_path):
    assert show_model(bench.model_file(tmp_path, STATEMENTS), "flat") == STATEMENTS


PENDULUM = """model Model
  parameter Real L = 1, g = 9.81, m = 1;
  Real x(start=0.6, fixed=true), y(start=-0.8), vx(start=0, fixed=true), vy, lam, twin = x;
  Real i, u;
  discrete Real k(start=0, fixed=true);
equation
  der(x) = vx;
  der(y) = vy;
  m*der(vx) = -lam*x;
  m*der(vy) = -lam*y - m*g;
  x^2 + y^2 = L^2;
  i = 1e-9*(exp(u/0.025) - 1);
  u + 100*i = 1 + sin(time);
  when {x > 0.5, sample(0, 0.25)} then
    k = pre(k) + 1;
  end when;
end Model;
"""


def test_blocks_name_loops_states_constraints_and_events(tmp_path):
    text = show_model(bench.model_file(tmp_path, PENDULUM), "blocks")
    head, initial, blocks = re.split(r"\n\nInitial.*\n|\n\nBlocks.*\n", text)
    assert "States: x, y, vx, vy" in head
    assert "2 constraints bind the states: 2 degrees of freedom" in head
    assert "0 = x*x + y*y - L*L" in head and "twin = x" in head
    assert "x := start of x" in initial and "iterates y" in initial
    # The accelerations and the force by one linear system, of which three unknowns are iterated; the diode's.
    assert re.search(r"linear system of 5 equations, torn: 3 iterated; iterates .*lam", blocks)
    assert re.search(
        r"nonlinear system of 2 equations, by Newton's method; iterates i, u\n +0 = i - ", blocks
    )
    assert "der(x) := vx" in blocks
    assert "state event where x > 0.5 changes" in blocks
    assert "ticks at 0 s, 0.25 s, ... (period 0.25 s)" in blocks
    assert "k := pre(k) + 1 when (x > 0.5, sample(0, 0.25))" in blocks


def test_blocks_of_a_model_with_delays(tmp_path):
    text = "model Model\n  input Real u;\n  Real x(start=1, fixed=true);\nequation\n"
    text += "  der(x) = -delay(x, 0.1) + u;\nend Model;\n"
    shown = show_model(bench.model_file(tmp_path, text), "blocks")
    assert "delay(x, 0.1)" in shown and re.search(r"der\(x\) := .*u", shown)


def test_blocks_of_a_model_with_a_range_that_its_start_has_to_keep(tmp_path):
    text = "model Model\n  parameter Real a(min=0.1, fixed=false, start=2);\n  Real x(start=1, fixed=true);\n"
    text += "initial equation\n  a*a = 2;\nequation\n  der(x) = -a*x;\nend Model;\n"
    assert "finds a beyond its min" in show_model(bench.model_file(tmp_path, text), "blocks")


def test_the_command_prints_and_builds_nothing(tmp_path, capsys):
    path = bench.model_file(tmp_path, PENDULUM)
    assert main(["build", str(path), "--show", "blocks"]) == 0
    text = capsys.readouterr().out
    assert "torn: 3 iterated" in text
    assert main(["build", str(path), "--show", "blocks", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["blocks"] == text
    assert main(["build", str(path), "--show", "flat"]) == 0
    assert capsys.readouterr().out.startswith("model Model\n")
    assert not list(tmp_path.glob("*.fmu"))
    assert (
        main(
            [
                "build",
                str(bench.model_file(tmp_path, "model Model\n  Real x;\nend Model;\n")),
                "--show",
                "blocks",
            ]
        )
        == 1
    )
    assert "none is left that determines x" in capsys.readouterr().err
