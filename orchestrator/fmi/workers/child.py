"""A process that does one task after the other, seen from the process that started it."""

from __future__ import annotations

import json
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from time import monotonic
from typing import Any

from ...base.errors import OrchestratorError
from ...base.temporary_folders import scratch_root
from .. import messages as frames
from .tasks import Attempt, Failure, Work

_LINES_OF_OUTPUT = 10
# So many processes are started where one after the other is killed from outside while it begins.
_BEGINS = 3
_START = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from orchestrator.fmi.workers.serve import main; main()"
)
# Whatever the numerical libraries beneath numpy are, one of these holds their threads.
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


class Child:
    """One process; not for several threads at once."""

    def __init__(self, work: Work, folder: Path | None) -> None:
        """Start it and have it prepare.

        Raises: OrchestratorError if it cannot.
        """
        self._work = work
        self._expired = False
        self._ended = False
        # The exchange that a time limit runs for; guarded, since the limit's own thread looks at it.
        self._limited: object | None = None
        self._guard = threading.Lock()
        # Ended at once, the process tidies nothing up: FMUs that it has unpacked go with this folder.
        self._temporary = tempfile.TemporaryDirectory(
            prefix="worker-", dir=scratch_root(), ignore_cleanup_errors=True
        )
        # Appended to, so that it can be cut short between tasks.
        self._output = tempfile.TemporaryFile("ab+", prefix="worker-output-")
        root = str(Path(__file__).resolve().parents[2])
        paths = json.dumps([root, *(os.path.abspath(one) for one in sys.path if one)])
        environment = os.environ | dict.fromkeys(("TMPDIR", "TEMP", "TMP"), self._temporary.name)
        if work.threads is not None:
            environment |= dict.fromkeys(_THREADS, str(work.threads))
        # -P: files in the working directory must not pose as modules.
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", _START, paths],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._output,
            bufsize=0,
            env=environment,
        )
        assert self._process.stdin is not None and self._process.stdout is not None
        self._commands, self._answers = self._process.stdin.fileno(), self._process.stdout.fileno()
        made = self._exchange((work.function, work.prepare, work.payload, folder), None)
        if made.failure is not None:
            self.end()
            lines = "".join(f"\n    {line}" for line in made.failure.log)
            kind = KilledError if made.failure.kind == "killed" else OrchestratorError
            raise kind(f"a worker could not begin: {made.failure.message}{lines}")
        self._size = made.value

    @property
    def alive(self) -> bool:
        """Whether it takes tasks."""
        return not self._ended and self._process.poll() is None

    def do(self, task: Any) -> Attempt:
        """Do a task. After a crash or an expired time limit the process is gone."""
        with suppress(OSError):
            self._output.truncate(0)
        return self._exchange(task, self._work.time_limit)

    def grown(self) -> bool:
        """Whether it has grown beyond what the work allows."""
        return self._work.recycle is not None and self._grown > self._work.recycle

    def end(self) -> None:
        """End it at once."""
        if self._ended:
            return
        self._ended = True
        with suppress(OSError):
            self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout, self._output):
            with suppress(OSError):
                pipe.close()  # type: ignore[union-attr]
        self._temporary.cleanup()

    _grown = 0

    def _exchange(self, message: Any, limit: float | None) -> Attempt:
        begin = monotonic()
        watch: threading.Timer | None = None
        if limit is not None:
            self._limited = exchange = object()
            watch = threading.Timer(limit, self._expire, [exchange])
            watch.daemon = True
            watch.start()
        answer = None
        try:
            with suppress(OSError):  # it ended before: the missing answer shows that
                frames.send(self._commands, frames.CALL, pickle.dumps(message))
            kind, payload = frames.receive(self._answers)
            answer = pickle.loads(payload)
        except (EOFError, OSError):
            pass
        finally:
            # A limit that is over from here on comes too late; its thread may be at work already.
            with self._guard:
                self._limited = None
            if watch is not None:
                watch.cancel()
        if answer is None:
            return Attempt(None, self._death(limit), monotonic() - begin)
        value, self._grown = answer
        seconds = monotonic() - begin
        if self._expired:
            self.end()  # while the answer was read: that counts, but the process takes no more tasks
        if kind == frames.ERROR:
            return Attempt(None, Failure("error", value), seconds)
        return Attempt(value, None, seconds)

    def _expire(self, exchange: object) -> None:
        with self._guard:
            if self._limited is not exchange:
                return
            self._expired = True
            with suppress(OSError):
                self._process.kill()

    def _death(self, limit: float | None) -> Failure:
        """Why there was no answer."""
        with suppress(OSError):
            os.close(os.dup(self._answers))
        try:
            status = self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            status = self._process.wait()
        log = self._last_lines()
        ended, expired = self._ended, self._expired
        self.end()
        if expired:
            return Failure("time limit", f"took longer than {limit:g} s, and was ended", log)
        if ended or status == -getattr(signal, "SIGKILL", 9):
            return Failure("killed", "its process was killed from outside", log)
        try:
            how = f"died of {signal.Signals(-status).name}" if status < 0 else f"ended with status {status}"
        except ValueError:
            how = f"died of signal {-status}"
        return Failure("crash", f"its process {how}", log)

    def _last_lines(self) -> tuple[str, ...]:
        try:
            self._output.seek(0, os.SEEK_END)
            self._output.seek(max(self._output.tell() - (1 << 14), 0))
            lines = self._output.read().decode("utf-8", errors="replace").splitlines()
        except (OSError, ValueError):
            return ()
        return tuple(line for line in lines if line.strip())[-_LINES_OF_OUTPUT:]


class KilledError(OrchestratorError):
    """A process was killed from outside before it could begin."""


def _started(make: Callable[[], Child]) -> Child:
    """A process that has begun; one that is killed from outside while it does is no fault of its task."""
    for _ in range(_BEGINS - 1):
        try:
            return make()
        except KilledError:
            continue
    return make()


def attempt(
    child: Child | None, make: Callable[[], Child], task: Any, work: Work
) -> tuple[Child | None, Attempt, int]:
    """Do a task, on a fresh process where the last one is gone, as often as the work's policy has it.

    Args:
        child: the process to use; None: none yet.
        make: starts one.
    Returns: the process for the next task, None if it is gone; what came out; how many attempts it took.
    """
    attempts = 0
    while True:
        if child is None or not child.alive:
            if child is not None:
                child.end()
            child = _started(make)
        made = child.do(task)
        attempts += 1
        if not child.alive or child.grown():
            child.end()
            child = None
        if made.failure is None or not work.retry.again(made.failure, attempts):
            return child, made, attempts
