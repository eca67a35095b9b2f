"""Checks that run an FMU's code, each guarded: a process of its own does them, one after the other.

A check that crashes or hangs costs that process, and is a finding; a new one does the rest.
"""

from __future__ import annotations

import pickle
import shutil
import subprocess
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ...base.errors import FmuError, OrchestratorError
from ...base.temporary_folders import scratch_folder
from ...fmi import Interface, RunOptions
from ...fmi import messages as frames
from ...fmi.child_process import cause_of_death, end, guarded_pipes, start_child
from . import behaviour, sensitivity
from . import robustness as abuse
from .finding import Finding, Level, Verdict, failed
from .trial import Conditions, Ended, Trial, fmu_for_trial

CHECKS: dict[str, Callable[[Trial], Finding]] = {
    "run": behaviour.runs,
    "values": behaviour.values,
    "determinism": behaviour.determinism,
    "reset": behaviour.reset,
    "two instances": behaviour.pair,
    "step halving": behaviour.halving,
    "state": behaviour.state,
    "serialised state": behaviour.serialisation,
    "dependencies": sensitivity.dependencies,
    "directional derivatives": sensitivity.derivatives,
    "refuses a wrong token": abuse.wrong_token,
    **abuse.ILLEGAL,
    "NaN inputs": abuse.nan_inputs,
    "infinite inputs": abuse.infinite_inputs,
}


class Broken(str):
    """How the process died or was ended, instead of an answer."""


class Laboratory:
    """Where the checks of one FMU are done. To be used as a context manager.

    Args:
        time_limit: of each check [s].
    """

    def __init__(
        self, path: Path, conditions: Conditions, time_limit: float, interface: Interface | None = None
    ) -> None:
        self._given = (path.resolve(), conditions, interface)
        self._limit = time_limit
        self._process: subprocess.Popen[bytes] | None = None
        # What the process unpacks is removed even if it dies.
        self._folder = str(scratch_folder("fmu-laboratory-"))
        self._printed = tempfile.TemporaryFile(prefix="fmu-output-")

    def __enter__(self) -> Laboratory:
        return self

    def __exit__(self, *exception: object) -> None:
        self._end()
        self._printed.close()
        shutil.rmtree(self._folder, ignore_errors=True)

    def check(self, name: str) -> Finding:
        """Do a check of CHECKS."""
        answer = self.do(name)
        return self._broken(name, answer) if isinstance(answer, Broken) else answer

    def change(self, conditions: Conditions) -> None:
        """Run the following checks under other conditions."""
        self._given = (self._given[0], conditions, self._given[2])
        if self._process is not None:
            self.do("under", conditions)

    def steps_taken(self) -> int | str:
        """See Trial.steps_taken; a text where the FMU refuses, crashes or hangs."""
        answer = self.do("steps_taken")
        return answer.reason if isinstance(answer, Finding) else answer

    def do(self, name: str, *arguments: Any) -> Any:
        """What the process answers, or Broken."""
        if self._process is None:
            self._process = start_child(__name__, self._printed)
            self._exchange((*self._given, self._folder))
        expired = threading.Event()
        process = self._process

        def stop() -> None:
            expired.set()
            process.kill()

        watch = threading.Timer(self._limit, stop)
        watch.daemon = True
        watch.start()
        try:
            answer, spoiled = self._exchange((name, arguments))
        except (EOFError, OSError):
            process.wait()
            self._end()
            if expired.is_set():
                return Broken(f"it did not come to an end within {self._limit:g} s")
            return Broken(f"its process died: {cause_of_death(process.returncode)}")
        finally:
            watch.cancel()
        if spoiled:
            self._end()
        return answer

    def _exchange(self, message: Any) -> Any:
        assert self._process is not None
        assert self._process.stdin is not None and self._process.stdout is not None
        frames.send(self._process.stdin.fileno(), frames.CALL, pickle.dumps(message))
        return pickle.loads(frames.receive(self._process.stdout.fileno())[1])

    def _end(self) -> None:
        process, self._process = self._process, None
        if process is not None:
            end(process)

    def _broken(self, name: str, how: str) -> Finding:
        remedy = "Run it isolated (instances.<name>.isolate: process), and report it to the FMU's author."
        return failed(name, Level.ERROR, f"{how[0].upper()}{how[1:]}.", remedy)


def _reason(error: Exception) -> str:
    """The message in one line, which may not grow endless."""
    line = " ".join(str(error).split())
    return f"{line[:400].rstrip('.')}."


def _steps_taken(trial: Trial) -> int | Finding:
    try:
        return trial.steps_taken()
    except Exception as error:
        reason = _reason(error) if isinstance(error, (OrchestratorError, Ended)) else f"{error!r}."
        return Finding("run", Verdict.FAILED, reason, Level.ERROR)


def _outcome(trial: Trial, name: str) -> Finding:
    try:
        return CHECKS[name](trial)
    except Exception as error:
        # An FMU can have what no check was made for; the others are done all the same.
        reason = _reason(error) if isinstance(error, (OrchestratorError, Ended)) else f"{error!r}."
        if name == "run":
            return failed(name, Level.ERROR, reason, "Without this nothing else can be tried.")
        return Finding(name, Verdict.NOT_TRIED, reason)


def main() -> None:
    """Do checks until the pipe ends: what the process runs."""
    commands, answers = guarded_pipes()
    path, conditions, interface, folder = pickle.loads(frames.receive(commands)[1])
    tempfile.tempdir = folder
    frames.send(answers, frames.VALUE, pickle.dumps(None))
    trial: Trial | None = None
    while True:
        try:
            name, arguments = pickle.loads(frames.receive(commands)[1])
        except EOFError:
            break
        try:
            if trial is None:
                trial = Trial(fmu_for_trial(path, RunOptions(interface=interface)), conditions)
                # Never left: the files go with the folder, the libraries with the process.
                trial.fmu.unpacked().__enter__()
            if name in CHECKS:
                answer: Any = _outcome(trial, name)
            elif name == "under":
                trial, answer = Trial(trial.fmu, *arguments), None
            elif name == "steps_taken":
                answer = _steps_taken(trial)
            else:
                from .bench_requests import REQUESTS

                answer = REQUESTS[name](trial, *arguments)
        except FmuError as error:
            answer = failed(name, Level.ERROR, _reason(error))
        spoiled = trial is None or trial.fmu.corrupt
        frames.send(answers, frames.VALUE, pickle.dumps((answer, spoiled)))
    _leave()


def _leave() -> None:
    import os

    os._exit(0)  # the FMU's own threads and exit handlers are not waited for
