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
from time import monotonic
from typing import Any

from orchestrator.base.errors import BuildError

from .sources import SourceTree

TIME_LIMIT = 120.0
"""The compiler has models that it never ends with: seconds of the processor, which others may use, too."""
# Times the limit that may pass by the clock.
_PATIENCE = 5.0


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
        limit: of the processor's time [s].
    Raises: BuildError if the compiler does not end.
    """
    asked = {
        "roots": [str(folder), *map(str, roots)], "file": str(folder / tree.main), "model": model,
        "stages": list(stages),
    }  # fmt: skip
    late, ended = threading.Event(), threading.Event()
    with _ONE_AT_A_TIME:
        process = _started()
        assert process.stdin is not None and process.stdout is not None

        def watch() -> None:
            begin, worked, pause = monotonic(), _seconds_of(process), limit
            while not ended.wait(pause):
                pause = max(limit - (_seconds_of(process) - worked), 0.0)
                if not pause or monotonic() - begin > _PATIENCE * limit:
                    late.set()
                    process.kill()
                    return

        threading.Thread(target=watch, daemon=True).start()
        try:
            process.stdin.write(json.dumps(asked) + "\n")
            process.stdin.flush()
            line = process.stdout.readline()
        except OSError:
            line = ""
        finally:
            ended.set()
        if not line.endswith("\n") or roots:  # it was ended; or what it has read of libraries takes memory
            _end()
    if late.is_set():
        raise BuildError(
            f"{tree.shown(tree.main)}: the Modelica compiler did not end within {limit:g} s for {model}"
        )
    if not line.endswith("\n"):
        return Answer(refusal="it ended without a message")
    return Answer(**json.loads(restored(line)))


def _seconds_of(process: subprocess.Popen[str]) -> float:
    """Processor time of a process [s]; where the system does not say, the clock."""
    try:
        fields = Path(f"/proc/{process.pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    except (OSError, IndexError, ValueError):
        return monotonic()


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
