"""What validation finds: each flaw where it is, and nothing in what is sound."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import foreign
import pytest
from archives import repack

from orchestrator.cli.fmu_tools.binaries import read_images
from orchestrator.cli.fmu_tools.finding import Level, Verdict
from orchestrator.cli.fmu_tools.trial import Conditions
from orchestrator.cli.fmu_tools.validate import has_errors, validate_fmu
from orchestrator.cli.main import main
from orchestrator.fmi.archive import binary_folder

FMUS = sorted((Path(__file__).parents[3] / "fmus").glob("*/*.fmu"))
FEW = Conditions(steps=20)


def failures(path, **options):
    """Level and reason of the failed checks, by name."""
    found = validate_fmu(path, FEW, **options)
    return {one.check: (one.level, one.reason) for one in found if one.verdict is Verdict.FAILED}


@pytest.mark.parametrize("path", FMUS, ids=lambda path: path.stem)
def test_shipped_fmus_have_no_errors(path):
    if "ArmMultibody" in path.name:
        pytest.importorskip("pinocchio")
    found = validate_fmu(path, FEW)
    if "CoulombDamper" in path.name:  # its force jumps where it begins, at standstill
        found = [one for one in found if one.check != "directional derivatives"]
    assert not has_errors(found), [one for one in found if one.level is Level.ERROR]
    untried = [one for one in found if one.verdict is Verdict.NOT_TRIED]
    assert not untried
    made_with_python = any(name.endswith(".py") for name in zipfile.ZipFile(path).namelist())
    lax = {one.check for one in found if one.level is Level.WARNING}
    # pythonfmu's binary compares no GUID, and does not hand it on.
    assert lax == ({"refuses a wrong token"} if made_with_python else set())


def test_what_is_sound_passes_everything(tmp_path):
    found = validate_fmu(foreign.flawed(tmp_path / "X.fmu"), FEW)
    platform = binary_folder("2.0")
    wrong = [one for one in found if one.verdict is not Verdict.PASSED]
    # It is built for this platform only, by a test; what it needs is the C library.
    assert not wrong
    assert f"binary {platform}" in [one.check for one in found]


FLAWS = {
    "random": ("determinism", Level.ERROR, "A second run differs: y at "),
    "reset": ("reset", Level.ERROR, "After a reset the trajectory differs: y at 0 s is "),
    "shared": ("two instances", Level.ERROR, "The first is disturbed: y at "),
    "saving": ("state", Level.ERROR, "Saving the state changes the run: y at 0.11 s is "),
    "state": ("state", Level.ERROR, "From the saved state the run differs: y at 0.11 s is "),
    "bytes": ("serialised state", Level.ERROR, "From the bytes another instance goes on differently: y at "),
    "undeclared": ("dependencies", Level.ERROR, "1 dependencies are seen and not declared: y on u."),
    "derivative": ("directional derivatives", Level.ERROR, "The derivative of z by u is given as 3.0; "),
    "inverse": ("step halving", Level.WARNING, "Half the step changes y most, by "),
    "not finite": ("values", Level.ERROR, "1 variables are not finite: y = nan."),
    "swallows NaN": ("NaN inputs", Level.WARNING, "They are taken, and every output stays finite"),
    "crashes early": (
        "refuses a step before initialisation",
        Level.ERROR,
        "Its process died: SIGABRT (Aborted).",
    ),
    "lax": ("refuses setting an output", Level.WARNING, "Setting an output is answered as if it were legal."),
}


@pytest.mark.parametrize("flaw", FLAWS)
def test_each_flaw_is_found_where_it_is(flaw, tmp_path):
    check, level, reason = FLAWS[flaw]
    found = failures(foreign.flawed(tmp_path / "X.fmu", flaw))
    assert check in found
    assert found[check][0] is level
    assert found[check][1].startswith(reason)


def test_one_flaw_does_not_blame_the_rest(tmp_path):
    for flaw in ("reset", "bytes", "derivative", "inverse"):
        assert list(failures(foreign.flawed(tmp_path / "X.fmu", flaw))) == [FLAWS[flaw][0]]


def test_what_hangs_is_ended_and_the_rest_is_tried(tmp_path):
    found = validate_fmu(foreign.flawed(tmp_path / "X.fmu", "hangs at NaN"), FEW, time_limit=3.0)
    by_name = {one.check: one for one in found}
    assert by_name["NaN inputs"].reason == "It did not come to an end within 3 s."
    assert by_name["NaN inputs"].level is Level.ERROR
    assert by_name["infinite inputs"].verdict is Verdict.PASSED


def test_what_crashes_when_driven_is_reported_and_tried_at_rest(tmp_path):
    found = validate_fmu(foreign.flawed(tmp_path / "X.fmu", "crashes when driven"), FEW)
    runs = [one for one in found if one.check == "run"]
    assert runs[0].reason == (
        "With steps of 0.01 s and inputs up to 1 of their nominal values its process died: SIGABRT (Aborted)."
    )
    assert runs[-1].verdict is Verdict.PASSED and runs[-1].figures["amplitude"] == 0.0
    assert {one.check: one.verdict for one in found}["determinism"] is Verdict.PASSED


def test_what_always_crashes_is_reported_once(tmp_path):
    found = validate_fmu(foreign.flawed(tmp_path / "X.fmu", "always crashes"), FEW)
    errors = [(one.check, one.reason) for one in found if one.level is Level.ERROR]
    assert errors == [("run", "With steps of 0.01 s and inputs at rest its process died: SIGABRT (Aborted).")]
    rest = [one for one in found if one.verdict is Verdict.NOT_TRIED]
    assert {one.reason for one in rest} == {"The FMU does not run."} and len(rest) > 10


def test_declarations_are_checked(tmp_path):
    found = failures(foreign.flawed(tmp_path / "X.fmu", min="2", unit="furlong"))
    assert found["start values"] == (
        Level.ERROR,
        "1 start values are out of range: gain = 1.0, not in [2.0, None].",
    )
    assert found["units"] == (Level.WARNING, "Units that cannot be converted to SI: furlong.")
    assert found["description"][0] is Level.ERROR and 'The unit "furlong"' in found["description"][1]


def moved(source, target, change):
    """An FMU whose libraries stand elsewhere: `change` gives the folder's new name, or None."""

    def entry(name, data):
        parts = name.split("/")
        if parts[0] != "binaries":
            return name, data
        folder = change(parts[1])
        return None if folder is None else ("/".join(["binaries", folder, *parts[2:]]), data)

    return repack(source, target, entry)


def test_libraries_of_the_wrong_kind_are_reported(tmp_path):
    own = binary_folder("2.0")
    swapped = {"win64": "linux64", "linux64": "win64", "darwin64": "darwin64"}
    source = next(path for path in FMUS if path.name == "ForceSensor.fmu")
    found = failures(moved(source, tmp_path / "X.fmu", swapped.get))
    assert found["binary linux64"][1] == (
        "binaries/linux64/ForceSensor.dll is PE x86_64; linux64 needs ELF x86_64 or aarch64."
    )
    assert found["binary win64"][0] is Level.ERROR
    nothing_here = failures(moved(source, tmp_path / "Y.fmu", lambda name: None if name == own else name))
    assert nothing_here["binary"][1].startswith(
        f"There is no library ForceSensor for this platform, {own}; there are: "
    )


def test_a_library_without_the_functions_is_reported(tmp_path):
    def rename(name, data):
        return name, data.replace(b"fmi2DoStep", b"fmi2NoStep").replace(b"fmi2CancelStep", b"fmi2CancelStop")

    found = failures(repack(foreign.flawed(tmp_path / "X.fmu"), tmp_path / "Y.fmu", rename))
    assert found[f"binary {binary_folder('2.0')}"][1].endswith("does not export fmi2DoStep.")


def test_a_library_that_is_none_is_reported(tmp_path):
    def spoil(name, data):
        return name, b"not a library at all" if name.startswith("binaries/") else data

    found = failures(repack(foreign.flawed(tmp_path / "X.fmu"), tmp_path / "Y.fmu", spoil))
    platform = binary_folder("2.0")
    assert "is no library: neither ELF nor PE nor Mach-O" in found[f"binary {platform}"][1]
    assert found["run"][0] is Level.ERROR
    with pytest.raises(ValueError, match="begins with b'not a li'"):
        read_images(b"not a library at all")


def test_the_command_tells_by_its_exit_code(tmp_path, capsys):
    sound, flawed = foreign.flawed(tmp_path / "A.fmu"), foreign.flawed(tmp_path / "B.fmu", "derivative")
    assert main(["fmu", "validate", "--steps", "20", str(sound)]) == 0
    assert "passed     reset: After a reset" in capsys.readouterr().out
    assert main(["fmu", "validate", "--steps", "20", "--json", str(sound), str(flawed)]) == 1
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [line["file"] for line in lines] == [str(sound), str(flawed)]
    levels = {one["check"]: one["level"] for one in lines[1]["findings"]}
    assert levels["directional derivatives"] == "error" and levels["reset"] == ""


def test_the_command_goes_on_after_what_it_cannot_read(tmp_path, capsys):
    broken = tmp_path / "B.fmu"
    broken.write_bytes(b"no archive")
    sound = foreign.flawed(tmp_path / "A.fmu")
    assert main(["fmu", "validate", "--steps", "20", str(broken), str(sound)]) == 2
    streams = capsys.readouterr()
    assert f"{broken}: not an FMU, since it is no zip archive" in streams.err
    assert "passed     reset" in streams.out
    assert main(["fmu", "inspect", "RobotRespons"]) == 2
    assert capsys.readouterr().err == (
        "orchestrator: there is no file 'RobotRespons', and no bundled FMU of that name\n"
        "  Did you mean RobotResponse or RobotResponse-fmi3?\n"
    )
    assert main(["fmu", "compare", "--steps", "1", "RobotResponse", "RobotResponse"]) == 2
    assert capsys.readouterr().err == "orchestrator: --steps is 1\n  it must be at least 8\n"
