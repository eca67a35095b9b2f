"""What holds for every Python FMU: packaging, FMU state, golden signals."""

from __future__ import annotations

import html
import subprocess
import sys
import zipfile
from pathlib import Path

import fmpy
import golden
import pytest
from conftest import FMUS, load_model
from fmpy.validation import validate_fmu
from lxml import etree

from orchestrator.base.errors import BuildError
from orchestrator.base.units import parse_unit
from orchestrator.translate.python_fmu import build_python_fmu, main

NAMES = tuple(golden.INPUTS)
FORMS = pytest.mark.parametrize("form", ["", "-native"], ids=["python", "native"])


def test_every_python_model_is_covered():
    covered = (*NAMES, *golden.ENGINES)
    assert sorted(path.parent.name for path in FMUS.glob("*/model.py")) == sorted(covered)


@pytest.mark.parametrize("name", NAMES)
def test_rebuilding_gives_the_shipped_bytes(name, tmp_path):
    shipped = FMUS / name / f"{name}.fmu"
    rebuilt = build_python_fmu(FMUS / name / "model.py", tmp_path / f"{name}.fmu")
    if rebuilt.read_bytes() != shipped.read_bytes():
        changed = sorted({member for member, _ in _members(rebuilt).items() ^ _members(shipped).items()})
        pytest.fail(f"{name}.fmu is not what its model.py gives; members that differ: {changed}")


def test_the_command_line_rebuilds_models_in_place(tmp_path, capsys):
    folder = tmp_path / "SatelliteDynamics"
    folder.mkdir()
    source = (FMUS / "SatelliteDynamics" / "model.py").read_bytes()
    (folder / "model.py").write_bytes(source.replace(b"\n", b"\r\n"))
    assert main([str(tmp_path)]) == 0
    built = folder / "SatelliteDynamics.fmu"
    assert capsys.readouterr().out == f"{built}\n"
    assert built.read_bytes() == (FMUS / "SatelliteDynamics" / "SatelliteDynamics.fmu").read_bytes()


@pytest.mark.parametrize("name", NAMES)
def test_model_description(name):
    path = FMUS / name / f"{name}.fmu"
    assert validate_fmu(str(path)) == []
    description = fmpy.read_model_description(str(path))
    options = description.coSimulation
    assert description.generationDateAndTime is None
    assert options.canGetAndSetFMUstate and options.canSerializeFMUstate
    assert options.canHandleVariableCommunicationStepSize
    assert not options.canBeInstantiatedOnlyOncePerProcess
    units = {unit.name: unit for unit in description.unitDefinitions}
    for variable in description.modelVariables:
        assert variable.description, variable.name
        if variable.type == "Real":
            base = units[variable.unit].baseUnit
            declared = tuple(
                getattr(base, symbol) for symbol in ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
            )
            assert declared == parse_unit(variable.unit).exponents, variable.name
            assert base.factor == parse_unit(variable.unit).factor == 1, variable.name
    outputs = [variable for variable in description.modelVariables if variable.causality == "output"]
    assert [unknown.variable.name for unknown in description.outputs] == [
        variable.name for variable in outputs
    ]
    # Those that move feed no input through within a communication point; the loops they stand in could
    # otherwise not be ordered. Those that only convert feed all through.
    feeds = name in golden.ALGEBRAIC
    assert all(bool(unknown.dependencies) is feeds for unknown in description.outputs)
    assert all(variable.start is not None for variable in outputs if variable.initial == "exact")
    initial = {unknown.variable.name: unknown for unknown in description.initialUnknowns}
    assert initial.keys() == {variable.name for variable in outputs if variable.initial == "calculated"}


@pytest.mark.parametrize("name", NAMES)
def test_archive_tells_where_it_runs_and_nothing_of_where_it_was_built(name):
    members = _members(FMUS / name / f"{name}.fmu")
    requirements = members["resources/requirements.txt"].decode().split()
    page = members["documentation/index.html"].decode()
    etree.fromstring(page.split("\n", 1)[1], etree.HTMLParser(recover=False))
    assert all(f"<code>{html.escape(package)}</code>" in page for package in requirements)
    assert b"MIT" in members["documentation/licenses/pythonfmu.txt"]
    for member, content in members.items():
        assert str(FMUS.parent).encode() not in content, member
        assert b"/tmp/" not in content, member


@FORMS
@pytest.mark.parametrize("name", NAMES)
def test_golden_signals(name, form, instantiate):
    rows = golden.read(name)
    instance = instantiate(name, form).initialise(**golden.START[name])
    for index, row in enumerate(rows):
        instance.set(**{signal: row[signal] for signal in golden.INPUTS[name]})
        if index:
            instance.fmu.doStep(rows[index - 1]["time"], golden.STEP)
        for signal, (tolerance, _) in golden.OUTPUTS[name].items():
            (value,) = instance.get(signal)
            assert abs(value - row[signal]) <= tolerance, (row["time"], signal, value, row[signal])


@pytest.mark.parametrize("name", NAMES)
def test_fmu_and_model_in_process_agree_bit_for_bit(name, instantiate):
    rows = golden.read(name)
    expected = golden.replay(name, getattr(load_model(name), name)(instance_name="inside"), rows)
    assert _drive(
        instantiate(name).initialise(**golden.START[name]), name, rows, 0, len(rows), keep=True
    ) == [{signal: row[signal] for signal in golden.OUTPUTS[name]} for row in expected]


@pytest.mark.parametrize("name", NAMES)
# In free flight before a contact, within its onset, where the filter runs, and after it.
@pytest.mark.parametrize("at", [10, 55, 150, 300])
@FORMS
def test_300_steps_after_a_restored_state_are_bit_identical(name, at, form, instantiate):
    rows = golden.read(name) * 5
    rows = [{**row, "time": index * golden.STEP} for index, row in enumerate(rows)]
    first = instantiate(name, form).initialise(**golden.START[name])
    _drive(first, name, rows, 0, at)
    state = first.fmu.getFMUState()
    saved = first.get_all()
    serialised = first.fmu.serializeFMUState(state)
    expected = _drive(first, name, rows, at, at + 300, keep=True)
    assert any(row != expected[0] for row in expected)

    first.fmu.setFMUState(state)
    assert first.get_all() == saved
    assert _drive(first, name, rows, at, at + 300, keep=True) == expected
    first.fmu.freeFMUState(state)

    # The second instance stood elsewhere and had other parameters.
    second = instantiate(name, form).initialise(**golden.OTHER[name])
    second.fmu.setFMUState(second.fmu.deserializeFMUState(serialised))
    assert second.get_all() == saved
    assert _drive(second, name, rows, at, at + 300, keep=True) == expected

    # And the first one's later steps left no trace in what was saved.
    first.fmu.reset()
    first.fmu.setFMUState(first.fmu.deserializeFMUState(serialised))
    assert _drive(first, name, rows, at, at + 300, keep=True) == expected


@pytest.mark.parametrize("name", NAMES)
def test_reset_gives_a_fresh_instance(name, instantiate):
    rows = golden.read(name)[:250]
    instance = instantiate(name)
    fresh = instance.get_all()
    once = _drive(instance.initialise(**golden.START[name]), name, rows, 0, len(rows), keep=True)
    instance.fmu.reset()
    assert instance.get_all() == fresh
    assert _drive(instance.initialise(**golden.START[name]), name, rows, 0, len(rows), keep=True) == once


def test_a_missing_package_is_named_in_the_log(tmp_path):
    path = FMUS / "ComplianceController" / "ComplianceController.fmu"
    fmpy.extract(str(path), unzipdir=str(tmp_path))
    result = _run(
        """
sys.modules["filterpy"] = None
log = []
try:
    conftest.Instance(fmpy.read_model_description(sys.argv[1]), sys.argv[2], "controller", log)
except Exception:
    print(log[-1][1], flush=True)
    os._exit(1)  # past pythonfmu's fault at exit, of which FMPy does not know
""",
        path,
        tmp_path,
    )
    assert result.returncode == 1
    assert (
        "the controller needs the Python package filterpy where it runs: pip install filterpy"
        in result.stdout
    )


def _run(program: str, *paths: Path) -> subprocess.CompletedProcess[str]:
    head = (
        f"import atexit, os, sys; sys.path.insert(0, {str(Path(__file__).parent)!r}); import conftest, fmpy\n"
    )
    command = [sys.executable, "-c", head + program, *map(str, paths)]
    return subprocess.run(command, capture_output=True, text=True)


def test_an_instance_that_refused_can_be_freed(tmp_path):
    """Pythonfmu's loader gives up its references twice then, which used to end the process."""
    path = FMUS / "SatelliteDynamics" / "SatelliteDynamics.fmu"
    fmpy.extract(str(path), unzipdir=str(tmp_path))
    result = _run(
        """
description = fmpy.read_model_description(sys.argv[1])
for index in range(30):
    instance = conftest.Instance(description, sys.argv[2], "satellite")
    try:
        instance.initialise(mass=-1.0)
    except Exception:
        print("refused")
    instance.fmu.freeInstance()
""",
        path,
        tmp_path,
    )
    assert (result.returncode, result.stdout) == (0, "refused\n" * 30), result.stderr


def test_the_loader_of_every_unpacked_copy_is_released_before_the_end(tmp_path):
    path = FMUS / "SatelliteDynamics" / "SatelliteDynamics.fmu"
    for copy in ("one", "two"):
        fmpy.extract(str(path), unzipdir=str(tmp_path / copy))
    result = _run(
        """
before = atexit._ncallbacks()
for copy in ("one", "two", "one"):
    description = fmpy.read_model_description(sys.argv[1])
    conftest.Instance(description, sys.argv[2] + "/" + copy, "satellite").fmu.freeInstance()
    print(atexit._ncallbacks() - before)
""",
        path,
        tmp_path,
    )
    assert (result.returncode, result.stdout) == (0, "1\n2\n2\n"), result.stderr


# --- the builder's refusals

MODEL = """
from pythonfmu import Fmi2Causality, Fmi2Initial, Fmi2Slave, Fmi2Variability, Real

class Doubler(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.u = self.y = 0.0
        self.type_attributes = {"u": {"unit": "mm", "displayUnit": "m"}, "y": {"unit": "mm"}}
        self.dependencies = {"y": ("u",)}
        self.initial_dependencies = {"y": ("u",)}
        self.register_variable(Real("u", causality=Fmi2Causality.input, description="input"))
        self.register_variable(
            Real("y", causality=Fmi2Causality.output, initial=Fmi2Initial.calculated, description="output")
        )

    def do_step(self, current_time, step_size):
        self.y = 2.0 * self.u
        return True
"""


def test_all_that_a_model_does_not_tell_is_reported_at_once(tmp_path):
    script = tmp_path / "doubler.py"
    text = MODEL.replace(', description="input"', "").replace('"y": {"unit": "mm"}', "")
    script.write_text(text.replace("self.dependencies = ", "self.other = "))
    with pytest.raises(BuildError) as caught:
        build_python_fmu(script, tmp_path / "doubler.fmu")
    assert [line.split(": ")[1] for line in str(caught.value).splitlines()] == ["u", "y", "dependencies"]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            '"y": {"unit": "mm"}',
            "",
            'doubler.py: y: a Real without a unit; name it in type_attributes, "1" if it has no dimension',
        ),
        ('"y": {"unit": "mm"}', '"y": {"unit": "furlong"}', "doubler.py: y: unknown unit 'furlong'"),
        (
            '"displayUnit": "m"',
            '"displayUnit": "s"',
            "doubler.py: u: display unit s [s] for mm [m]: dimensions differ",
        ),
        (
            '"y": {"unit": "mm"}',
            '"y": {"unit": "mm"}, "z": {"unit": "m"}',
            "doubler.py: type_attributes names 'z', which is no variable of the model",
        ),
        (
            "self.dependencies = ",
            "self.other = ",
            "doubler.py: dependencies: y: has no dependencies declared; give it as a tuple of variables, "
            "() for none",
        ),
        (
            'self.initial_dependencies = {"y": ("u",)}',
            'self.initial_dependencies = {"y": ("v", "w")}',
            "doubler.py: initial_dependencies: y: names v, w, unknown; give it as a tuple of variables, "
            "() for none",
        ),
        (
            ', description="input"',
            "",
            "doubler.py: u: no description; give one where the variable is registered",
        ),
        (
            "class Doubler(Fmi2Slave):",
            "class Doubler(Fmi2Slave, object):",
            "doubler.py: classes derived from Fmi2Slave: none; there must be exactly one, "
            "written `class Name(Fmi2Slave):` on one line",
        ),
        (
            "\nclass",
            "\nimport no_such_package\nclass",
            "doubler.py: cannot be loaded: ModuleNotFoundError: No module named 'no_such_package'",
        ),
    ],
)
def test_builder_refuses(tmp_path, old, new, message):
    script = tmp_path / "doubler.py"
    assert MODEL.count(old) == 1
    script.write_text(MODEL.replace(old, new))
    path, modules = list(sys.path), set(sys.modules)
    with pytest.raises(BuildError) as caught:
        build_python_fmu(script, tmp_path / "out" / "Doubler.fmu")
    assert str(caught.value) == message
    assert not (tmp_path / "out").exists()
    assert sys.path == path and not {name for name in set(sys.modules) - modules if "oubler" in name}


def test_builder_refuses_a_missing_file(tmp_path):
    with pytest.raises(BuildError) as caught:
        build_python_fmu(tmp_path / "nothing.py", tmp_path / "x.fmu")
    assert str(caught.value) == f"{tmp_path / 'nothing.py'}: cannot be read: No such file or directory"


def test_scaled_and_display_units_are_declared(tmp_path):
    (tmp_path / "doubler.py").write_text(MODEL)
    path = build_python_fmu(tmp_path / "doubler.py", tmp_path / "Doubler.fmu")
    assert validate_fmu(str(path)) == []
    (unit,) = fmpy.read_model_description(str(path)).unitDefinitions
    assert (unit.name, unit.baseUnit.m, unit.baseUnit.factor) == ("mm", 1, 1e-3)
    assert [(display.name, display.factor) for display in unit.displayUnits] == [("m", 1e-3)]


def test_two_versions_of_one_model_run_side_by_side(tmp_path):
    results = []
    for factor in ("2.0", "3.0"):
        script = tmp_path / f"doubler{factor[0]}.py"
        script.write_text(MODEL.replace("2.0 * self.u", f"{factor} * self.u"))
        path = build_python_fmu(script, tmp_path / f"{factor[0]}" / "Doubler.fmu")
        outcome = fmpy.simulate_fmu(
            str(path), stop_time=1.0, output_interval=0.5, start_values={"u": 1.0}, output=["y"]
        )
        results.append(float(outcome["y"][-1]))
    assert results == [2.0, 3.0]
    assert len({fmpy.read_model_description(str(p)).guid for p in tmp_path.glob("*/Doubler.fmu")}) == 2


def _members(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def _drive(instance, name, rows, first, last, keep=False):
    """Step an FMU through recorded inputs; outputs at every communication point where `keep`."""
    kept = []
    for index in range(first, last):
        instance.set(**{signal: rows[index][signal] for signal in golden.INPUTS[name]})
        if index:
            instance.fmu.doStep(rows[index - 1]["time"], golden.STEP)
        if keep:
            kept.append(dict(zip(golden.OUTPUTS[name], instance.get(*golden.OUTPUTS[name]), strict=True)))
    return kept
