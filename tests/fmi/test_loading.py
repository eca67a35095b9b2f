"""FMUs from files: every type moves, states come back, and what cannot run is refused by name."""

from __future__ import annotations

import ctypes
import os
import re
import subprocess
import sys
import tempfile
import zipfile
from fractions import Fraction
from pathlib import Path

import fmpy
import numpy as np
import pytest
from archives import repack

from orchestrator.base.errors import FmuError, StepError
from orchestrator.fmi import Kind, Point, StepStatus, load_fmu
from orchestrator.fmi.archive import binary_folder
from orchestrator.fmi.block import Block, Unfit

TYPES3 = {"real": 2.0, "single": 0.5, "byte": 3, "count": 7, "level": 2, "flag": True}


def started(fmu, name="one", **start):
    """An initialised instance whose numeric inputs and outputs are bound: instance, u, y, output names."""
    instance = load_fmu(fmu).instantiate(name)
    inputs = [v.name for v in instance.description.inputs if v.kind.numeric]
    outputs = [v.name for v in instance.description.outputs if v.kind.numeric]
    u, y = np.zeros(len(inputs)), np.zeros(len(outputs))
    instance.bind(inputs, u, outputs, y)
    instance.enter_initialisation(0.0, start, 10.0)
    instance.exit_initialisation()
    return instance, dict(zip(inputs, range(len(inputs)), strict=True)), u, y, outputs


def test_whole_numbers_that_a_type_cannot_hold_are_refused(c_fmu):
    """Ctypes would take them modulo its size: 300 as 44."""
    instance, index, u, *_ = started(c_fmu, word_in="hello", limit=100.0)
    remedy = "\n  Give it a value within, or scale what feeds it."
    for value, reported in ((-1.0, "-1"), (2.0**32, "4294967296")):
        u[index["count_in"]] = value
        with pytest.raises(StepError) as caught:
            instance.write_inputs()
        assert str(caught.value) == (
            f"one: count_in (UInt32) cannot hold {reported}; it holds whole numbers from 0 to "
            f"4294967295{remedy}"
        )
        assert caught.value.status == "out of range"
    u[index["count_in"]] = np.nan
    with pytest.raises(StepError, match=r"count_in \(UInt32\) cannot hold nan: it is no whole number"):
        instance.write_inputs()
    with pytest.raises(StepError, match=r"byte_in \(Int8\) cannot hold 300; .* from -128 to 127"):
        instance.set_values({"byte_in": 300})
    instance.free()


@pytest.mark.parametrize(
    ("ctype", "largest"),
    [(ctypes.c_int64, 2**63 - 1), (ctypes.c_uint64, 2**64 - 1), (ctypes.c_int32, 2**31 - 1)],
)
def test_the_largest_whole_number_is_sent_through_a_double(ctype, largest, c_fmu):
    """Signals are doubles: that next to the largest number of 64 bits is one beyond it."""
    variable = load_fmu(c_fmu).description.variables["byte_in"]
    memory = np.array([float(largest)])
    block = Block("Int64", ctype, "Set", [(0, variable)], memory)
    block.send()
    assert block.values[0] == largest
    memory[0] = np.nextafter(float(largest), np.inf) if largest > 2**53 else largest + 1.0
    with pytest.raises(Unfit, match="cannot hold"):
        block.send()


def test_fmi3_moves_every_type(c_fmu):
    instance, index, u, y, outputs = started(c_fmu, word_in="hello", limit=100.0)
    for name, value in TYPES3.items():
        u[index[f"{name}_in"]] = value
    instance.write_inputs()
    assert instance.do_step(Point(0, 0.0, 0.125)) is StepStatus.OK
    instance.read_outputs()
    found = dict(zip(outputs, y.tolist(), strict=True))
    assert found == {
        "real_out": 0.25,
        "single_out": 0.5,
        "byte_out": -3.0,
        "count_out": 8.0,
        "level_out": 2.0,
        "flag_out": 0.0,
    }
    assert instance.get_values(["word_out", "flag_out", "level_out", "limit"]) == {
        "word_out": "hello",
        "flag_out": False,
        "level_out": 2,
        "limit": 100.0,
    }
    instance.terminate()
    instance.free()


def test_fmi2_moves_every_type(python_fmu):
    instance, index, u, y, outputs = started(python_fmu("types2"), word_in="hello")
    for name in ("real", "count", "flag"):
        u[index[f"{name}_in"]] = TYPES3[name]
    instance.write_inputs()
    assert instance.do_step(Point(0, 0.0, 0.125)) is StepStatus.OK
    instance.read_outputs()
    assert dict(zip(outputs, y.tolist(), strict=True)) == {
        "real_out": 0.25,
        "count_out": 8.0,
        "flag_out": 0.0,
    }
    assert instance.get_values(["word_out"]) == {"word_out": "hello!"}
    instance.free()


def step(instance, u, y, time, value):
    u[0] = value
    instance.write_inputs()
    instance.do_step(Point(0, time, 0.125))
    instance.read_outputs()
    return y.copy()


@pytest.mark.parametrize("version", ["2", "3"])
def test_a_restored_state_continues_bit_identical_also_in_another_instance(version, c_fmu, python_fmu):
    path = c_fmu if version == "3" else python_fmu("types2")
    instance, _, u, y, _ = started(path)
    step(instance, u, y, 0.0, 0.1)
    state = instance.save_state()
    rows = [step(instance, u, y, 0.125 * n, 0.1 * n) for n in range(1, 5)]
    data = instance.serialise_state(state)
    instance.restore_state(state)
    again = [step(instance, u, y, 0.125 * n, 0.1 * n) for n in range(1, 5)]
    assert np.array_equal(rows, again)
    assert not np.array_equal(rows[0], rows[1])
    other, _, u2, y2, _ = started(path, "two")
    other.restore_state(other.deserialise_state(data))
    elsewhere = [step(other, u2, y2, 0.125 * n, 0.1 * n) for n in range(1, 5)]
    assert np.array_equal(rows, elsewhere)
    instance.free_state(state)
    instance.free()
    other.free()


def test_description_is_reduced_to_what_is_needed(c_fmu):
    description = load_fmu(c_fmu).description
    assert description.fmi_version == "3.0"
    assert [v.name for v in description.inputs][:2] == ["real_in", "single_in"]
    assert description.variables["level_in"].kind is Kind.ENUMERATION
    assert description.variables["level_in"].items == {"low": 1, "high": 2}
    assert description.variables["real_out"].unit.factor == Fraction(1, 1000)
    assert description.variables["limit"].minimum == 0.0
    assert description.feedthrough["real_out"] == ()
    assert description.assumed == frozenset()
    assert description.capabilities.save_state and description.capabilities.serialise_state


def test_dependencies_that_are_not_declared_are_assumed(python_fmu):
    description = load_fmu(python_fmu("misbehaving")).description
    assert description.feedthrough == {"level": ("rate",)}
    assert description.assumed == {"level"}


def test_an_error_carries_instance_time_status_and_the_fmus_log(c_fmu):
    instance, _, u, y, _ = started(c_fmu, limit=0.5)
    for n in range(3):
        step(instance, u, y, 0.125 * n, 1.0)
    with pytest.raises(StepError) as caught:
        for n in range(3, 9):
            step(instance, u, y, 0.125 * n, 1.0)
    assert str(caught.value) == (
        "one at time 0.5 s: fmi3DoStep returned error\n"
        "  log of the FMU:\n"
        "    [error] real_out has passed its limit"
    )
    assert (caught.value.instance, caught.value.time, caught.value.status) == ("one", 0.5, "error")
    instance.free()


def test_a_step_that_is_too_long_is_discarded_not_failed(c_fmu):
    instance, _, _, _, _ = started(c_fmu)
    assert instance.do_step(Point(0, 1.0, 0.5)) is StepStatus.DISCARD
    assert instance.last_successful_time() == 1.0
    assert instance.log_lines() == ("[discard] the step is too long",)
    instance.free()


def test_instances_of_one_fmu_share_a_folder_that_goes_with_the_last(c_fmu, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    fmu = load_fmu(c_fmu)
    one, two = fmu.instantiate("one"), fmu.instantiate("two")
    assert len(list(tmp_path.glob("*/fmu-*"))) == 1
    one.free()
    one.free()
    assert len(list(tmp_path.glob("*/fmu-*"))) == 1
    two.free()
    assert not list(tmp_path.glob("*/fmu-*"))


# Refusals: the whole message each.


def refusal(path: Path) -> str:
    directory = os.getcwd()
    with pytest.raises(FmuError) as caught:
        load_fmu(path).instantiate("one")
    assert os.getcwd() == directory
    return str(caught.value).replace(str(path), "X.fmu")


def test_missing_file(tmp_path):
    assert refusal(tmp_path / "X.fmu") == "X.fmu: no such file"


def test_no_zip_archive(tmp_path):
    path = tmp_path / "X.fmu"
    path.write_text("not an archive")
    assert refusal(path) == (
        "X.fmu: not an FMU, since it is no zip archive (File is not a zip file)\n"
        "  Export or download it again."
    )


def test_truncated_archive(c_fmu, tmp_path):
    path = tmp_path / "X.fmu"
    path.write_bytes(c_fmu.read_bytes()[:2000])
    assert refusal(path).startswith("X.fmu: not an FMU, since it is no zip archive (")


def test_archive_without_a_model_description(tmp_path):
    path = tmp_path / "X.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("inner/modelDescription.xml", "<x/>")
        archive.writestr("readme.txt", "")
    assert refusal(path) == (
        "X.fmu: not an FMU, it has no modelDescription.xml at the top\n"
        "  it holds inner/modelDescription.xml, readme.txt"
    )


def described(tmp_path: Path, xml: str) -> Path:
    path = tmp_path / "X.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", xml)
    return path


def test_description_that_is_no_xml(tmp_path):
    # What stands in parentheses is the XML library's own wording.
    message = refusal(described(tmp_path, "<fmiModelDescription"))
    assert re.fullmatch(
        r"X\.fmu: modelDescription\.xml is not well-formed XML \(.*line 1, column \d+\)", message
    )


def test_description_with_an_entity(tmp_path):
    xml = '<!DOCTYPE a [<!ENTITY b "c">]><fmiModelDescription fmiVersion="2.0">&b;</fmiModelDescription>'
    assert refusal(described(tmp_path, xml)) == (
        "X.fmu: modelDescription.xml declares a document type, which FMI has no use for; refused"
    )


def test_unknown_fmi_version(tmp_path):
    xml = '<fmiModelDescription fmiVersion="4.0"/>'
    assert refusal(described(tmp_path, xml)) == (
        "X.fmu: FMI version 4.0 is not supported; supported: 1.0, 2.0, 3.0"
    )


def test_description_against_the_schema(tmp_path):
    message = refusal(described(tmp_path, '<fmiModelDescription fmiVersion="2.0" guid="1"/>'))
    first, second, *_ = message.splitlines()
    assert first == "X.fmu: its modelDescription.xml is not valid FMI 2.0"
    assert second == (
        "  ERROR (line 1, column 0): Element 'fmiModelDescription': "
        "The attribute 'modelName' is required but missing."
    )


def test_an_unknown_attribute_excuses_nothing_else(tmp_path):
    message = refusal(described(tmp_path, '<fmiModelDescription fmiVersion="2.0" guid="1" colour="red"/>'))
    assert "'modelName' is required but missing" in message


def test_an_interface_that_is_not_run(c_fmu, tmp_path):
    def only_scheduled_execution(name, data):
        xml = data.replace(b"<CoSimulation", b"<ScheduledExecution")
        xml = xml.replace(b' canHandleVariableCommunicationStepSize="true"', b"")
        return name, xml if name == "modelDescription.xml" else data

    path = repack(c_fmu, tmp_path / "X.fmu", only_scheduled_execution)
    assert refusal(path) == (
        "X.fmu: the FMU offers no co-simulation or model-exchange interface; it offers scheduled-execution\n"
        "  Export it again for co-simulation."
    )


def test_an_interface_that_the_library_has_not(c_fmu, tmp_path):
    def exchange(name, data):
        xml = data.replace(b"<CoSimulation", b"<ModelExchange")
        xml = xml.replace(b' canHandleVariableCommunicationStepSize="true"', b"")
        return name, xml if name == "modelDescription.xml" else data

    assert refusal(repack(c_fmu, tmp_path / "X.fmu", exchange)) == (
        "X.fmu: its library has no function fmi3InstantiateModelExchange, which is needed here"
    )


def test_wrong_platform(c_fmu, tmp_path):
    here = binary_folder("3.0")
    path = repack(c_fmu, tmp_path / "X.fmu", lambda name, data: (name.replace(here, "riscv64-plan9"), data))
    assert refusal(path) == (
        f"X.fmu: no binary for this platform, {here}; it has binaries for: riscv64-plan9\n"
        f"  Export it for {here}, or run it on a platform that it has."
    )


def test_binary_of_another_name(c_fmu, tmp_path):
    path = repack(c_fmu, tmp_path / "X.fmu", lambda name, data: (name.replace("Types3.", "Other."), data))
    here, suffix = binary_folder("3.0"), fmpy.sharedLibraryExtension
    assert refusal(path) == f"X.fmu: binaries/{here} holds no library Types3; it holds Other{suffix}"


def test_binary_that_is_none(c_fmu, tmp_path):
    path = repack(
        c_fmu, tmp_path / "X.fmu", lambda name, data: (name, b"text" if name.startswith("bin") else data)
    )
    assert refusal(path).startswith("X.fmu: its library cannot be loaded (")


@pytest.mark.skipif(sys.platform != "linux", reason="changes an ELF file")
def test_missing_library_is_named(python_fmu, tmp_path):
    # The C++ runtime's name in the binary's list of needed libraries is replaced by one of equal length.
    def broken(name, data):
        return name, data.replace(b"libstdc++.so.6", b"libabsent.so.6") if name.endswith(".so") else data

    path = repack(python_fmu("types2"), tmp_path / "X.fmu", broken)
    assert refusal(path) == ("X.fmu: needs the library libabsent.so.6, which is not installed\n  Install it.")


@pytest.mark.parametrize(
    "name", ["../outside.txt", "/outside.txt", "resources/../../outside.txt", "C:/outside"]
)
def test_entries_that_leave_the_folder_are_refused(name, c_fmu, tmp_path):
    path = repack(c_fmu, tmp_path / "X.fmu", lambda name, data: (name, data))
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr(name, "gotcha")
    assert refusal(path) == f"X.fmu: refused, its entry {name!r} would be written elsewhere"
    assert not (tmp_path / "outside.txt").exists()


def test_symbolic_links_are_refused(c_fmu, tmp_path):
    path = repack(c_fmu, tmp_path / "X.fmu", lambda name, data: (name, data))
    with zipfile.ZipFile(path, "a") as archive:
        entry = zipfile.ZipInfo("resources/link")
        entry.external_attr = 0o120777 << 16
        archive.writestr(entry, "/etc/passwd")
    assert refusal(path) == "X.fmu: refused, its entry 'resources/link' is a symbolic link"


def test_instantiation_that_fails_shows_the_log(c_fmu, tmp_path):
    path = repack(
        c_fmu,
        tmp_path / "X.fmu",
        lambda name, data: (name, data.replace(b'Token="{types-3}"', b'Token="{other}"')),
    )
    assert refusal(path) == (
        "X.fmu: instance one could not be made\n  log of the FMU:\n    [error] wrong instantiation token"
    )


def test_a_python_fmu_without_its_module(python_fmu):
    path = python_fmu("needy")
    # In a process of its own: after this, what pythonfmu 0.7 frees may take the interpreter with it.
    code = (
        "import os, sys\nfrom pathlib import Path\n"
        "from orchestrator.base.errors import FmuError\n"
        "from orchestrator.fmi import load_fmu\n"
        "try:\n"
        "    load_fmu(Path(sys.argv[1])).instantiate('one')\n"
        "except FmuError as error:\n"
        "    print(error, flush=True)\n"
        "os._exit(0)\n"
    )
    reported = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True)
    message = reported.stdout.replace(str(path), "X.fmu")
    assert message.splitlines()[0] == "X.fmu: instance one could not be made"
    assert "No module named 'a_module_that_nobody_has'" in message


def test_after_a_fatal_error_no_instance_of_the_fmu_is_called_again(python_fmu):
    fmu = load_fmu(python_fmu("misbehaving"))
    bad, other = fmu.instantiate("bad"), fmu.instantiate("other")
    for one, way in ((bad, "error"), (other, "none")):
        one.enter_initialisation(0.0, {"way": way, "at": 0.0})
        one.exit_initialisation()
    with pytest.raises(StepError, match="fmi2DoStep returned fatal"):
        bad.do_step(Point(0, 0.0, 0.1))
    called = []
    for one in (bad, other):
        for name in ("fmi2Terminate", "fmi2FreeInstance"):
            one._slave._functions[name] = lambda *arguments: called.append(arguments) or 0
        one.terminate()
        one.free()
    assert called == []
    again = fmu.instantiate("again")
    again.enter_initialisation(0.0, {})
    again.exit_initialisation()
    assert again.do_step(Point(0, 0.0, 0.1)) is StepStatus.OK
    again.terminate()
    again.free()


def test_a_logger_that_fmpy_was_given_does_not_get_our_messages(python_fmu):
    # fmpy's proxy serves one logger in a process; in a process of its own, since a fault would end it.
    code = (
        "import gc, sys\nfrom pathlib import Path\n"
        "from fmpy import simulate_fmu\n"
        "from orchestrator.base.errors import StepError\n"
        "from orchestrator.fmi import load_fmu\n"
        "from orchestrator.fmi.instance import Point\n"
        "theirs = []\n"
        "bad = load_fmu(Path(sys.argv[1])).instantiate('bad')\n"
        "bad.enter_initialisation(0.0, {'way': 'error', 'at': 0.0})\n"
        "bad.exit_initialisation()\n"
        "simulate_fmu(sys.argv[1], stop_time=0.1, logger=lambda *message: theirs.append(message))\n"
        "gc.collect()\n"
        "try:\n"
        "    bad.do_step(Point(0, 0.0, 0.1))\n"
        "except StepError as error:\n"
        "    print(error)\n"
        "print(len(theirs))\n"
    )
    path = str(python_fmu("misbehaving"))
    reported = subprocess.run([sys.executable, "-c", code, path], capture_output=True, text=True)
    assert "[error] the tank is empty" in reported.stdout, reported
    assert reported.stdout.splitlines()[-1] == "0"
