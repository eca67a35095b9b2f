"""Object files of every platform, contents, comparison and cost of FMUs."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import foreign
import pytest
from archives import repack

from orchestrator.cli.fmu_tools.bench import bench_fmus
from orchestrator.cli.fmu_tools.binaries import platform_names
from orchestrator.cli.fmu_tools.comparison import compare_fmus
from orchestrator.cli.fmu_tools.contents import binaries, inspect_fmu
from orchestrator.cli.fmu_tools.trial import Conditions
from orchestrator.cli.main import main
from orchestrator.fmi import load_fmu

FOLDER = Path(__file__).parents[3] / "fmus"
FMUS = sorted(FOLDER.glob("*/*.fmu"))
KINDS = {
    "linux64": [("ELF", "x86_64")],
    "win64": [("PE", "x86_64")],
    "darwin64": [("Mach-O", "x86_64"), ("Mach-O", "aarch64")],
    "x86_64-linux": [("ELF", "x86_64")],
    "x86_64-windows": [("PE", "x86_64")],
    "x86_64-darwin": [("Mach-O", "x86_64")],
    "aarch64-darwin": [("Mach-O", "aarch64")],
}


@pytest.mark.parametrize("path", FMUS, ids=lambda path: path.stem)
def test_every_shipped_library_is_an_image_of_its_platform_with_all_functions(path):
    description = load_fmu(path).description
    found = binaries(path, description)
    platforms = {one.platform for one in found}
    python = description.tool.startswith("PythonFMU")
    if description.fmi_version == "3.0":
        assert platforms == {"x86_64-linux", "x86_64-windows", "x86_64-darwin", "aarch64-darwin"}
    else:
        assert platforms == {"linux64", "win64"} | (set() if python else {"darwin64"})
    for one in found:
        assert [(image.kind, image.architecture) for image in one.images] == KINDS[one.platform]
        assert all(image.shared for image in one.images)
        assert one.missing_core == one.missing == ()
        assert one.exported == {"2.0": 34, "3.0": 75}[description.fmi_version]
        assert python or one.foreign_needs == ()


def test_inspect_tells_what_is_there():
    found = inspect_fmu(FOLDER / "RobotResponse" / "RobotResponse.fmu")
    assert (found["fmi_version"], found["interfaces"]) == ("2.0", ["co-simulation"])
    assert found["checksum"] == load_fmu(FOLDER / "RobotResponse" / "RobotResponse.fmu").checksum()
    position = next(one for one in found["variables"] if one["name"] == "position")
    assert (position["unit"], position["depends_on"]) == ("m", [])
    assert found["counts"] == {
        "all": 10, "independent": 1, "input": 1, "local": 3, "output": 2, "parameter": 3,
    }  # fmt: skip
    python = inspect_fmu(FOLDER / "SatelliteDynamics" / "SatelliteDynamics.fmu")
    assert "python3.dll" in python["binaries"]["win64"]["needs_beyond_the_system"]
    assert python["capabilities"]["execution_tool"]


def test_the_command_prints_it_for_people_and_machines(capsys):
    assert main(["fmu", "inspect", "RobotResponse"]) == 0
    text = capsys.readouterr().out
    assert "  darwin64  darwin64    x86_64-darwin, aarch64-darwin  Mach-O x86_64 + Mach-O aarch64  " in text
    assert "  linux64   linux64     x86_64-linux                   ELF x86_64 " in text
    assert "  position  Real  m     0" in text
    assert main(["fmu", "inspect", "--json", "RobotResponse", "ForceSensor-fmi3"]) == 0
    names = [json.loads(line)["name"] for line in capsys.readouterr().out.splitlines()]
    assert names == ["DockingHIL.RobotResponse", "DockingHIL.ForceSensor"]


@pytest.mark.parametrize(
    ("folder", "architectures", "names"),
    [
        ("linux64", ["aarch64"], ("linux64", ("aarch64-linux",))),
        ("win32", [], ("win32", ("x86-windows",))),
        ("aarch64-darwin", ["aarch64"], ("darwin64", ("aarch64-darwin",))),
        ("x86_64-windows", [], ("win64", ("x86_64-windows",))),
        ("aarch64-windows", [], ("", ("aarch64-windows",))),
        ("vms", [], ("", ())),
    ],
)
def test_platforms_have_names_in_both_versions_of_fmi(folder, architectures, names):
    assert platform_names(folder, architectures) == names


def test_platforms_without_the_library_are_reported(tmp_path, capsys):
    path = foreign.arrays(tmp_path / "X.fmu")
    with zipfile.ZipFile(path, "a") as file:
        file.writestr("binaries/aarch64-linux/helper.so", b"x")
    assert main(["fmu", "inspect", str(path)]) == 0
    assert "  aarch64-linux: no library Arrays; it holds helper.so\n" in capsys.readouterr().out


def test_versions_of_fmi_give_the_same_bits_and_forms_nearly():
    conditions = Conditions(steps=200)
    robot = FOLDER / "RobotResponse"
    same = compare_fmus(robot / "RobotResponse.fmu", robot / "RobotResponse-fmi3.fmu", conditions)
    assert same.attributes == {"fmi_version": ("2.0", "3.0")} and not same.changed
    assert [one.largest for one in same.differences] == [0.0, 0.0]
    folder = FOLDER / "ComplianceController"
    forms = compare_fmus(
        folder / "ComplianceController.fmu", folder / "ComplianceController-native.fmu", conditions
    )
    assert forms.conditions is not None and forms.conditions.step_size == 5e-4
    assert forms.conditions.amplitude == 1.0 and len(forms.differences) == 7
    assert max(one.relative for one in forms.differences) < 1e-12


def test_a_change_is_reported_in_declaration_and_behaviour(tmp_path, capsys):
    one = foreign.flawed(tmp_path / "A.fmu")
    other = repack(
        one,
        tmp_path / "B.fmu",
        lambda name, data: (
            name,
            data.replace(b'guid="none"', b'guid="inverse"').replace(b'<Real start="1" ', b'<Real start="2" '),
        ),
    )
    found = compare_fmus(one, other, Conditions(steps=40))
    assert found.changed == {"gain": {"start": (1.0, 2.0)}}
    assert [(d.output, d.largest > 0.0) for d in found.differences] == [("y", True), ("z", False)]
    assert found.differences[0].time > 0.0
    assert not found.interface_differs
    assert main(["fmu", "compare", "--steps", "40", str(one), str(other)]) == 0
    assert "1 of 2 outputs are the same to the bit" in capsys.readouterr().out
    assert main(["fmu", "compare", "--steps", "40", "--tolerance", "1e-6", str(one), str(other)]) == 1
    capsys.readouterr()
    assert main(["fmu", "compare", "--json", "RobotResponse", "ForceSensor"]) == 1
    reported = json.loads(capsys.readouterr().out)
    assert "command" in reported["removed"] and reported["behaviour"] is None
    assert reported["reason"] == "They have no numeric output in common."


def test_the_same_seed_gives_the_same_inputs_whatever_else_there_is():
    from orchestrator.cli.fmu_tools.stimulus import stimulus

    inputs = load_fmu(FOLDER / "PointContact" / "PointContact.fmu").description.inputs[:4]
    rows = stimulus(inputs, 60, 1.0, 7)
    assert (stimulus(inputs[1:], 60, 1.0, 7) == rows[:, 1:]).all()
    assert (stimulus(inputs, 60, 1.0, 8) != rows).any()
    starts = [variable.start or 0.0 for variable in inputs]
    assert (rows[0] == starts).all() and (stimulus(inputs, 60, 0.0, 7) == starts).all()
    assert (abs(rows - starts) <= [variable.nominal for variable in inputs]).all()


def test_costs_are_measured_in_turns():
    folder = FOLDER / "SatelliteDynamics"
    paths = [folder / "SatelliteDynamics.fmu", folder / "SatelliteDynamics-native.fmu"]
    found = bench_fmus(paths, Conditions(), 3)
    assert [one["loop"] for one in found["fmus"]] == ["native", "native"]
    for one in found["fmus"]:
        assert one["steps"] >= 16
        for name in ("instantiate", "initialise", "set", "get", "step", "whole"):
            assert 0.0 <= one[name]["least"] <= one[name]["median"] <= one[name]["most"]
        assert one["whole"]["least"] > 0.0 and one["instantiate"]["least"] > 0.0
    assert found["ratios"][0]["whole"]["median"] > 1.0  # compiled, and not interpreted
