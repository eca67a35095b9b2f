"""Packages that come with an extra are named with it where a command or the interface misses them."""

import subprocess
import sys

import pytest

from orchestrator.base.errors import OrchestratorError, extras_named

# Whatever imports these packages finds none, as after `pip install .`.
WITHOUT = """
import sys
for name in sys.argv.pop(1).split(","):
    sys.modules[name] = None
from orchestrator.cli.main import entry_point
entry_point()
"""

STUDY = """
format: sweep/1
system: emps
set: {run.stop_time: 0.1 s}
step_halving: false
design:
  grid: {drive.mass: [90 kg, 95 kg]}
"""


def without(packages: str, *arguments: str, cwd) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", WITHOUT, packages, *arguments]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("package, extra", [("numba", "fast"), ("duckdb", "store"), ("h5py", "logs")])
def test_the_extra_of_a_package_is_named(package, extra):
    with pytest.raises(
        OrchestratorError, match=rf"needs the package {package}: pip install 'orchestrator\[{extra}\]'"
    ):
        with extras_named():
            raise ModuleNotFoundError(f"No module named {package!r}", name=package)


def test_another_missing_module_stays_as_it_is():
    with pytest.raises(ModuleNotFoundError), extras_named():
        raise ModuleNotFoundError("No module named 'mine'", name="mine")


def test_commands_work_without_the_extras(tmp_path):
    (tmp_path / "study.yaml").write_text(STUDY)
    blocked = "numba,llvmlite,duckdb"
    for arguments in (
        ("run", "emps", "--stop-time", "0.2", "--out", "out"),
        ("stability", "emps"),
        ("sweep", "study.yaml", "--store", "store", "--jobs", "1"),
        ("fmu", "inspect", "RobotResponse"),
    ):
        done = without(blocked, *arguments, cwd=tmp_path)
        assert done.returncode == 0, (arguments, done.stderr)
    done = without("duckdb", "store", "show", "store", cwd=tmp_path)
    assert done.returncode == 1
    assert "pip install 'orchestrator[store]'" in done.stderr


def test_a_command_that_needs_an_extra_says_so(tmp_path):
    done = without("numba", "diagnose", "--help", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    done = without("numba", "challenge", "make", "--cases", "1", "--seed", "1", "out", cwd=tmp_path)
    assert done.returncode == 1
    assert "this needs the package numba: pip install 'orchestrator[fast]'" in done.stderr
    assert "Traceback" not in done.stderr
