"""Python processes that run code of FMUs, so that a crash there is not one here."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import IO

__all__ = ["cause_of_death", "start_child"]

_START = (
    "import json, sys; from importlib import import_module; sys.path[:] = json.loads(sys.argv[1]); "
    "import_module(sys.argv[2]).main()"
)


def start_child(module: str, printed: IO[bytes]) -> subprocess.Popen[bytes]:
    """A new process that calls `main()` of a module and talks over its standard input and output.

    It has this process's paths of modules.

    Args:
        printed: a file that takes its standard error.
    """
    root = str(Path(__file__).resolve().parents[2])
    paths = json.dumps([root, *(os.path.abspath(one) for one in sys.path if one)])
    # -P: files in the working directory must not pose as modules.
    return subprocess.Popen(
        [sys.executable, "-P", "-c", _START, paths, module],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=printed,
        bufsize=0,
    )


def cause_of_death(code: int) -> str:
    """An exit code in words, for example "SIGSEGV (Segmentation fault)"."""
    if code < 0:
        try:
            name = signal.Signals(-code).name
        except ValueError:
            name = f"signal {-code}"
        return f"{name} ({signal.strsignal(-code)})"
    return f"exit code {code:#x}" if code > 255 else f"exit code {code}"
