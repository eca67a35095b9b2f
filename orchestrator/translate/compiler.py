"""The Modelica compiler: its forms of a model within a time limit, or its refusal."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from orchestrator.base.errors import BuildError

from .sources import SourceTree

__all__ = ["TIME_LIMIT", "Answer", "compile_model"]

TIME_LIMIT = 120.0
"""The compiler has models that it never ends with [s]."""


@dataclass(frozen=True)
class Answer:
    """What the compiler says.

    Attributes:
        forms: of the model by their names, as asked.
        refusal: its message; "" if it takes the model.
        panic: whether it ended by a panic.
    """

    forms: dict[str, Any] = field(default_factory=dict)
    refusal: str = ""
    panic: bool = False


_ONE_AT_A_TIME = threading.RLock()
_running: list[tuple[int, subprocess.Popen[str]]] = []  # with the process that has started it


def compile_model(
    tree: SourceTree,
    model: str,
    folder: Path,
    stages: Sequence[str],
    roots: Sequence[Path] = (),
    *,
    restored: Callable[[str], str] = str,
    limit: float = TIME_LIMIT,
) -> Answer:
    """Ask the compiler, which stays ready in a process of its own.

    Args:
        model: qualified name.
        folder: with a copy of the tree's files.
        stages: "flat", "dae".
        roots: folders with libraries.
        restored: changes names in the answer.
        limit: [s].
    Raises: BuildError if the compiler does not end.
    """
    asked = {
        "roots": [str(folder), *map(str, roots)], "file": str(folder / tree.main), "model": model,
        "stages": list(stages),
    }  # fmt: skip
    late = threading.Event()
    with _ONE_AT_A_TIME:
        process = _started()
        assert process.stdin is not None and process.stdout is not None

        def stop() -> None:
            late.set()
            process.kill()

        timer = threading.Timer(limit, stop)
        timer.start()
        try:
            process.stdin.write(json.dumps(asked) + "\n")
            process.stdin.flush()
            line = process.stdout.readline()
        except OSError:
            line = ""
        finally:
            timer.cancel()
        if not line.endswith("\n") or roots:  # it was ended; or what it has read of libraries takes memory
            _end()
    if late.is_set():
        raise BuildError(
            f"{tree.shown(tree.main)}: the Modelica compiler did not end within {limit:g} s for {model}"
        )
    if not line.endswith("\n"):
        return Answer(refusal="it ended without a message")
    return Answer(**json.loads(restored(line)))


def _started() -> subprocess.Popen[str]:
    if _running and (_running[0][0] != os.getpid() or _running[0][1].poll() is not None):
        _running.clear()  # another process's, or ended
    if not _running:
        command = [sys.executable, str(Path(__file__).with_name("compiler_process.py"))]
        process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            encoding="utf-8",
        )
        _running.append((os.getpid(), process))
    return _running[0][1]


def _end() -> None:
    process = _running.pop()[1]
    process.kill()
    process.communicate()
