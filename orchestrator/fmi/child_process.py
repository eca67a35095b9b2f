"""Python processes that run code of FMUs, so that a crash there is not one here."""

from __future__ import annotations

import ctypes
import json
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import IO

from ..base.temporary_folders import scratch_root

# After which a child that was asked to end is killed [s].
_SECONDS_TO_END = 5.0
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
    # What a process that is ended leaves in its temporary folder goes with that of this one.
    temporary = dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(scratch_root()))
    # -P: files in the working directory must not pose as modules.
    return subprocess.Popen(
        [sys.executable, "-P", "-c", _START, paths, module],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=printed,
        bufsize=0,
        env=os.environ | temporary,
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


def _leave_with_the_parent(parent: int) -> None:
    # An idle process sees the pipe's end; one that hangs in a task needs this.
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)


def _print_by_lines() -> None:
    """Have C and Python write each line at once: what they keep is lost where the process is killed."""
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    if os.name == "posix":
        library = ctypes.CDLL(None)
        with suppress(ValueError):  # a C library that calls its stream otherwise
            name = "__stdoutp" if sys.platform == "darwin" else "stdout"
            library.setvbuf(ctypes.c_void_p.in_dll(library, name), None, 1, ctypes.c_size_t(0))


def guarded_pipes() -> tuple[int, int]:
    """In a child: descriptors of commands and answers, out of reach of what it prints; sees to its end.

    To be called once, first of all.
    """
    commands, answers = os.dup(0), os.dup(1)
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.dup2(2, 1)
    _print_by_lines()
    # An interrupt goes to all processes of a terminal: the one that holds the work decides.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if os.name == "posix":
        threading.Thread(target=_leave_with_the_parent, args=(os.getppid(),), daemon=True).start()
    return commands, answers


def end(process: subprocess.Popen[bytes]) -> None:
    """Close the pipes of a child, at which it ends; one that does not is killed."""
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            pipe.close()
    try:
        process.wait(_SECONDS_TO_END)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
