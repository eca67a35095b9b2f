"""What running instances of FMUs from files have in common, whatever their version of FMI.

Within a step every instance gets one call that sets its inputs, one that steps, and one that reads its
outputs: FMI 2 denies slaves further rounds of set and get at a communication point (FMI 2.0.4, 4.2.4).
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from ctypes import byref, c_double, c_int, c_size_t, c_uint, c_void_p
from pathlib import Path
from time import sleep
from typing import Any, ClassVar, NamedTuple, NoReturn

import numpy as np

from ..base.errors import FmuError, StepError
from .archive import Unpacked
from .block import Block, Unfit
from .description import ModelDescription
from .instance import Array, Point, StepStatus
from .run_options import RunOptions
from .values import Values
from .variable import Value

STATUS = {0: "ok", 1: "warning", 2: "discard", 3: "error", 4: "fatal", 5: "pending"}
FATAL, PENDING = 4, 5
# Of discrete states that are to settle.
MOST_ITERATIONS = 10_000
# Of the log in a message.
_LOG_LINES = 10
_DO_STEP_STATUS, _LAST_SUCCESSFUL_TIME = 0, 2


class NativeCalls(NamedTuple):
    """What a loop outside the interpreter has to call; memory and functions live as long as the instance.

    Attributes:
        version: of FMI, 2 or 3.
        component: the FMU's handle.
        step: address of the step function.
        no_rollback: whether no state is kept.
        returned: addresses to which a step writes: event, terminate, early return, time reached.
        asked: addresses of functions that FMI 2 gives terminate and time reached by; 0 without one.
        inputs, outputs: what is set before a step and read after it.
        bend: address of the function that takes derivatives of inputs; 0 without one.
    """

    version: int
    component: int
    step: int
    no_rollback: bool
    returned: tuple[int, int, int, int]
    inputs: tuple[Block, ...]
    outputs: tuple[Block, ...]
    bend: int = 0
    asked: tuple[int, int] = (0, 0)


class CompiledInstance(Values):
    """What instances of all versions of FMI have in common; see the FmuInstance protocol."""

    # Names of functions that differ between the versions in no more than that.
    _INSTANTIATE = _EXIT = _TERMINATE = _FREE = _RESET = _STATUS = _REAL_STATUS = _BEND = ""

    def __init__(
        self,
        name: str,
        path: Path,
        description: ModelDescription,
        unpacked: Unpacked,
        run_options: RunOptions,
    ) -> None:
        from .library import LogBook, load_library

        super().__init__(name, description)
        self.path = path
        self.run_options = run_options
        self._unpacked = unpacked
        self._time: float | None = None
        self._freed = False
        self._saved_states = 0
        self._slave: Any = None
        self._log = LogBook(name, lambda: self._time)
        folder = unpacked.acquire()
        try:
            self._slave = load_library(path, folder, description, name)
            self._instantiate()
        except BaseException:
            self.free()
            raise

    # What differs between the versions.

    @abstractmethod
    def _instantiate(self) -> None: ...

    @abstractmethod
    def _enter(self, start_time: float, stop_time: float | None) -> None: ...

    @abstractmethod
    def _derivative(
        self, unknowns: Any, counts: tuple[int, int], knowns: Any, seed: Any, answer: Any
    ) -> None: ...

    @abstractmethod
    def do_step(self, point: Point) -> StepStatus:
        """Step from `point` by its step size."""

    def _tolerance_arguments(self) -> tuple[bool, float]:
        """What initialisation hands over: whether a tolerance is defined, and which.

        Only one that the config gives: an FMU knows the one that it proposes itself.
        """
        tolerance = self.run_options.tolerance
        return tolerance is not None, tolerance or 0.0

    # For loops outside the interpreter.

    def native_calls(self) -> NativeCalls | None:
        """What `write_inputs`, `do_step` and `read_outputs` call; None if they do more than that."""
        return None

    def step_status(self, status: int, point: Point) -> StepStatus:
        """What a status that the step function returned means; only where there are native calls.

        Raises: StepError.
        """
        raise NotImplementedError

    def stand_at(self, time: float) -> None:
        """Note that the last step taken began at `time` [s]."""
        self._time = time

    def fail_block(self, block: Block, status: int) -> None:
        """Raises: StepError for a get or set function that returned `status`."""
        self._fail(block.name, status)

    def fail_derivatives(self, status: int) -> None:
        """Raises: StepError for a function that took derivatives of inputs and returned `status`."""
        self._fail(self._BEND, status)

    # Calls and their failures.

    def _function(self, name: str) -> Any:
        function = self._slave._functions.get(name)
        if function is None:
            raise FmuError(f"{self.path}: its library has no function {name}, which is needed here")
        return function

    def _call(self, name: str, *arguments: Any) -> int:
        status = self._function(name)(self._component, *arguments)
        if status > 1:
            self._fail(name, status)
        return status

    def _fail(self, function: str, status: int) -> NoReturn:
        if status >= FATAL:
            self._unpacked.corrupt = True
        label = STATUS.get(status, f"illegal status {status}")
        what = f"{function} returned {label}"
        raise StepError(what, instance=self.name, time=self._time, status=label, log=self.log_lines())

    def _refuse(self, error: Unfit) -> NoReturn:
        remedy = "Give it a value within, or scale what feeds it."
        raise StepError(
            str(error),
            instance=self.name,
            time=self._time,
            status="out of range",
            log=self.log_lines(),
            remedy=remedy,
        ) from None

    def log_lines(self) -> tuple[str, ...]:
        """The latest lines that the FMU logged, oldest first."""
        return self._log.lines()

    def _unsettled(self, function: str) -> StepError:
        """What to raise where `function` was called MOST_ITERATIONS times and wants another call."""
        return StepError(
            f"its discrete states do not settle: {function} wants a {MOST_ITERATIONS + 1}th call",
            instance=self.name,
            time=self._time,
            status="event iteration",
            log=self.log_lines(),
        )

    def _wait(self) -> int:
        """The status of a step that is computed asynchronously, once it is known; FMI 1 and 2."""
        function = self._function(self._STATUS)
        status, pause = c_int(PENDING), 1e-5
        while status.value == PENDING:
            sleep(pause)
            pause = min(2 * pause, 1e-3)
            got = function(self._component, _DO_STEP_STATUS, byref(status))
            if got > 1:
                self._fail(self._STATUS, got)
        return status.value

    def _instantiation_failed(self) -> FmuError:
        lines = "".join(f"\n    {line}" for line in self.log_lines()[-_LOG_LINES:])
        log = f"\n  log of the FMU:{lines}" if lines else "\n  The FMU logged nothing."
        return FmuError(f"{self.path}: instance {self.name} could not be made{log}")

    # Derivatives.

    def output_derivatives(self, outputs: Sequence[str], inputs: Sequence[str]) -> Array:
        """See FmuInstance.output_derivatives."""
        rows, columns = len(outputs), len(inputs)
        matrix = np.zeros((rows, columns))
        if not matrix.size:
            return matrix
        variables = self.description.variables
        unknowns = (c_uint * rows)(*(variables[name].reference for name in outputs))
        knowns = (c_uint * columns)(*(variables[name].reference for name in inputs))
        answer = (c_double * rows)()
        for column in range(columns):
            seed = (c_double * columns)(*(float(other == column) for other in range(columns)))
            self._derivative(unknowns, (rows, columns), knowns, seed, answer)
            matrix[:, column] = answer
        return matrix

    # Life.

    def enter_initialisation(
        self, start_time: float, start_values: Mapping[str, Value], stop_time: float | None = None
    ) -> None:
        """See FmuInstance.enter_initialisation."""
        self.set_values(start_values)
        self._enter(start_time, stop_time)

    def exit_initialisation(self) -> None:
        """Leave initialisation mode."""
        self._complete_arrays()
        self._call(self._EXIT)

    def terminate(self) -> None:
        """End a run that went well."""
        # Some FMUs have nothing to end, and no function for it.
        if not self._unpacked.corrupt and self._TERMINATE in self._slave._functions:
            self._call(self._TERMINATE)

    @property
    def resettable(self) -> bool:
        """Whether `reset` can be called; FMI 1.0 has no such thing for model exchange."""
        return self._RESET in self._slave._functions

    def reset(self) -> None:
        """Go back to where the instance stood when it was made, start values included. Raises: StepError."""
        self._call(self._RESET)
        self._log.clear()
        self._arrays.clear()
        self._time = None

    def free(self) -> None:
        """Release the instance, its library and, after the last instance, the unpacked files."""
        if self._freed:
            return
        self._freed = True
        try:
            if not self._unpacked.corrupt:
                if self._component is not None and self._FREE in self._slave._functions:
                    self._function(self._FREE)(self._component)
                if self._slave is not None:
                    self._slave.freeLibrary()
        finally:
            self._component = None
            self._inputs, self._outputs = [], []
            self._log.close()
            self._unpacked.release()

    def last_successful_time(self) -> float | None:
        """See FmuInstance.last_successful_time."""
        function = self._slave._functions.get(self._REAL_STATUS)
        value = c_double(0.0)
        if function is None or function(self._component, _LAST_SUCCESSFUL_TIME, byref(value)) > 1:
            return None
        return value.value

    def _need(self, capability: str, flag: str) -> None:
        if not getattr(self.description.capabilities, capability):
            raise FmuError(
                f"{self.path}: instance {self.name} cannot do this, since the FMU does not declare {flag}"
            )

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.name} of {self.path.name}>"


class StatefulInstance(CompiledInstance):
    """An instance of a version of FMI that has saved states.

    Attributes:
        _SAVE, _RESTORE, _DROP, _SIZE, _WRITE, _READ: the version's functions for them.
        _BYTE: its type of a byte; _FLAGS: what declares that states can be saved, and serialised.
    """

    _SAVE = _RESTORE = _DROP = _SIZE = _WRITE = _READ = ""
    _BYTE: ClassVar[Any]
    _FLAGS: ClassVar[tuple[str, str]]

    def save_state(self) -> c_void_p:
        """See FmuInstance.save_state."""
        self._need("save_state", self._FLAGS[0])
        state = c_void_p()
        self._call(self._SAVE, byref(state))
        self._saved_states += 1
        return state

    def restore_state(self, state: c_void_p) -> None:
        """See FmuInstance.restore_state."""
        self._call(self._RESTORE, state)

    def free_state(self, state: c_void_p) -> None:
        """See FmuInstance.free_state."""
        self._call(self._DROP, byref(state))
        self._saved_states -= 1

    def serialise_state(self, state: c_void_p) -> bytes:
        """See FmuInstance.serialise_state."""
        self._need("serialise_state", self._FLAGS[1])
        size = c_size_t()
        self._call(self._SIZE, state, byref(size))
        buffer = (self._BYTE * size.value)()
        self._call(self._WRITE, state, buffer, size)
        return bytes(buffer)

    def deserialise_state(self, data: bytes) -> c_void_p:
        """See FmuInstance.deserialise_state."""
        self._need("serialise_state", self._FLAGS[1])
        state = c_void_p()
        self._call(self._READ, (self._BYTE * len(data)).from_buffer_copy(data), len(data), byref(state))
        self._saved_states += 1
        return state
