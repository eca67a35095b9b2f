"""An FMU in a process of its own: its crash or hang ends the run with a message, not the program."""

from __future__ import annotations

import pickle
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np

from ..base.errors import FmuError, StepError
from . import messages as frames
from .archive import Unpacked
from .child_process import cause_of_death, end, start_child
from .description import ModelDescription
from .instance import Array, Point, StepStatus
from .log_file import LogFile, PrintedFile, log_folder
from .run_options import RunOptions
from .variable import Value

_LINES_OF_OUTPUT = 10


class IsolatedInstance:
    """An instance that lives in another process; see the FmuInstance protocol.

    Inputs travel with the step, outputs with its answer: a step costs one exchange of messages.
    """

    def __init__(
        self,
        name: str,
        path: Path,
        description: ModelDescription,
        run_options: RunOptions,
        unpacked: Unpacked,
    ) -> None:
        self.name = name
        self.path = path
        self.description = description
        self.run_options = run_options
        self._unpacked = unpacked
        self._time: float | None = None
        self._log: tuple[str, ...] = ()
        self._calling = ""
        self._deadline: float | None = None
        self._expired = False
        self._dead = False
        self._freed = False
        self._fed = False
        self._fresh: bytes | None = None
        self.bind((), np.zeros(0), (), np.zeros(0))
        self._log_file = LogFile.of(name)
        folder = unpacked.acquire()
        self._output = PrintedFile(name)
        try:
            self._start()
            logs = log_folder()
            self._call("instantiate", name, path, description, run_options, folder, logs and logs.absolute())
        except BaseException:
            self.free()
            raise

    # The process.

    def _start(self) -> None:
        self._process = start_child("orchestrator.fmi.worker", self._output.stream)
        assert self._process.stdin is not None and self._process.stdout is not None
        self._commands, self._answers = self._process.stdin.fileno(), self._process.stdout.fileno()
        if self.run_options.time_limit is not None:
            watch = threading.Thread(target=self._watch, args=(self.run_options.time_limit,), daemon=True)
            watch.start()
        self._calling = "start"
        self._answer()  # not timed: it imports

    def _watch(self, limit: float) -> None:
        # A thread that looks now and then costs a call nothing, and works where pipes cannot be waited for.
        while self._process.poll() is None and not self._freed:
            deadline = self._deadline
            if deadline is not None and monotonic() > deadline:
                self._expired = True
                self._process.kill()
                return
            threading.Event().wait(limit / 8)

    def _exchange(self, calling: str, kind: bytes, payload: bytes) -> tuple[bytes, bytes]:
        if self._dead:
            raise self._death()
        self._calling = calling
        if self.run_options.time_limit is not None:
            self._deadline = monotonic() + self.run_options.time_limit
        try:
            frames.send(self._commands, kind, payload)
        except OSError:
            pass  # it ended before: the missing answer shows that
        try:
            return self._answer()
        except (FmuError, StepError):
            raise
        except BaseException:  # interrupted: its answer would be taken for that of the next call
            self._dead = True
            self._process.kill()
            raise
        finally:
            self._deadline = None

    def _answer(self) -> tuple[bytes, bytes]:
        try:
            kind, payload = frames.receive(self._answers)
        except (EOFError, OSError):
            self._dead = True
            raise self._death() from None
        if kind == frames.ERROR:
            name, fields = pickle.loads(payload)
            if name == "FmuError":
                raise FmuError(fields)
            self._log = fields["log"]
            raise StepError(fields.pop("what"), **fields)
        return kind, payload

    def _call(self, name: str, *arguments: Any) -> Any:
        _, payload = self._exchange(name, frames.CALL, pickle.dumps((name, arguments)))
        return pickle.loads(payload)

    def _death(self) -> StepError:
        end(self._process)
        code = self._process.returncode
        if self._expired:
            limit = self.run_options.time_limit
            what = f"{self._calling} did not return within {limit:g} s; its process was ended"
            status = "time limit"
            remedy = f"If the FMU is only slow, raise instances.{self.name}.time_limit."
        else:
            what = f"its process died in {self._calling}: {cause_of_death(code)}"
            status, remedy = "crashed", ""
        lines = (*self._log, *self._printed())
        return StepError(what, instance=self.name, time=self._time, status=status, log=lines, remedy=remedy)

    def _printed(self, most: int | None = _LINES_OF_OUTPUT) -> list[str]:
        """The last lines that the process printed; all without `most`."""
        lines = [line.rstrip() for line in self._output.text().splitlines() if line.strip()]
        return [f"[printed] {line}" for line in (lines if most is None else lines[-most:])]

    # Ports.

    def bind(self, inputs: Sequence[str], u: Array, outputs: Sequence[str], y: Array) -> None:
        """See FmuInstance.bind."""
        self._u, self._y = u, y
        if inputs or outputs:
            self._call("bind", list(inputs), list(outputs))

    def write_inputs(self) -> None:
        """See FmuInstance.write_inputs; they are sent with the next call."""
        self._fed = True

    def read_outputs(self) -> None:
        """See FmuInstance.read_outputs."""
        if self._fresh is None:
            self._fresh = self._flushed("read_outputs")
        self._y[:] = np.frombuffer(self._fresh)

    def _flushed(self, name: str, *arguments: Any) -> Any:
        """A call before which the inputs are sent, and after which outputs must be read again."""
        if self._fed:
            self._fed = False
            self._call("write_inputs", self._u.tobytes())
        self._fresh = None
        return self._call(name, *arguments)

    def set_values(self, values: Mapping[str, Value]) -> None:
        """See FmuInstance.set_values."""
        self._flushed("set_values", dict(values))

    def get_values(self, names: Sequence[str]) -> dict[str, Value]:
        """See FmuInstance.get_values."""
        return self._flushed("get_values", list(names))

    # Life.

    def enter_initialisation(
        self, start_time: float, start_values: Mapping[str, Value], stop_time: float | None = None
    ) -> None:
        """See FmuInstance.enter_initialisation."""
        self._call("enter_initialisation", start_time, dict(start_values), stop_time)

    def exit_initialisation(self) -> None:
        """See FmuInstance.exit_initialisation."""
        self._flushed("exit_initialisation")

    def do_step(self, point: Point) -> StepStatus:
        """See FmuInstance.do_step."""
        self._time = point.time
        payload = frames.STEP_HEAD.pack(point.index, point.time, point.step_size, self._fed)
        if self._fed:
            payload += self._u.tobytes()
            self._fed = False
        self._fresh = None
        kind, answer = self._exchange("do_step", frames.STEP, payload)
        if kind == frames.NEWS:
            status, self._log, outputs = pickle.loads(answer)
        else:
            status, outputs = answer[0], answer[1:]
        if status <= StepStatus.WARNING:
            self._fresh = outputs
        return StepStatus(status)

    def terminate(self) -> None:
        """See FmuInstance.terminate."""
        if not self._dead:
            self._call("terminate")

    def free(self) -> None:
        """See FmuInstance.free; ends the process."""
        if self._freed:
            return
        try:
            process = getattr(self, "_process", None)
            if process is not None:
                try:
                    if not self._dead and process.poll() is None:
                        self._call("free")
                finally:
                    self._dead = True
                    end(process)
        finally:
            self._freed = True
            if self._log_file is not None and (printed := self._printed(None)):
                self._log_file.write(printed, lambda: self._time)
                self._log_file.close()
            self._output.remove()
            self._unpacked.release()

    def log_lines(self) -> tuple[str, ...]:
        """See FmuInstance.log_lines."""
        if not self._dead:
            self._log = self._call("log_lines")
        return self._log

    def last_successful_time(self) -> float | None:
        """See FmuInstance.last_successful_time."""
        return self._call("last_successful_time")

    def write_input_derivatives(self, order: int, values: Array) -> None:
        """See FmuInstance.write_input_derivatives."""
        self._flushed("write_input_derivatives", order, np.array(values))

    def output_derivatives(self, outputs: Sequence[str], inputs: Sequence[str]) -> Array:
        """See FmuInstance.output_derivatives."""
        return self._flushed("output_derivatives", list(outputs), list(inputs))

    # States stay in the process; what is handed out are their numbers.

    def save_state(self) -> int:
        """See FmuInstance.save_state."""
        return self._flushed("save_state")

    def restore_state(self, state: int) -> None:
        """See FmuInstance.restore_state."""
        self._fed, self._fresh = False, None
        self._call("restore_state", state)

    def free_state(self, state: int) -> None:
        """See FmuInstance.free_state."""
        self._call("free_state", state)

    def serialise_state(self, state: int) -> bytes:
        """See FmuInstance.serialise_state."""
        return self._call("serialise_state", state)

    def deserialise_state(self, data: bytes) -> int:
        """See FmuInstance.deserialise_state."""
        return self._call("deserialise_state", data)

    def __repr__(self) -> str:
        return f"<IsolatedInstance {self.name} of {self.path.name}>"
