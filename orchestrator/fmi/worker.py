"""The process of an isolated instance: it does what it is reported over a pipe until the pipe ends."""

from __future__ import annotations

import os
import pickle
from pathlib import Path
from typing import Any

import numpy as np

from ..base.errors import FmuError, OrchestratorError, StepError
from ..base.temporary_folders import remove_scratch
from . import messages as frames
from .child_process import guarded_pipes
from .instance import Point
from .log_file import logs_in


class _UnpackedByParent:
    """An FMU that was unpacked by the process that started this one, and is removed by it."""

    corrupt = False

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def acquire(self) -> Path:
        return self._folder

    def release(self) -> None: ...


class _Server:
    """Holds the instance."""

    def __init__(self) -> None:
        self.instance: Any = None
        self._u = self._y = np.zeros(0)
        self._states: dict[int, Any] = {}
        self._sent_log: tuple[str, ...] = ()

    def instantiate(
        self, name: str, path: Path, description: Any, run_options: Any, folder: Path, logs: Path | None
    ) -> None:
        from .loading import instance_class

        made = instance_class(description)
        with logs_in(logs):
            self.instance = made(name, path, description, _UnpackedByParent(folder), run_options)

    def bind(self, inputs: list[str], outputs: list[str]) -> None:
        self._u, self._y = np.zeros(len(inputs)), np.zeros(len(outputs))
        self.instance.bind(inputs, self._u, outputs, self._y)

    def write_inputs(self, values: bytes) -> None:
        self._u[:] = np.frombuffer(values)
        self.instance.write_inputs()

    def read_outputs(self) -> bytes:
        self.instance.read_outputs()
        return self._y.tobytes()

    def free(self) -> None:
        if self.instance is not None:
            self.instance.free()

    def save_state(self) -> int:
        handle = max(self._states, default=0) + 1
        self._states[handle] = self.instance.save_state()
        return handle

    def restore_state(self, handle: int) -> None:
        self.instance.restore_state(self._states[handle])

    def free_state(self, handle: int) -> None:
        self.instance.free_state(self._states.pop(handle))

    def serialise_state(self, handle: int) -> bytes:
        return self.instance.serialise_state(self._states[handle])

    def deserialise_state(self, data: bytes) -> int:
        handle = max(self._states, default=0) + 1
        self._states[handle] = self.instance.deserialise_state(data)
        return handle

    def call(self, name: str, arguments: tuple[Any, ...]) -> Any:
        own = getattr(self, name, None)
        return own(*arguments) if own is not None else getattr(self.instance, name)(*arguments)

    def step(self, payload: bytes) -> tuple[bytes, bytes]:
        index, now, step_size, fed = frames.STEP_HEAD.unpack_from(payload)
        if fed:
            self.write_inputs(payload[frames.STEP_HEAD.size :])
        status = self.instance.do_step(Point(index, now, step_size))
        outputs = b""
        if status <= 1:
            self.instance.read_outputs()
            outputs = self._y.tobytes()
        lines = self.instance.log_lines()
        if lines != self._sent_log:
            self._sent_log = lines
            return frames.NEWS, pickle.dumps((int(status), lines, outputs))
        return frames.DONE, bytes((status,)) + outputs


def _packed(error: OrchestratorError) -> bytes:
    if isinstance(error, StepError):
        fields = {
            "what": error.what,
            "instance": error.instance,
            "time": error.time,
            "status": error.status,
            "log": error.log,
            "remedy": error.remedy,
        }
        return pickle.dumps(("StepError", fields))
    return pickle.dumps(("FmuError", str(error)))


def main() -> None:
    """Serve until the pipe ends."""
    commands, answers = guarded_pipes()
    server = _Server()
    frames.send(answers, frames.VALUE, pickle.dumps(None))
    while True:
        try:
            kind, payload = frames.receive(commands)
        except EOFError:
            break
        try:
            if kind == frames.STEP:
                answer = server.step(payload)
            else:
                answer = frames.VALUE, pickle.dumps(server.call(*pickle.loads(payload)))
        except OrchestratorError as error:
            answer = frames.ERROR, _packed(error)
        except Exception as error:
            # Nothing but an answer gets out of this process.
            failure = FmuError(f"its process failed: {type(error).__name__}: {error}")
            answer = frames.ERROR, _packed(failure)
        try:
            frames.send(answers, *answer)
        except OSError:
            break
    remove_scratch()
    os._exit(0)  # the FMU's own threads and exit handlers are not waited for
