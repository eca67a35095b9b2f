"""An interrupt while a command's modules are imported ends it as any other: one line, status 130."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

# As in code of a library that is compiled from text while it is imported.
SITE = """
import signal, sys

class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == WANTED:
            exec("signal.raise_signal(signal.SIGINT)")

signal.signal(signal.SIGINT, signal.default_int_handler)
sys.meta_path.insert(0, Finder())
"""


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
@pytest.mark.parametrize(
    "module", ["orchestrator.base.errors", "pydantic", "orchestrator.simulation.run", "fmpy"]
)
def test_an_interrupt_while_modules_are_imported(module, tmp_path):
    (tmp_path / "sitecustomize.py").write_text(SITE.replace("WANTED", repr(module)), encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-m", "orchestrator", "check", "docking-1d"],
        capture_output=True, text=True, timeout=120, cwd=Path(__file__).parents[2],
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
    )  # fmt: skip
    assert (done.returncode, done.stderr, done.stdout) == (130, "interrupted\n", "")
