"""Machine code that is kept on disk is that of the sources that are there."""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "orchestrator"

pytest.importorskip("numba")

# Force of a sloshing mass on a body that moves; a callee in another file makes it.
SLOSH = """
import ctypes
from orchestrator.diagnosis.rig.effects.dynamics_slosh import _law as law
"""
OWN = """
import ctypes
from own_effect import LAW as law
"""
CALL = """
def array(*values):
    return (ctypes.c_double * len(values))(*values)
context = array(*[1.0] * 12)
print(law.ctypes(0.0, 0.01, 2.0, context, array(0.5, 0.25, 1.0), array(0.1, 6.0)), law.cache_hits)
"""
EFFECT = """
import own_constants
from numba import njit
from numpy import array, float64
from orchestrator.diagnosis.rig.effect import law
from own_callee import drag
from own_constants import SCALE

ONES = array([1.0, 1.0])

@njit
def between(value):
    return float64(drag(value)) * ONES[1] + own_constants.OFFSET

@law
def LAW(time, step, value, context, memory, theta):
    return SCALE * between(value)
"""
CALLEE = """
from numba import njit

@njit
def drag(value):
    return 3.0 * value
"""


def ran(code: str, *paths: Path, **environment: str) -> tuple[float, int]:
    """What a process of its own prints: a force, and how often it found machine code."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA_")}
    kept |= {"PYTHONPATH": os.pathsep.join(map(str, paths)), **environment}
    reported = subprocess.run(
        [sys.executable, "-c", code], env=kept, cwd=paths[0], capture_output=True, text=True, check=False
    )
    assert reported.returncode == 0, reported.stderr
    force, hits = reported.stdout.split()
    return float(force), int(hits)


def edit(path: Path, old: str, new: str) -> None:
    """Replace text in a file that keeps its time, as some copies and archives do."""
    state, text = path.stat(), path.read_text(encoding="utf-8")
    assert text.count(old) == 1
    path.write_text(text.replace(old, new), encoding="utf-8")
    os.utime(path, ns=(state.st_atime_ns, state.st_mtime_ns))
    # Python takes its own kept code for that of a file of the same time and size.
    for compiled in path.parent.glob(f"__pycache__/{path.stem}.*.pyc"):
        compiled.unlink()


@pytest.fixture
def copy(tmp_path) -> Path:
    """A copy of the package, to change."""
    shutil.copytree(PACKAGE, tmp_path / "orchestrator", ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path


def kept_files(folder: Path, function: str) -> list[str]:
    return sorted(path.name for path in folder.rglob("*.nb[ic]") if path.name.startswith(f"{function}-"))


def test_a_callee_in_another_file_is_compiled_anew(copy):
    effects = copy / "orchestrator" / "diagnosis" / "rig" / "effects"
    first, hits = ran(SLOSH + CALL, copy)
    assert hits == 0
    assert ran(SLOSH + CALL, copy) == (first, 1)
    edit(effects / "_oscillator.py", "value - share", "value + share")
    second, hits = ran(SLOSH + CALL, copy)
    assert hits == 0 and abs(second - first) > 0.1

    # The same with a constant of another file; and back, to what is still there.
    effect = copy / "orchestrator" / "diagnosis" / "rig" / "effect.py"
    usual = "    VELOCITY = 1\n    ACCELERATION = 2\n    COMMAND"
    other = "    ACCELERATION = 1\n    VELOCITY = 2\n    COMMAND"
    edit(effect, usual, other)
    assert ran(SLOSH + CALL, copy)[1] == 0
    edit(effect, other, usual)
    assert ran(SLOSH + CALL, copy) == (second, 1)


def test_machine_code_of_older_sources_goes(copy):
    folder = copy / "orchestrator" / "diagnosis" / "rig" / "effects"
    (folder / "__pycache__").mkdir()
    # Names of an earlier format, which did not depend on all sources; of another Python and another function.
    python = "".join(map(str, sys.version_info[:2]))
    before = folder / "__pycache__" / f"dynamics_slosh._law-12.py{python}.1.nbc"
    others = [before.with_name(f"dynamics_slosh.{name}") for name in ("_law-12.py27.1.nbc", "_lawful-1.nbi")]
    for path in (before, *others):
        path.write_bytes(b"")
    for number in range(4):
        (copy / "orchestrator" / "added.py").write_text(f"NUMBER = {number}\n", encoding="utf-8")
        assert ran(SLOSH + CALL, copy)[1] == 0
    assert not before.exists() and all(path.exists() for path in others)
    found = [name for name in kept_files(folder, "dynamics_slosh._law") if "py27" not in name]
    assert len(found) == 6, found  # an index and the code, of three states of the sources


def test_effects_of_users_follow_what_they_call_and_read(tmp_path):
    (tmp_path / "own_effect.py").write_text(EFFECT, encoding="utf-8")
    (tmp_path / "own_callee.py").write_text(CALLEE, encoding="utf-8")
    constants = tmp_path / "own_constants.py"
    constants.write_text("SCALE = 1.0\nOFFSET = 0.0\n", encoding="utf-8")
    assert ran(OWN + CALL, tmp_path, ROOT) == (6.0, 0)
    assert ran(OWN + CALL, tmp_path, ROOT) == (6.0, 1)
    edit(tmp_path / "own_callee.py", "3.0", "4.0")
    assert ran(OWN + CALL, tmp_path, ROOT) == (8.0, 0)
    edit(constants, "SCALE = 1.0", "SCALE = 2.0")
    assert ran(OWN + CALL, tmp_path, ROOT) == (16.0, 0)
    edit(constants, "OFFSET = 0.0", "OFFSET = 1.0")
    assert ran(OWN + CALL, tmp_path, ROOT) == (18.0, 0)


def test_sources_that_change_while_a_process_runs_leave_nothing(copy):
    """What runs is made of what was there before, some of it: it must not be taken for what is there."""
    change = """
import time
import orchestrator
from pathlib import Path
path = Path(orchestrator.__file__).parent / "base" / "units.py"
time.sleep(0.05)
path.write_bytes(path.read_bytes())
"""
    assert ran(change + SLOSH + CALL, copy)[1] == 0
    assert not list(copy.rglob("*.nb[ic]"))
    assert ran(SLOSH + CALL, copy)[1] == 0
    assert ran(change + SLOSH + CALL, copy)[1] == 0
    assert ran(SLOSH + CALL, copy)[1] == 1


def test_where_nothing_can_be_written_all_is_compiled(copy):
    first, _ = ran(SLOSH + CALL, copy)
    for path in list(copy.rglob("__pycache__")):
        shutil.rmtree(path)
        path.write_bytes(b"")  # no folder, for whom permissions do not keep out
    nowhere = {
        name: str(copy / "nowhere") for name in ("HOME", "XDG_CACHE_HOME", "LOCALAPPDATA", "USERPROFILE")
    }
    (copy / "nowhere").write_bytes(b"")
    for _ in range(2):
        assert ran(SLOSH + CALL, copy, **nowhere) == (first, 0)
    # In the user's folder, if that can be written.
    (copy / "user").mkdir()
    somewhere = {name: str(copy / "user") for name in nowhere}
    assert [ran(SLOSH + CALL, copy, **somewhere) for _ in range(2)] == [(first, 0), (first, 1)]


def test_the_folder_that_numba_is_reported_is_taken(copy, tmp_path):
    assert [ran(SLOSH + CALL, copy, NUMBA_CACHE_DIR=str(tmp_path / "reported"))[1] for _ in range(2)] == [
        0,
        1,
    ]
    assert kept_files(tmp_path / "reported", "dynamics_slosh._law")
    assert not kept_files(copy / "orchestrator", "dynamics_slosh._law")


def test_kept_code_is_seen_while_the_sources_stay(copy):
    look = """
import sys
from orchestrator.base.compiled_functions import is_kept
from pathlib import Path
source = Path("orchestrator/diagnosis/rig/effects/dynamics_slosh.py").resolve()
print(int(is_kept(source, "_law")), int("numba" in sys.modules))
"""
    assert ran(look, copy) == (0, 0)
    ran(SLOSH + CALL, copy)
    assert ran(look, copy) == (1, 0)
    edit(
        copy / "orchestrator" / "base" / "units.py",
        "from __future__ import annotations",
        "from __future__ import  annotations",
    )
    assert ran(look, copy) == (0, 0)


def test_numba_keeps_what_is_of_others_as_before():
    from numba.core import config

    import orchestrator.diagnosis.rig.effects._oscillator

    assert orchestrator.diagnosis.rig.effects._oscillator.body_force.stats.cache_path
    assert "orchestrator" not in config.CACHE_LOCATOR_CLASSES


def test_no_function_is_kept_by_its_own_file_alone():
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and path.name != "compiled_functions.py":
                assert "cache" not in [word.arg for word in node.keywords], f"{path}:{node.lineno}"
