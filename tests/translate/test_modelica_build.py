"""Whole FMUs from Modelica text: description, simulation against closed forms, reproducible bytes."""

from __future__ import annotations

import shutil
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Callable
from pathlib import Path

import build_extra  # noqa: F401
import fmpy
import modelica_bench as bench
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu
from scipy.integrate import solve_ivp

from orchestrator.cli.main import main
from orchestrator.translate.build import build
from orchestrator.translate.declared_units import derivative_unit
from orchestrator.translate.package import compile_library

HERE = {"linux64": "x86_64-linux", "win64": "x86_64-windows", "darwin64": "x86_64-darwin"}.get(
    fmpy.platform, ""
)
VERSIONS = ("2.0", "3.0")


@pytest.fixture(scope="module")
def fmu(tmp_path_factory) -> Callable[..., Path]:
    """Build a model from its body, for this platform only, once."""
    built: dict[tuple[str, str], Path] = {}

    def make(body: str, fmi_version: str = "2.0") -> Path:
        key = (body, fmi_version)
        if key not in built:
            folder = tmp_path_factory.mktemp("model")
            path = bench.model_file(folder, f'model Model "A model"\n{body}\nend Model;\n')
            build(path, folder / "Model.fmu", fmi_version=fmi_version, platforms=(HERE,))
            built[key] = folder / "Model.fmu"
        return built[key]

    return make


EVERYTHING = """
constant Real c(unit="1") = 3;
parameter Real p(unit="N/m", min=0) = 2 "Stiffness";
parameter Real omega(unit="rad/s", displayUnit="Hz", quantity="AngularVelocity") = 6;
parameter Real q(unit="N/m") = 2*p;
parameter Integer n(min=1, max=5) = 2;
parameter Boolean on = true;
parameter Real tau(unit="s", min=0.1) = 0.2;
parameter Real lag(unit="s", min=0) = 0;
input Real u(unit="m", start=1.5);
output Real direct(unit="N");
output Real late(unit="m");
output Real lagging(unit="m");
output Boolean above;
output Integer count;
output Real x(unit="m", start=0.5, fixed=true, nominal=if p > 1 then 5*p else 1);
Real y(unit="m/s", start=q, fixed=true);
Real w[2](each unit="m");
equation
direct = p*u + (if on then 0 else q*u);
late = delay(u, tau) + x;
lagging = delay(u, lag);
above = u > x;
count = if above then n else 0;
der(x) = y;
der(y) = -omega^2*x;
w = {x, u};
annotation(experiment(StartTime=0, StopTime=2, Tolerance=1e-6, Interval=0.01));
"""


@pytest.mark.parametrize("version", VERSIONS)
def test_model_description(fmu, version):
    path = fmu(EVERYTHING, version)
    assert validate_fmu(str(path)) == []
    description = fmpy.read_model_description(str(path))
    assert (description.modelName, description.description) == ("Model", "A model")
    experiment = description.defaultExperiment
    assert (float(experiment.stopTime), float(experiment.tolerance), float(experiment.stepSize)) == (
        2,
        1e-6,
        0.01,
    )
    assert description.generationDateAndTime is None
    options = description.coSimulation
    assert options.canHandleVariableCommunicationStepSize
    text = (zipfile.ZipFile(path)).read("modelDescription.xml").decode()
    assert f'providesDirectionalDerivative{"" if version == "2.0" else "s"}="true"' in text
    assert options.canGetAndSetFMUstate and options.canSerializeFMUstate
    found = {
        v.name: (
            v.type.replace("Float64", "Real").replace("Int32", "Integer"),
            v.causality,
            v.variability,
            v.initial,
            v.start,
        )
        for v in description.modelVariables
    }
    assert found == {
        "time": ("Real", "independent", "continuous", None, None),
        "c": ("Real", "local", "constant", "exact", "3.0"),
        "p": ("Real", "parameter", "fixed", "exact", "2.0"),
        "omega": ("Real", "parameter", "fixed", "exact", "6.0"),
        "q": ("Real", "calculatedParameter", "fixed", "calculated", None),
        "n": ("Integer", "parameter", "fixed", "exact", "2"),
        "on": ("Boolean", "parameter", "fixed", "exact", "true"),
        "tau": ("Real", "parameter", "fixed", "exact", "0.2"),
        "lag": ("Real", "parameter", "fixed", "exact", "0.0"),
        # fmpy fills in what FMI prescribes for inputs of FMI 2.0 only.
        "u": ("Real", "input", "continuous", found["u"][3], "1.5"),
        "direct": ("Real", "output", "continuous", "calculated", None),
        "late": ("Real", "output", "continuous", "calculated", None),
        "lagging": ("Real", "output", "continuous", "calculated", None),
        "above": ("Boolean", "output", "discrete", "calculated", None),
        "count": ("Integer", "output", "discrete", "calculated", None),
        "x": ("Real", "output", "continuous", "exact", "0.5"),
        "y": ("Real", "local", "continuous", "calculated", None),
        "w[1]": ("Real", "local", "continuous", "calculated", None),
        "w[2]": ("Real", "local", "continuous", "calculated", None),
        "der(x)": ("Real", "local", "continuous", "calculated", None),
        "der(y)": ("Real", "local", "continuous", "calculated", None),
    }
    variables = {v.name: v for v in description.modelVariables}
    assert variables["p"].description == "Stiffness" and float(variables["p"].min) == 0
    assert (variables["n"].min, variables["n"].max) == ("1", "5")
    assert float(variables["x"].nominal) == 10 and variables["der(y)"].unit == "m/s2"
    assert variables["omega"].displayUnit == "Hz" and variables["omega"].quantity == "AngularVelocity"
    assert variables["der(x)"].derivative.name == "x"
    units = {unit.name: unit for unit in description.unitDefinitions}
    assert (units["N/m"].baseUnit.kg, units["N/m"].baseUnit.s, units["N/m"].baseUnit.m) == (1, -2, 0)
    assert (units["rad/s"].baseUnit.rad, units["rad/s"].baseUnit.s) == (1, -1)
    assert units["rad/s"].displayUnits[0].factor == pytest.approx(1 / (2 * np.pi), rel=1e-15)


@pytest.mark.parametrize("version", VERSIONS)
def test_model_structure(fmu, version):
    description = fmpy.read_model_description(str(fmu(EVERYTHING, version)))

    def table(unknowns):
        return {
            unknown.variable.name: dict(
                zip(
                    (known.name for known in unknown.dependencies),
                    unknown.dependenciesKind or [""] * len(unknown.dependencies),
                    strict=True,
                )
            )
            for unknown in unknowns
        }

    assert table(description.outputs) == {
        "direct": {"u": "fixed"},
        "late": {"x": "constant"},  # its delay cannot be zero
        "lagging": {"u": "dependent"},
        "above": {"u": "dependent", "x": "dependent"},
        "count": {"u": "dependent", "x": "dependent"},
        "x": {"x": "constant"},
    }
    assert table(description.derivatives) == {"der(x)": {"y": "constant"}, "der(y)": {"x": "fixed"}}
    initial = {name: set(knowns) for name, knowns in table(description.initialUnknowns).items()}
    assert initial == {
        "q": {"p"},
        "direct": {"p", "on", "u"},
        "late": {"tau", "u", "x"},
        "lagging": {"lag", "u"},
        "above": {"u", "x"},
        "count": {"n", "u", "x"},
        "y": {"p"},
        "der(x)": {"p"},
        "der(y)": {"omega", "x"},
    }


@pytest.mark.parametrize("version", VERSIONS)
def test_values_of_every_type(fmu, version):
    with bench.instance(fmu(EVERYTHING, version), p=5.0, n=4, on=False) as item:
        assert item.get("q", "direct", "above", "count", "y", "w[2]", "c") == [
            10,
            5 * 1.5 + 15,
            True,
            4,
            10,
            1.5,
            3,
        ]
        item.set({"u": -1.0})
        assert item.get("above", "count", "lagging") == [False, 0, -1.0]
        item.step(0.1)
        position = 0.5 * np.cos(0.6) + 10 / 6 * np.sin(0.6)
        assert item.get("x")[0] == pytest.approx(position, abs=1e-8)
        assert item.derivative("direct", "u") == 15.0
        assert item.derivative("der(y)", "x") == -36.0


# Delays ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("tau", [0.0, 0.01, 0.0123, 0.25])
def test_delayed_lag_is_the_closed_form(fmu, version, tau):
    path = fmu(
        "parameter Real tau = 0;\noutput Real x(start=0, fixed=true);\noutput Real late;\nequation\n"
        "late = delay(sin(5*time), tau);\nder(x) = 20*(late - x);",
        version,
    )
    with bench.instance(path, tau=tau) as item:
        found = []
        for _ in range(50):
            item.step(0.01)
            found.append([item.time, *item.get("late", "x")])
    time, late, x = np.array(found).T
    moved = np.maximum(time - tau, 0.0)
    np.testing.assert_allclose(late, np.sin(5 * moved), rtol=0, atol=1e-7)
    # x' = 20 (sin(5 t) - x), x(0) = 0, shifted by tau.
    exact = 20 * (20 * np.sin(5 * moved) - 5 * np.cos(5 * moved) + 5 * np.exp(-20 * moved)) / (20**2 + 5**2)
    np.testing.assert_allclose(x, exact, rtol=0, atol=1e-7)


def test_a_delay_that_depends_on_a_state(fmu):
    path = fmu(
        "output Real s(start=0.1, fixed=true);\noutput Real late;\nequation\nder(s) = -0.5*s;\n"
        "late = delay(time^2, s, 0.2);"
    )
    with bench.instance(path) as item:
        for _ in range(40):
            item.step(0.013)
            s, late = item.get("s", "late")
            assert s == pytest.approx(0.1 * np.exp(-0.5 * item.time), abs=1e-9)
            assert late == pytest.approx(max(item.time - s, 0.0) ** 2, abs=1e-7)


def test_delays_in_series_and_in_a_loop(fmu):
    path = fmu(
        "output Real x(start=1, fixed=true);\noutput Real twice;\nequation\nder(x) = -delay(x, 0.3);\n"
        "twice = delay(delay(x, 0.1), 0.15);"
    )

    def history(t: float) -> float:
        # Method of steps for x' = -x(t - 0.3), x = 1 before: a polynomial on every interval.
        total, k = 0.0, 0
        while t - (k - 1) * 0.3 > 0 or k == 0:
            total += (-1) ** k * max(t - (k - 1) * 0.3, 0.0) ** k / np.prod(range(1, k + 1))
            k += 1
        return total if t > 0 else 1.0

    with bench.instance(path) as item:
        for _ in range(90):
            item.step(0.0171)
            x, twice = item.get("x", "twice")
            assert x == pytest.approx(history(item.time), abs=1e-7)
            assert twice == pytest.approx(history(item.time - 0.25), abs=1e-7)


# Events ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("step", [0.05, 0.0173])
def test_contact_onset_is_an_event(fmu, step):
    """A mass against a stiff spring: the bounce ends with the energy it began with, whatever the step."""
    path = fmu(
        "output Real x(start=-0.01, fixed=true);\noutput Real v(start=1, fixed=true);\nequation\n"
        "der(x) = v;\n"
        "der(v) = if x > 0 then -1e6*x else 0;"
    )
    with bench.instance(path) as item:
        for _ in range(int(0.2 / step)):
            item.step(step)
        assert item.get("v")[0] == pytest.approx(-1.0, abs=1e-7)
        # Half a period in contact: pi/omega, then straight back.
        assert item.get("x")[0] == pytest.approx(-(item.time - 0.01 - np.pi / 1000), abs=1e-8)


def test_relations_of_time_switch_on_time(fmu):
    path = fmu("output Real x(start=0, fixed=true);\nequation\nder(x) = if time >= 0.0123 then 1 else 0;")
    with bench.instance(path) as item:
        item.step(0.1)
        assert item.get("x")[0] == pytest.approx(0.1 - 0.0123, abs=1e-10)


def test_a_linear_loop_with_a_friction_like_switch(fmu):
    path = fmu(
        "output Real x(start=0, fixed=true);\nReal a;\nReal b;\nequation\n"
        "der(x) = a;\na + b = 2*cos(3*time);\n"
        "a - 3*b = if x > 0.2 then -x else x;"
    )

    def slope(t, x):
        return (6 * np.cos(3 * t) + (-x if x > 0.2 else x)) / 4

    solution = solve_ivp(slope, (0, 2), [0.0], rtol=1e-10, atol=1e-12, max_step=1e-3)
    with bench.instance(path) as item:
        for _ in range(40):
            item.step(0.05)
        assert item.get("x")[0] == pytest.approx(solution.y[0, -1], abs=2e-6)


@pytest.mark.parametrize("version", VERSIONS)
def test_inputs_of_every_type(fmu, version):
    path = fmu(
        "input Boolean on;\ninput Integer n(start=1);\noutput Real x(start=0, fixed=true);\noutput Real y;\n"
        "equation\nder(x) = if on then n else -1;\ny = if on and n > 2 then 10 else n;",
        version,
    )
    with bench.instance(path) as item:
        for on, n, x, y in ((False, 1, -0.5, 1), (True, 2, 0.5, 2), (True, 3, 2.0, 10)):
            item.set({"on": on, "n": n})
            item.step(0.5)
            assert item.get("x", "y") == [pytest.approx(x, abs=1e-12), y]


# Assertions ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("version", VERSIONS)
def test_assertions_end_the_run(fmu, version):
    path = fmu(
        "output Real x(start=0, fixed=true);\nequation\n"
        'der(x) = 1;\nassert(x < 0.25, "too far: " + String(x));\n'
        'assert(x < 0.1, "far", AssertionLevel.warning);',
        version,
    )
    with zipfile.ZipFile(path) as archive:
        code = archive.read("sources/model.c").decode()
    assert '{"too far: [x] (Model.mo:5)", "far (Model.mo:6)"}' in code
    assert "model_assertion_is_error[] = {1, 0}" in code
    with pytest.raises(FMICallException), bench.instance(path) as item:
        for _ in range(5):
            item.step(0.1)
    assert item.time == pytest.approx(0.2)


# Packing ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("version", VERSIONS)
def test_the_same_sources_give_the_same_bytes(tmp_path, version):
    text = "model Model\nparameter Real p = 1;\ninput Real u;\noutput Real y;\nequation\n"
    text += "y = delay(p*u, 0.1);\nend Model;\n"
    built = []
    for folder, end in (("one", "\n"), ("another/place", "\r\n")):
        (tmp_path / folder).mkdir(parents=True)
        path = bench.model_file(tmp_path / folder, "")
        path.write_bytes(text.replace("\n", end).encode())
        built.append(tmp_path / folder / "Model.fmu")
        build(path, built[-1], fmi_version=version, platforms=(HERE,))
    assert built[0].read_bytes() == built[1].read_bytes()
    changed = bench.model_file(tmp_path, text.replace("p = 1", "p = 2"))
    build(changed, tmp_path / "Model.fmu", fmi_version=version, platforms=())
    tokens = {fmpy.read_model_description(str(path)).guid for path in (built[0], tmp_path / "Model.fmu")}
    assert len(tokens) == 2
    content = built[0].read_bytes()
    assert str(tmp_path).encode() not in content


@pytest.mark.parametrize("version", VERSIONS)
def test_the_sources_in_the_fmu_compile_to_its_binary(fmu, tmp_path, version):
    path = fmu("input Real u;\noutput Real y;\nequation\ny = 2*u;", version)
    folder = tmp_path / "unpacked"
    with zipfile.ZipFile(path) as archive:
        archive.extractall(folder)
        binaries = [name for name in archive.namelist() if name.startswith("binaries/")]
    xml, tag = (
        ("modelDescription.xml", "File")
        if version == "2.0"
        else ("sources/buildDescription.xml", "SourceFile")
    )
    listed = [element.get("name") for element in ET.parse(folder / xml).iter(tag)]
    assert sorted(listed) == sorted(file.name for file in (folder / "sources").glob("*.c"))
    rebuilt = compile_library(folder / "sources", "Model", version, (HERE,))
    assert rebuilt[HERE] == (folder / binaries[0]).read_bytes()


def test_documentation_shows_equations_and_ports(fmu):
    with zipfile.ZipFile(
        fmu('input Real u(unit="m") "Way & <more>";\noutput Real y;\nequation\ny = delay(u, 0.1);')
    ) as archive:
        page = archive.read("documentation/index.html").decode()
    assert "<td>u</td><td>m</td><td>0</td><td>Way &amp; &lt;more&gt;</td>" in page
    assert "y = delay(u, 0.1);" in page


def test_command_line(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(bench.ROOT / "modelica" / "DockingHIL", "DockingHIL")
    command = [
        "build",
        "DockingHIL/package.mo",
        "--model",
        "ForceSensor",
        "--platforms",
        "none",
        "--fmi",
        "3.0",
    ]
    assert main(command) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[:2] == [
        "ForceSensor.fmu: DockingHIL.ForceSensor, FMI 3.0 co-simulation",
        "  1 state, 1 input, 1 output, 3 parameters, 1 delay",
    ]
    assert lines[2].startswith("  checked at 40 random points, largest relative residual ")
    assert fmpy.read_model_description("ForceSensor.fmu").fmiVersion == "3.0"
    command[command.index("--platforms") : command.index("--fmi")] = []
    assert main(command) == 0
    assert f"  binaries: {HERE}" in capsys.readouterr().out.splitlines()
    Path("model.txt").write_text("")
    assert main(["build", "model.txt"]) == 1
    assert capsys.readouterr().err == (
        "orchestrator: model.txt: cannot recognise the kind of this model; give a .mo or a .py file\n"
    )


@pytest.mark.parametrize(
    ("unit", "derivative"),
    [("m", "m/s"), ("m/s", "m/s2"), ("N/m", "N/(m.s)"), ("degC", "K/s"), ("degF", ""), ("", "")],
)
def test_a_derivative_has_a_unit_that_can_be_read(unit: str, derivative: str) -> None:
    """A rate of change of a temperature has no origin."""
    assert derivative_unit(unit) == derivative
