"""The route through OpenModelica, against a stand-in that plays `omc`."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import modelica_bench as bench
import pytest

from orchestrator.base.errors import BuildError
from orchestrator.translate.build import build

# Copies the script it is given to a place the test can read, says something, and makes what it is asked to.
STAND_IN = """#!{python}
import pathlib, sys
script = pathlib.Path(sys.argv[1])
pathlib.Path({log!r}).write_text(script.read_text())
print({says!r})
if {makes!r}:
    pathlib.Path({makes!r}).write_bytes(b"fmu")
sys.exit({code})
"""

pytestmark = pytest.mark.skipif(os.name == "nt", reason="the stand-in is a script with a shebang line")


@pytest.fixture
def omc(tmp_path, monkeypatch):
    folder = tmp_path / "bin"
    folder.mkdir()
    log = tmp_path / "received.mos"

    def install(says: str = "", makes: str = "", code: int = 0) -> Path:
        path = folder / "omc"
        path.write_text(
            STAND_IN.format(python=sys.executable, log=str(log), says=says, makes=makes, code=code)
        )
        path.chmod(0o755)
        monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")
        return log

    return install


def test_omc_gets_a_script_for_the_whole_package(omc, tmp_path):
    log = omc(makes="RobotStep.fmu")
    source = bench.ROOT / "modelica" / "DockingHIL" / "Examples" / "RobotStep.mo"
    report = build(source, tmp_path / "out.fmu", compiler="omc")
    assert (tmp_path / "out.fmu").read_bytes() == b"fmu"
    assert report.model == "DockingHIL.Examples.RobotStep" and report.notes[0].startswith(
        "built by OpenModelica"
    )
    package = (bench.ROOT / "modelica" / "DockingHIL" / "package.mo").as_posix()
    assert log.read_text() == (
        f'if not loadFile("{package}") then\n'
        "  print(getErrorString());\n"
        "  exit(1);\n"
        "end if;\n"
        'buildModelFMU(DockingHIL.Examples.RobotStep, version="2.0", fmuType="cs", '
        'fileNamePrefix="RobotStep", platforms={"static"});\n'
        "print(getErrorString());\n"
    )


def test_refusals(omc, tmp_path, monkeypatch):
    source = bench.model_file(tmp_path, "model M Real x = time; end M;\n")
    output = tmp_path / "M.fmu"
    omc(says="Error: no", makes="", code=1)
    with pytest.raises(BuildError) as caught:
        build(source, output, compiler="omc")
    assert str(caught.value) == f"{source}: omc made no FMU of M (exit status 1)\n  Error: no"
    with pytest.raises(BuildError) as caught:
        build(source, output, compiler="omc", fmi_version="3.0")
    assert str(caught.value) == (
        "--compiler omc makes FMI 2.0 only, got 3.0; drop --fmi or use --compiler rumoca"
    )
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(BuildError) as caught:
        build(source, output, compiler="omc")
    assert str(caught.value) == (
        "--compiler omc: `omc` is not on the PATH; install OpenModelica (https://openmodelica.org) or use "
        "--compiler rumoca"
    )
    assert not output.exists()
