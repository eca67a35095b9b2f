"""FMUs of models with events, loops, initial equations, functions, higher index, against exact solutions."""

from __future__ import annotations

import math
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import fmpy
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

pytest.importorskip("rumoca", reason="needs the extra build")

import orchestrator as orc
from orchestrator.base.errors import BuildError, StepError
from orchestrator.cli.main import main
from orchestrator.translate import compiler
from orchestrator.translate.build import build
from orchestrator.translate.compiler import compile_model
from orchestrator.translate.flatten import flatten
from orchestrator.translate.hybrid.front_end import dae_form
from orchestrator.translate.hybrid.sparsity import colours_of, factors_of
from orchestrator.translate.package import this_platform
from orchestrator.translate.rewriting.copies import modernised
from orchestrator.translate.sources import load_sources


def made(
    tmp_path: Path,
    text: str,
    fmi_version: str = "2.0",
    model: str | None = None,
    libraries: Sequence[Path] = (),
) -> Path:
    """The FMU of a model's text, whose model is called M unless named."""
    source = tmp_path / "M.mo"
    source.write_text(text)
    output = tmp_path / "M.fmu"
    build(
        source,
        output,
        model=model,
        platforms=(this_platform(),),
        fmi_version=fmi_version,
        libraries=libraries,
    )
    return output


def run(fmu: Path, stop: float, step: float, *outputs: str, **options) -> dict[str, np.ndarray]:
    found = fmpy.simulate_fmu(
        str(fmu),
        stop_time=stop,
        output_interval=step,
        output=list(outputs),
        fmi_type="CoSimulation",
        **options,
    )
    return {name: found[name].astype(float) for name in ("time", *outputs)}


BALL = """
model M
  parameter Real e = 0.8;
  parameter Real g(unit="m/s2") = 9.81;
  output Real h(start=1, fixed=true, unit="m");
  output Real v(start=0, fixed=true, unit="m/s");
  output Integer bounces(start=0, fixed=true);
equation
  der(h) = v;
  der(v) = -g;
  when h <= 0 then
    reinit(v, -e*pre(v));
    bounces = pre(bounces) + 1;
  end when;
end M;
"""


def bounced(times: np.ndarray, e: float = 0.8, g: float = 9.81) -> tuple[np.ndarray, np.ndarray]:
    """Height of a ball that falls from 1 m, and how often it has bounced."""
    heights, counts = [], []
    for now in times:
        begin, speed, count = -math.sqrt(2 / g), math.sqrt(2 * g), 0
        while now > begin + 2 * speed / g:
            begin, speed, count = begin + 2 * speed / g, e * speed, count + 1
        heights.append(speed * (now - begin) - g * (now - begin) ** 2 / 2)
        counts.append(count)
    return np.array(heights), np.array(counts)


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_a_ball_bounces_when_it_must(tmp_path, version):
    found = run(made(tmp_path, BALL, version), 3.0, 0.01, "h", "bounces")
    heights, counts = bounced(found["time"])
    assert np.abs(found["h"] - heights).max() < 1e-10
    assert (found["bounces"] == counts).all()


def test_start_values_and_parameters_are_the_importers(tmp_path):
    found = run(made(tmp_path, BALL), 0.5, 0.1, "h", "v", start_values={"h": 5.0, "v": 2.0, "g": 1.0})
    time = found["time"]
    assert np.abs(found["h"] - (5 + 2 * time - time**2 / 2)).max() < 1e-12


def test_a_saved_state_holds_events_and_all(tmp_path):
    """A run that goes back over a bounce repeats it to the bit."""
    fmu = made(tmp_path, BALL)
    description = fmpy.read_model_description(fmu)
    reference = {one.name: one.valueReference for one in description.modelVariables}
    with fmpy_instance(fmu, description, tmp_path) as one:
        one.doStep(0.0, 0.4)
        state = one.getFMUState()
        first = []
        for _ in range(2):
            one.doStep(0.4, 0.1)
            first.append(
                (*one.getReal([reference["h"], reference["v"]]), *one.getInteger([reference["bounces"]]))
            )
            one.setFMUState(state)
        assert first[0] == first[1]
        assert first[0][2] == 1


class fmpy_instance:
    """An instance after initialisation."""

    def __init__(self, fmu, description, folder):
        self._unpacked = fmpy.extract(str(fmu), unzipdir=str(folder / "unpacked"))
        self._one = fmpy.fmi2.FMU2Slave(
            guid=description.guid, unzipDirectory=self._unpacked,
            modelIdentifier=description.coSimulation.modelIdentifier, instanceName="one",
        )  # fmt: skip

    def __enter__(self):
        one = self._one
        one.instantiate()
        one.setupExperiment(startTime=0.0)
        one.enterInitializationMode()
        one.exitInitializationMode()
        return one

    def __exit__(self, *_):
        self._one.terminate()
        self._one.freeInstance()


def test_a_sampled_function_counts(tmp_path):
    fmu = made(tmp_path, """
model M
  function cubed
    input Real u;
    output Real y;
  protected
    Real t;
  algorithm
    t := u;
    for i in 1:2 loop
      t := t*u;
    end for;
    y := t;
  end cubed;
  input Real u(start=0);
  discrete output Real y(start=0, fixed=true);
equation
  when sample(0.05, 0.1) then
    y = pre(y) + cubed(u);
  end when;
end M;
""")  # fmt: skip
    signal = np.array([(0.0, 2.0), (1.0, 2.0)], dtype=[("time", float), ("u", float)])
    found = run(fmu, 1.0, 0.02, "y", input=signal)
    ticks = np.floor((found["time"] - 0.05) / 0.1 + 1e-9) + 1
    assert np.abs(found["y"] - 8 * ticks).max() < 1e-12


def test_a_pendulum_in_cartesian_coordinates_swings_round(tmp_path):
    """Index 3; a choice of states would become singular on the way."""
    fmu = made(tmp_path, """
model M
  parameter Real L = 1;
  parameter Real g = 9.81;
  output Real x(start=0, fixed=true);
  output Real y(start=-1);
  output Real vx(start=7, fixed=true);
  Real vy;
  output Real F;
equation
  der(x) = vx;
  der(y) = vy;
  der(vx) = -F*x;
  der(vy) = -F*y - g;
  x^2 + y^2 = L^2;
end M;
""")  # fmt: skip
    found = run(fmu, 3.0, 0.01, "x", "y", "F")
    exact = solve_ivp(
        lambda t, z: [z[1], -9.81 * math.sin(z[0])], (0, 3), [0, 7], t_eval=found["time"], rtol=1e-12,
        atol=1e-13, method="DOP853",
    ).y  # fmt: skip
    assert exact[0].max() > 2 * math.pi  # it goes over the top
    assert np.abs(found["x"] - np.sin(exact[0])).max() < 1e-7
    assert np.abs(found["F"] - exact[1] ** 2 - 9.81 * np.cos(exact[0])).max() < 1e-5
    assert np.abs(found["x"] ** 2 + found["y"] ** 2 - 1).max() < 1e-13


def test_capacitors_in_parallel_share_their_charge(tmp_path):
    fmu = made(tmp_path, """
model M
  connector Pin Real v; flow Real i; end Pin;
  model Capacitor
    parameter Real C; Pin p; Pin n; Real v;
  equation
    v = p.v - n.v; C*der(v) = p.i; p.i + n.i = 0;
  end Capacitor;
  model Resistor
    parameter Real R; Pin p; Pin n;
  equation
    p.v - n.v = R*p.i; p.i + n.i = 0;
  end Resistor;
  model Ground Pin p; equation p.v = 0; end Ground;
  Capacitor a(C=1e-3, v(start=5, fixed=true));
  Capacitor b(C=3e-3);
  Resistor r(R=100);
  Ground g;
equation
  connect(a.p, b.p); connect(a.p, r.p);
  connect(a.n, b.n); connect(a.n, r.n); connect(a.n, g.p);
end M;
""")  # fmt: skip
    found = run(fmu, 1.0, 0.1, "a.v", "b.p.i")
    exact = 5 * np.exp(-found["time"] / 0.4)
    assert np.abs(found["a.v"] - exact).max() < 1e-8
    assert np.abs(found["b.p.i"] + 3e-3 * exact / 0.4).max() < 1e-9


def test_initial_equations_give_parameters_and_states(tmp_path):
    fmu = made(tmp_path, """
model M
  parameter Real p(fixed=false, start=1);
  parameter Real twice = 2*p;
  Real x;
  Real y(start=3);
  Integer n;
initial equation
  der(y) = 0;
  x = 2*p;
  x + p = 6;
  n = 4;
equation
  der(x) = -x;
  der(y) = twice - y;
  when x < 1 then
    n = pre(n) + 1;
  end when;
end M;
""")  # fmt: skip
    found = run(fmu, 2.0, 0.1, "x", "y", "p", "twice", "n")
    assert np.abs(found["x"] - 4 * np.exp(-found["time"])).max() < 1e-8
    assert np.abs(found["y"] - 4).max() < 1e-12
    assert (found["p"] == 2).all() and (found["twice"] == 4).all()
    assert (found["n"] == np.where(found["time"] > math.log(4), 5, 4)).all()


def test_a_nonlinear_loop_is_solved(tmp_path):
    fmu = made(tmp_path, "model M\nReal x;\nReal y;\nequation\nx = 0.5*sin(y) + time;\ny = x + 1;\nend M;\n")
    found = run(fmu, 3.0, 0.05, "x", "y")
    assert np.abs(found["x"] - 0.5 * np.sin(found["x"] + 1) - found["time"]).max() < 1e-12
    assert np.abs(found["y"] - found["x"] - 1).max() < 1e-12


def test_a_stiff_reaction_follows_its_reference(tmp_path):
    """Robertson's problem (Hairer and Wanner, Solving Ordinary Differential Equations II, IV.10)."""
    fmu = made(tmp_path, """
model M
  Real a(start=1, fixed=true);
  Real b(start=0, fixed=true, nominal=1e-5);
  Real c;
equation
  der(a) = -0.04*a + 1e4*b*c;
  der(b) = 0.04*a - 1e4*b*c - 3e7*b^2;
  a + b + c = 1;
end M;
""")  # fmt: skip
    found = run(fmu, 40.0, 1.0, "a", "b", "c")
    assert found["a"][-1] == pytest.approx(0.7158270688, rel=1e-7)
    assert found["b"][-1] == pytest.approx(0.9185534765e-5, rel=1e-7)
    assert found["c"][-1] == pytest.approx(0.2841637457, rel=1e-7)


def test_steps_of_functions_are_events(tmp_path):
    fmu = made(tmp_path, """
model M
  Real ramp(start=0, fixed=true);
  Real total(start=0, fixed=true);
  Real saw;
  Integer whole;
equation
  der(ramp) = 1;
  whole = integer(ramp);
  saw = mod(ramp, 0.3);
  der(total) = floor(2*ramp) + saw;
end M;
""")  # fmt: skip
    found = run(fmu, 2.05, 0.05, "ramp", "total", "saw", "whole")
    time = found["time"]
    halves = np.floor(2 * time + 1e-9)
    saws = np.floor(time / 0.3 + 1e-9)
    exact = halves * time - (halves * (halves + 1)) / 4 + saws * 0.045 + (time - 0.3 * saws) ** 2 / 2
    assert np.abs(found["total"] - exact).max() < 1e-9
    inside = np.abs(time / 0.3 - np.round(time / 0.3)) > 1e-6
    assert np.abs(found["saw"] - np.mod(time, 0.3))[inside].max() < 1e-9


def test_branches_of_a_when_and_of_discrete_variables(tmp_path):
    fmu = made(tmp_path, """
model M
  type Mode = enumeration(off, on, done);
  output Mode mode(start=Mode.off, fixed=true);
  Real x(start=0, fixed=true);
  Boolean high;
  Integer flips(start=0, fixed=true);
equation
  der(x) = if mode == Mode.on then 2 else 1;
  high = x > 1;
  when time >= 0.5 then
    mode = Mode.on;
  elsewhen x > 2.5 then
    mode = Mode.done;
  end when;
  when change(high) then
    flips = pre(flips) + 1;
  end when;
end M;
""")  # fmt: skip
    found = run(fmu, 2.0, 0.125, "x", "mode", "flips")
    time = found["time"]
    exact = np.where(time < 0.5, time, np.where(time < 1.5, 0.5 + 2 * (time - 0.5), 2.5 + (time - 1.5)))
    assert np.abs(found["x"] - exact).max() < 1e-10
    inside = (np.abs(time - 0.5) > 1e-6) & (np.abs(time - 1.5) > 1e-6)
    modes = np.where(time < 0.5, 1, np.where(time < 1.5, 2, 3))
    assert (found["mode"] == modes)[inside].all()
    assert found["flips"][-1] == 1


def test_an_ideal_diode_rectifies(tmp_path):
    """Its condition depends on what the loop of equations gives."""
    fmu = made(tmp_path, """
model M
  Real s; Real v; Real i; Boolean off; Real u;
equation
  u = sin(6.283185307179586*time);
  off = s < 0;
  v = if off then s else 1e-5*s;
  i = if off then 1e-5*s else s;
  u = v + 10*i;
end M;
""")  # fmt: skip
    found = run(fmu, 1.0, 0.01, "i", "u")
    exact = np.where(found["u"] > 0, found["u"] / (10 + 1e-5), found["u"] * 1e-5 / (1 + 1e-4))
    assert np.abs(found["i"] - exact).max() < 1e-12


def test_chattering_is_named(tmp_path):
    fmu = made(tmp_path, """
model M
  Real x(start=1, fixed=true);
equation
  der(x) = if x > 0 then -1 else 1;
end M;
""".replace("der(x)", "der(x) + 0*integer(x)"))  # fmt: skip
    with pytest.raises(
        StepError, match="chattering: events follow each other without end at the relation of x"
    ):
        orc.run(str(fmu), set={"run.stop_time": "2 s", "run.step_size": "0.1 s"}, halving=False)


def test_an_assertion_ends_the_run_with_its_text(tmp_path):
    fmu = made(tmp_path, """
model M
  Real x(start=0, fixed=true);
  Boolean b;
equation
  der(x) = 1;
  b = pre(b);
  assert(x < 0.5, "x has left its range");
end M;
""")  # fmt: skip
    with pytest.raises(StepError, match="x has left its range"):
        orc.run(str(fmu), set={"run.stop_time": "1 s", "run.step_size": "0.1 s"}, halving=False)


@pytest.mark.parametrize(
    ("body", "reported"),
    [
        ("Real x;\nReal y;\nequation\nder(x) = y;\nx = y;\nx = 2*y;", "equation"),
        (
            "Real x(start=1, fixed=true);\ninitial equation\nx = 2;\nequation\nder(x) = -x;",
            "the start value of x must not have fixed=true",
        ),
        (
            "input Real u;\nReal x;\nReal y;\nequation\nder(x) = y;\nx = u;",
            "the input u would have to be differentiated",
        ),
    ],
)
def test_what_cannot_be_solved_is_refused_by_name(tmp_path, body, reported):
    with pytest.raises(BuildError) as caught:
        made(tmp_path, f"model M\n{body}\nend M;\n")
    assert reported in str(caught.value)


def test_a_library_is_read_where_it_is_named(tmp_path):
    library = tmp_path / "libraries" / "Springs"
    library.mkdir(parents=True)
    (library / "package.mo").write_text("package Springs\nend Springs;\n")
    (library / "Cubic.mo").write_text("""
within Springs;
model Cubic
  parameter Real k = 2;
  Real s;
  Real f;
equation
  f = k*s^3;
end Cubic;
""")
    text = """
model M
  Springs.Cubic c(k=4);
  Real v(start=1, fixed=true);
equation
  der(c.s) = v;
  der(v) = -c.f;
end M;
"""
    source = tmp_path / "M.mo"
    source.write_text(text)
    assert main(["build", str(source), "-o", str(tmp_path / "M.fmu"), "--library", str(library.parent)]) == 0
    found = run(tmp_path / "M.fmu", 2.0, 0.1, "c.s", "v")
    assert np.abs(found["v"] ** 2 / 2 + found["c.s"] ** 4 - 0.5).max() < 1e-8  # its energy
    assert (
        main(["build", str(source), "-o", str(tmp_path / "N.fmu"), "--library", str(tmp_path / "none")]) == 1
    )
    assert main(["build", str(source), "-o", str(tmp_path / "N.fmu")]) == 1


@pytest.mark.parametrize(
    "lag, message",
    [
        ("0.1 + abs(s), 2.0", "delay() with a delay time that changes"),  # by the translation
        ("true", "delay() "),  # by the compiler
    ],
)
def test_an_error_within_a_library_names_the_users_file(tmp_path, lag, message):
    library = tmp_path / "libraries" / "Springs"
    library.mkdir(parents=True)
    (library / "package.mo").write_text("package Springs\nend Springs;\n")
    (library / "Late.mo").write_text(f"""within Springs;
model Late
  Real s(start=1, fixed=true);
equation
  der(s) = -delay(s, {lag}) - (if s > 0.5 then 1 else 0);
end Late;
""")
    source = tmp_path / "M.mo"
    source.write_text("model M\n  Springs.Late late;\nend M;\n")
    with pytest.raises(BuildError) as refusal:
        build(source, tmp_path / "M.fmu", platforms=(this_platform(),), libraries=[library.parent])
    assert str(refusal.value).startswith(f"{library / 'Late.mo'}:5:")
    assert message in str(refusal.value)


def test_units_of_an_old_standard_library_get_their_new_names(tmp_path):
    (tmp_path / "Old.mo").write_text(
        "model Old\nimport Modelica.SIunits;\nModelica.SIunits.Mass m;\nend Old;\n"
    )
    modernised(tmp_path)
    text = (tmp_path / "Old.mo").read_text()
    assert "import SIunits = Modelica.Units.SI;" in text and "Modelica.Units.SI.Mass m" in text


def test_a_compiler_that_does_not_end_is_an_error_and_the_next_model_builds(tmp_path, monkeypatch):
    source = tmp_path / "M.mo"
    source.write_text(BALL)
    tree = load_sources(source)
    late = r"the Modelica compiler did not end within 1e-05 s for M"
    with pytest.raises(BuildError, match=late):
        dae_form(tree, "M", time_limit=1e-5)
    with monkeypatch.context() as patch:
        patch.setitem(compile_model.__kwdefaults__, "limit", 1e-5)
        with pytest.raises(BuildError, match=late):
            flatten(tree, "M")
    assert "h" in flatten(tree, "M")[0]["variables"]


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="no processor times of others here")
@pytest.mark.parametrize(("does", "limits"), [("pass", 1.0), ("__import__('time').sleep(1)", 4.0)])
def test_the_compiler_may_wait_for_others_but_not_work_for_ever(tmp_path, monkeypatch, does, limits):
    """Only its own processor time counts, up to five times the limit by the clock."""
    source = tmp_path / "M.mo"
    source.write_text(BALL)
    busy = f"import sys\nfor line in sys.stdin:\n    while True: {does}"
    with subprocess.Popen(
        [sys.executable, "-c", busy], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        monkeypatch.setattr(compiler, "_running", [(os.getpid(), process)])
        begin = time.monotonic()
        with pytest.raises(BuildError, match=r"did not end within 0\.3 s"):
            compile_model(load_sources(source), "M", tmp_path, ["dae"], limit=0.3)
    assert time.monotonic() - begin >= 0.3 * limits


def test_copies_of_libraries_that_no_build_has_read_lately_are_removed(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    source = tmp_path / "M.mo"
    source.write_text("model M\n  Real y;\nequation\n  y = L.k;\nend M;\n")
    tree = load_sources(source)
    used = []
    for number in range(7):
        library = tmp_path / f"at_{number}" / "L"
        library.mkdir(parents=True)
        (library / "package.mo").write_text(f"package L\n  constant Real k = {number};\nend L;\n")
        dae_form(tree, "M", [library.parent])
        new = set((tmp_path / "cache" / "orchestrator" / "libraries").iterdir()) - set(used)
        used += sorted(new)
        if number < 6:  # used two hours and more ago
            os.utime(used[-1], (time.time() - 7200 - 6 + number,) * 2)
    assert [one.exists() for one in used] == [False, False, False, True, True, True, True]


def test_initial_in_an_equation_holds_at_the_start_alone(tmp_path):
    fmu = made(tmp_path, """
model M
  Real x;
  Real y;
initial equation
  y = 3;
equation
  der(x) = -x;
  y = if initial() then 2*x else x;
end M;
""")  # fmt: skip
    found = run(fmu, 1.0, 0.1, "x", "y")
    exact = 1.5 * np.exp(-found["time"])
    assert np.abs(found["x"] - exact).max() < 1e-9
    assert np.abs(found["y"] - exact)[1:].max() < 1e-9


def test_an_initial_algorithm_gives_a_parameter(tmp_path):
    fmu = made(tmp_path, """
model M
  parameter Real a = 3;
  parameter Real limit(fixed=false);
  Real x(start=0, fixed=true);
initial algorithm
  limit := 2*a;
  if limit > 5 then
    limit := 5;
  end if;
equation
  der(x) = if x < limit then 10 else 0;
end M;
""")  # fmt: skip
    found = run(fmu, 1.0, 0.1, "x", "limit")
    assert (found["limit"] == 5).all()
    assert np.abs(found["x"] - np.minimum(10 * found["time"], 5)).max() < 1e-9


@pytest.mark.parametrize("cubic", [0.0, 0.01])
def test_a_ladder_is_one_block(tmp_path, cubic):
    """Twenty resistors in a ladder, linear and not."""
    fmu = made(tmp_path, """
model M
  parameter Integer n = 20;
  Real v[n+1];
  Real i[n];
equation
  v[1] = 1 + time;
  for k in 1:n loop
    v[k] - v[k+1] = (1 + 0.1*k)*i[k];
  end for;
  for k in 1:n-1 loop
    i[k] = i[k+1] + v[k+1]/(5 + k) + CUBIC*v[k+1]^3;
  end for;
  i[n] = v[n+1]/3;
end M;
""".replace("CUBIC", str(cubic)))  # fmt: skip
    found = run(fmu, 1.0, 0.5, *(f"v[{k}]" for k in range(1, 22)), *(f"i[{k}]" for k in range(1, 21)))
    v = np.array([found[f"v[{k}]"] for k in range(1, 22)])
    i = np.array([found[f"i[{k}]"] for k in range(1, 21)])
    k = np.arange(1, 21)[:, None]
    assert np.abs(v[:-1] - v[1:] - (1 + 0.1 * k) * i).max() < 1e-12
    assert np.abs(i[:-1] - i[1:] - v[1:-1] / (5 + k[:-1]) - cubic * v[1:-1] ** 3).max() < 1e-12
    assert np.abs(v[0] - 1 - found["time"]).max() < 1e-12


def test_arrays_are_joined_and_multiplied(tmp_path):
    fmu = made(tmp_path, """
model M
  Real a[2](start={1, 2}, each fixed=true);
  Real b[3, 2];
  Real c[3];
  Integer n(start=0, fixed=true);
equation
  der(a) = -a;
  b = [transpose([a]); 1, 2; 3, 4];
  c = b*a;
  when a[1] < 0.5 then
    n = pre(n) + 1;
  end when;
end M;
""")  # fmt: skip
    found = run(fmu, 1.0, 0.25, "a[1]", "a[2]", "c[1]", "c[2]", "c[3]")
    one, two = np.exp(-found["time"]), 2 * np.exp(-found["time"])
    assert np.abs(found["c[1]"] - one**2 - two**2).max() < 1e-8
    assert np.abs(found["c[3]"] - 3 * one - 4 * two).max() < 1e-8


def test_loops_within_loops_of_a_function_run_once_each(tmp_path):
    fmu = made(tmp_path, """
model M
  function weighted "row sums of a matrix times a vector, over each pair of rows and columns once"
    input Real a[:, :];
    input Real x[size(a, 2)];
    output Real y[size(a, 1)];
    output Real total;
  algorithm
    total := 0;
    for i in 1:size(a, 1) loop
      y[i] := 0;
      for j in 1:size(a, 2) loop
        y[i] := y[i] + a[i, j]*x[j];
        for k in 1:2 loop
          total := total + k*a[i, j];
        end for;
      end for;
    end for;
    for i in 1:2, j in 1:2 loop
      total := total + 100*i*j;
    end for;
  end weighted;
  function below "solution of a lower triangular system"
    input Real a[:, :];
    input Real b[size(a, 1)];
    output Real x[size(a, 1)];
  algorithm
    for i in 1:size(a, 1) loop
      x[i] := b[i];
      for j in 1:i - 1 loop
        x[i] := x[i] - a[i, j]*x[j];
      end for;
      x[i] := x[i]/a[i, i];
    end for;
  end below;
  parameter Real a[3, 3] = [-1, 1, 0; 0, -2, 1; 0.5, 0, -1];
  Real x[3](start={1, 2, 3}, each fixed=true);
  Real slope[3];
  Real total;
  Real z[3];
equation
  z = below([2, 0, 0; 1, 4, 0; -1, 3, 5], {time, 1, 2});
  (slope, total) = weighted(a, x);
  der(x) = slope;
end M;
""")  # fmt: skip
    found = run(fmu, 2.0, 0.5, "x[1]", "x[2]", "x[3]", "total", "z[3]")
    matrix = np.array([[-1, 1, 0], [0, -2, 1], [0.5, 0, -1]])
    for place, now in enumerate(found["time"]):
        exact = expm(matrix * now) @ [1, 2, 3]
        assert np.abs([found[f"x[{n}]"][place] for n in (1, 2, 3)] - exact).max() < 1e-8
    assert np.abs(found["total"] - 3 * matrix.sum() - 900).max() < 1e-12
    lower = np.linalg.inv([[2, 0, 0], [1, 4, 0], [-1, 3, 5]])[2]
    exact = lower[0] * found["time"] + lower[1] + 2 * lower[2]
    assert np.abs(found["z[3]"] - exact).max() < 1e-12


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_a_loop_with_a_hybrid_fmu_has_modes_and_margins(tmp_path, version):
    """A limited servo, linear within its limits, against its characteristic polynomial."""
    fmu = made(tmp_path, """
model M
  parameter Real d = 0.4;
  input Real u(start=0);
  output Real x(start=0, fixed=true);
  Real v(start=0, fixed=true);
  Real force;
  Real load(start=0);
equation
  force = if u > 10 then 10 elseif u < -10 then -10 else u;
  load + 0.1*load^3 = 3*x;
  der(x) = v;
  der(v) = force - d*v - load;
  when x > 100 then
    reinit(v, 0);
  end when;
end M;
""", version)  # fmt: skip
    description = fmpy.read_model_description(fmu, validate=True)
    assert not fmpy.validation.validate_fmu(str(fmu)), description.modelName
    config = {
        "run": {"master": "jacobi", "step_size": "1 ms", "stop_time": "1 s"},
        "instances": {"servo": {"fmu": str(fmu)}},
        "connections": [{"from": [{"port": "servo.x", "gain": -2.0}], "to": "servo.u"}],
    }
    loop = orc.linearise(config)
    roots = np.roots([1, 0.4, 5])
    found = loop.modes().modes[0]
    assert found.frequency == pytest.approx(abs(roots[0]) / (2 * math.pi), rel=1e-6)
    assert found.damping == pytest.approx(-roots[0].real / abs(roots[0]), rel=1e-6)


@pytest.mark.parametrize("step", [2.0, 1.0, 0.3, 0.01])
@pytest.mark.parametrize("clock", ["time", "x"])
def test_no_oscillation_hides_within_a_long_step(tmp_path, step, clock):
    fmu = made(
        tmp_path,
        f"""
model M
  output Real x(start=0, fixed=true);
  output Integer n(start=0, fixed=true);
  output Integer halves(start=0, fixed=true);
equation
  der(x) = 1;
  when sin(20*3.141592653589793*{clock}) > 0.5 then
    n = pre(n) + 1;
  end when;
  when mod({clock}, 0.5) > 0.4523 then
    halves = pre(halves) + 1;
  end when;
end M;
""",
    )
    found = run(fmu, 2.1, step, "n", "halves")
    times = found["time"]
    # The sine exceeds 0.5 from 1/120 s on in each period of 0.1 s.
    assert list(found["n"]) == list(np.floor((times - 1 / 120) / 0.1 + 1 + 1e-9))
    assert list(found["halves"]) == list(np.floor((times - 0.4523) / 0.5 + 1 + 1e-9))


@pytest.mark.parametrize("step", [60.0, 0.5])
def test_no_tip_of_an_oscillation_hides_within_a_step(tmp_path, step):
    """Of an oscillation that long explicit steps integrate, and that passes levels for 1 s to 3 ms."""
    fmu = made(
        tmp_path,
        """
model M
  Real x(start=0, fixed=true), v(start=1, fixed=true);
  output Integer n[4](each start=0, each fixed=true);
  parameter Real level[4] = {0.9, 0.99, 0.999, 0.999999};
equation
  der(x) = v;
  der(v) = -x;
  for i in 1:4 loop
    when x > level[i] then
      n[i] = pre(n[i]) + 1;
    end when;
  end for;
end M;
""",
    )
    found = run(fmu, 60.0, step, *(f"n[{k}]" for k in range(1, 5)))
    tips = math.floor((60.0 - math.pi / 2) / (2 * math.pi)) + 1
    assert [int(found[f"n[{k}]"][-1]) for k in range(1, 5)] == [tips] * 4


def test_a_tick_is_a_value_that_other_components_see(tmp_path):
    """As blocks of sampled systems have it: the tick is a variable, a port, and part of a condition."""
    fmu = made(tmp_path, """
package P
  connector Truth = Boolean;
  connector TruthOut = output Boolean;
  connector TruthIn = input Boolean;
  block Clocked
    TruthOut tick;
  equation
    tick = sample(0.1, 0.2);
  end Clocked;
  block Hold
    TruthIn go;
    output Integer n(start=0, fixed=true);
    output Real y(start=0, fixed=true);
    output Integer late(start=0, fixed=true);
    parameter Boolean on = true;
  equation
    when go then
      n = pre(n) + 1;
    end when;
    when {go and time > 0.4, initial()} then
      y = time;
    end when;
    when not go then
      late = pre(late) + 1;
    end when;
  end Hold;
  model M
    Clocked c;
    Hold h;
    Real x(start=0, fixed=true);
    Boolean seen = c.tick and on;
    parameter Boolean on = true;
  equation
    connect(c.tick, h.go);
    der(x) = h.n;
  end M;
end P;
""", model="P.M")  # fmt: skip
    found = run(fmu, 1.0, 0.05, "h.n", "h.y", "h.late", "x", "c.tick", "seen")
    time = found["time"]
    count = np.floor((time - 0.1) / 0.2 + 1e-6) + 1
    assert (found["h.n"] == count).all()
    assert np.abs(found["h.y"] - np.where(count > 2, 0.2 * count - 0.1, 0)).max() < 1e-9
    assert not found["c.tick"].any() and not found["seen"].any()
    exact = [sum(max(0.0, now - 0.1 - 0.2 * k) for k in range(6)) for now in time]
    assert np.abs(found["x"] - exact).max() < 1e-9
    assert (found["h.late"] == count).all()


def test_functions_with_several_results_and_records_and_loops_over_elements(tmp_path):
    fmu = made(
        tmp_path,
        """
model M
  record Pair
    Real a;
    Real b;
  end Pair;
  function both
    input Real u;
    output Real s;
    output Real c;
  algorithm
    s := sin(u);
    c := cos(u);
  end both;
  function pair
    input Real u;
    output Pair p;
  algorithm
    p.a := u;
    p.b := 2*u;
  end pair;
  Pair p;
  Real e[3];
  output Real s;
  output Real c;
  output Real y;
  output Real z;
equation
  (s, c) = both(time);
  p = pair(time);
  y = p.a - p.b^2;
algorithm
  z := 0;
  for i in 1:3 loop
    e[i] := i*time;
    z := z + e[i];
  end for;
end M;
""",
    )
    found = run(fmu, 1.0, 0.1, "s", "c", "y", "z")
    time = found["time"]
    for name, exact in (
        ("s", np.sin(time)),
        ("c", np.cos(time)),
        ("y", time - 4 * time**2),
        ("z", 6 * time),
    ):
        assert found[name] == pytest.approx(exact, abs=1e-12)


def test_initial_among_the_conditions_of_a_when_holds_at_the_start(tmp_path):
    fmu = made(
        tmp_path,
        """
model M
  output Real k(start=0);
  output Real x(start=0, fixed=true);
equation
  der(x) = k;
  when {initial(), time >= 0.5} then
    k = if time < 0.4 then 2 else 5;
  end when;
end M;
""",
    )
    found = run(fmu, 1.0, 0.1, "x")
    exact = np.where(found["time"] < 0.5, 2 * found["time"], 1 + 5 * (found["time"] - 0.5))
    assert found["x"] == pytest.approx(exact, abs=1e-9)


def test_a_start_value_of_an_alias_holds(tmp_path):
    """Of equal variables the one that gives the start value may not be the one that stays."""
    fmu = made(tmp_path, """
model M
  Real a;
  Real b(start=4, fixed=true);
  Real c;
  Integer n(start=0, fixed=true);
equation
  der(a) = -a;
  b = -a;
  c = b - a + time + 10;
  when a > -1 then
    n = pre(n) + 1;
  end when;
end M;
""")  # fmt: skip
    found = run(fmu, 1.0, 0.1, "a", "b", "c")
    exact = 4 * np.exp(-found["time"])
    assert np.abs(found["b"] - exact).max() < 1e-8
    assert np.abs(found["c"] - 2 * exact - found["time"] - 10).max() < 1e-8


AMPLIFIER = """
  parameter Real gain = 1000;
  Real u = 3*sin(time);
  Real v, y;
equation
  v = (15*u + y)/16;
"""


def test_equations_with_limits_and_positive_feedback_change_from_one_state_to_the_other(tmp_path):
    """A Schmitt trigger: it holds y until its characteristic has no solution on that side."""
    fmu = made(tmp_path, f"""
model M{AMPLIFIER}
  y = homotopy(if gain*v > 15 then 15 else if gain*v < -15 then -15 else gain*v, -15);
end M;
""")  # fmt: skip
    found = run(fmu, 12.0, 0.05, "y")
    state, expected = -1, []
    for now in found["time"]:
        if 3 * math.sin(now) * state < -(1 - 16 / 1000):
            state = -state
        expected.append(15.0 * state)
    assert found["y"] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("step", (0.5, 0.01))
def test_a_solution_that_ends_without_an_event_is_followed_by_another(tmp_path, step):
    """A comparator with hysteresis whose limits, min and max, make no events.

    y is -15 until vp = -0.001, at x = 1 - 0.001*16/15, and 15 after that.
    """
    text = """
model M
  parameter Real k = 1/15;
  Real x(start=-5, fixed=true), vp, y(start=-15), q(start=0, fixed=true);
equation
  der(x) = 10;
  vp = (x + k*y)/(1 + k);
  y = min(15, max(-15, 15000*vp));
  der(q) = y;
end M;
"""
    found = run(made(tmp_path, text), 1.0, step, "y", "q")
    switched = (6 - 0.001 * 16 / 15) / 10
    assert found["y"][-1] == 15
    assert found["q"][-1] == pytest.approx(15 * (1 - 2 * switched), rel=1e-7)


def test_homotopy_chooses_the_solution_that_the_model_starts_from(tmp_path):
    for start in (15, -15):
        fmu = made(tmp_path, f"""
model M{AMPLIFIER}
  y = homotopy(smooth(0, noEvent(if gain*v > 15 then 15 else if gain*v < -15 then -15 else gain*v)), {start});
end M;
""")  # fmt: skip
        found = run(fmu, 0.25, 0.05, "y")
        assert found["y"] == pytest.approx(start, abs=1e-9)


def test_many_states_are_integrated_with_sparse_matrices(tmp_path):
    """A grid of 6 x 6 bodies, each a node of a heat equation, against scipy."""
    fmu = made(tmp_path, """
model M
  parameter Real k = 50;
  Real T[6, 6](each start=0, each fixed=true);
  Real q[6, 6] = {{T[i, j]^4 for j in 1:6} for i in 1:6};
  Boolean late(start=false, fixed=true);
equation
  for i in 1:6 loop
    for j in 1:6 loop
      der(T[i, j]) = k*((if i > 1 then T[i - 1, j] else 1) + (if i < 6 then T[i + 1, j] else 0)
        + (if j > 1 then T[i, j - 1] else 0) + (if j < 6 then T[i, j + 1] else 0.5) - 4*T[i, j]) - 10*q[i, j];
    end for;
  end for;
  when time > 10 then
    late = true;
  end when;
end M;
""")  # fmt: skip
    names = [f"T[{i},{j}]" for i in range(1, 7) for j in range(1, 7)]
    found = run(fmu, 0.1, 0.02, *names)

    def slopes(_, y):
        padded = np.zeros((8, 8))
        padded[1:-1, 1:-1] = grid = y.reshape(6, 6)
        padded[0], padded[:, -1] = 1, 0.5
        around = padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:]
        return (50 * (around - 4 * grid) - 10 * grid**4).ravel()

    exact = solve_ivp(slopes, (0, 0.1), np.zeros(36), "Radau", t_eval=found["time"], rtol=1e-10, atol=1e-12).y
    assert np.stack([found[one] for one in names]) == pytest.approx(exact, abs=1e-8)


def test_colours_and_factors_of_a_matrix():
    n = 24
    generator = np.random.default_rng(3)
    filled = (generator.random((n, n)) < 0.06) | np.eye(n, dtype=bool)
    columns = [list(np.flatnonzero(filled[:, k])) for k in range(n)]
    colours = colours_of(columns)
    assert max(colours) < n - 1
    for one in set(colours):
        assert (filled[:, np.equal(colours, one)].sum(axis=1) <= 1).all()
    factors = factors_of(columns)
    assert factors is not None and len(factors.columns) < n * n / 2
    matrix = np.where(filled, generator.random((n, n)), 0) + 5 * np.eye(n)
    values = np.zeros(len(factors.columns))
    values[factors.entries] = [matrix[row, column] for column, rows in enumerate(columns) for row in rows]
    placed = np.zeros((n, n))
    for row in range(n):
        here = slice(factors.starts[row], factors.starts[row + 1])
        placed[row, factors.columns[here]] = values[here]
        assert factors.columns[factors.diagonals[row]] == row
    assert (placed == matrix[np.ix_(factors.order, factors.order)]).all()
    for k in range(n):  # no factor outside the places
        for row in range(k + 1, n):
            if placed[row, k]:
                placed[row, k] /= placed[k, k]
                placed[row, k + 1 :] -= placed[row, k] * placed[k, k + 1 :]
    starts = factors.starts
    kept = {(row, factors.columns[e]) for row in range(n) for e in range(starts[row], starts[row + 1])}
    assert {(int(a), int(b)) for a, b in np.argwhere(placed)} <= kept


def test_a_relation_that_only_rounding_decides_is_no_chattering(tmp_path):
    """y equals x but for rounding, which differs from instant to instant."""
    text = """
model M
  Real x(start=0.1, fixed=true), y;
  Boolean above(start=false, fixed=true);
  Integer steps(start=0, fixed=true);
equation
  der(x) = 1 + (if above then 1e-3 else 1e-3);
  y = 0.1*x + 0.2*x + 0.7*x;
  above = y > x;
  steps = integer(2*x);
end M;
"""
    found = run(made(tmp_path, text), 1.0, 0.25, "x", "steps")
    np.testing.assert_allclose(found["x"], 0.1 + 1.001 * found["time"], rtol=1e-9)
    np.testing.assert_array_equal(found["steps"], np.floor(2 * found["x"]))


def test_a_subscript_that_a_condition_keeps_within_an_array(tmp_path):
    """The loop stops at the first difference, so that its guard is not known when the model is built."""
    text = """
model M
  function same
    input Real a[:], b[:];
    output Boolean found = true;
  protected
    Integer i = 1;
  algorithm
    while i <= size(a, 1) loop
      if abs(a[i] - b[i]) > 1e-9 then
        found := false;
        i := size(a, 1);
      end if;
      i := i + 1;
    end while;
  end same;
  parameter Real p[3] = {1, 2, 3};
  Real x(start=0, fixed=true);
equation
  der(x) = if same(p, {1, 2, 3}) then 1 else 2;
end M;
"""
    fmu = made(tmp_path, text)
    assert run(fmu, 1.0, 1.0, "x")["x"][-1] == pytest.approx(1, rel=1e-9)
    other = run(fmu, 1.0, 1.0, "x", start_values={"p[3]": 4.0})
    assert other["x"][-1] == pytest.approx(2, rel=1e-9)


def test_no_equation_is_solved_for_what_a_zero_parameter_multiplies(tmp_path):
    """A body turned about e = (0, 0, 1): two of three equations for its acceleration say 0 = 0."""
    text = """
model M
  parameter Real e[3] = {0, 0, 1};
  Real w(start=1, fixed=true), v[3], t[3];
equation
  v = e*w;
  2*der(v) = t;
  e*t = -w;
end M;
"""
    found = run(made(tmp_path, text), 1.0, 1.0, "w", "v[3]")
    assert found["w"][-1] == pytest.approx(math.exp(-0.5), rel=1e-7)
    assert found["v[3]"][-1] == pytest.approx(math.exp(-0.5), rel=1e-7)


def test_a_length_follows_from_its_components_where_one_of_them_is_zero(tmp_path):
    """A mass on a spring and damper along the first axis: (s - 1/2)'' = -(s - 1/2) - 0.2 s'."""
    text = """
model M
  constant Real e[2, 2] = [1, 0; 0, 1];
  Real x[2](start={1, 0}, each fixed=true), v[2](start={0, 0}, each fixed=true);
  Real r[2], turn[2, 2], length, s;
equation
  {1, 1} = {turn[1, 1], turn[2, 2]};
  {turn[1, 2], turn[2, 1]} = {0, 0};
  r = turn*x;
  length = sqrt(r*r);
  s = if length > 1e-10 then length else 1e-10;
  der(x) = v;
  der(v) = -(s - 0.5 + 0.2*der(s))*r/s;
end M;
"""
    found = run(made(tmp_path, text), 2.0, 0.5, "s", "x[2]")
    rate = math.sqrt(1 - 0.01)
    t = found["time"]
    exact = 0.5 + 0.5 * np.exp(-0.1 * t) * (np.cos(rate * t) + 0.1 / rate * np.sin(rate * t))
    np.testing.assert_allclose(found["s"], exact, rtol=1e-6)
