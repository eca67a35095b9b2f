"""A process that has run Python FMUs ends cleanly."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

CODE = """
from orchestrator.simulation.run import run
for _ in range(3):
    run("docking-1d", halving=False, overrides=["run.stop_time=0.01 s"])
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="uses glibc's heap checks")
def test_no_heap_corruption_at_exit():
    environment = os.environ | {"MALLOC_CHECK_": "3", "MALLOC_PERTURB_": "165"}
    environment["LD_PRELOAD"] = "libc_malloc_debug.so.0"
    environment["PYTHONPATH"] = str(Path(__file__).parents[2])
    ended = subprocess.run([sys.executable, "-c", CODE], env=environment, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr


def test_python_state_is_released_with_every_instance(monkeypatch):
    """Pythonfmu's second destruction at exit writes to freed memory; whether that shows is chance."""
    from orchestrator.fmi import library
    from orchestrator.simulation.run import run

    released = []
    original = library.release_python_state

    def release(loaded):
        released.append(hasattr(loaded, "finalizePythonInterpreter"))
        original(loaded)

    monkeypatch.setattr(library, "release_python_state", release)
    run("docking-1d", halving=False, overrides=["run.stop_time=0.01 s"])
    assert sorted(released) == [False, False, False, True, True]
