"""FMUs from files, of FMI 1.0, 2.0 and 3.0.

Within a step every instance gets one call that sets its inputs, one that steps, and one that reads its
outputs: FMI 2 denies slaves further rounds of set and get at a communication point (FMI 2.0.4, 4.2.4).
"""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from ctypes import CFUNCTYPE, POINTER, addressof, c_char_p, c_double, c_int, c_size_t, c_uint, c_void_p, cast
from dataclasses import replace
from functools import cached_property, lru_cache, partial
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..errors import FmuError, StepError
from .archive import Unpacked
from .block import Block
from .description import ModelDescription, read_description
from .handling import Handling, Interface
from .instance import Array, FmuInstance, Point, StepStatus
from .variable import Kind, Value, Variable

__all__ = ["Block", "CompiledFmu", "CompiledInstance", "NativeCalls", "load_fmu"]

STATUS = {0: "ok", 1: "warning", 2: "discard", 3: "error", 4: "fatal", 5: "pending"}
FATAL = 4


class CompiledFmu:
    """A .fmu file; see the Fmu protocol.

    Raises: FmuError if it is missing, malformed or has no interface that can be run.
    """

    def __init__(self, path: Path, handling: Handling = Handling()) -> None:  # noqa: B008 (it is frozen)
        self.path: Path = path
        self.handling = handling
        found = read_description(path, handling.interface)
        if handling.any_step:
            found = replace(found, own_step=None)
        if handling.isolated:
            alone = replace(found.capabilities, once_per_process=False)
            found = replace(found, capabilities=alone)
        self.description: ModelDescription = found
        if handling.event_mode and not self.description.capabilities.event_mode:
            raise FmuError(
                f"{path}: event_mode is asked for, which needs an FMI 3.0 co-simulation FMU that declares "
                f"hasEventMode\n  It is run as {self.description.interface} of FMI "
                f"{self.description.fmi_version}; take event_mode away."
            )

    @cached_property
    def _unpacked(self) -> Unpacked:
        return Unpacked(self.path, self.description.fmi_version, self.description.model_identifier)

    def check(self) -> None:
        """Raises: FmuError if it cannot run on this platform."""
        self._unpacked.check()

    def instantiate(self, name: str) -> FmuInstance:
        """Unpack, load and instantiate. Raises: FmuError."""
        if self.handling.isolated:
            from .isolated import IsolatedInstance

            return IsolatedInstance(name, self.path, self.description, self.handling, self._unpacked)
        made = instance_class(self.description)
        return made(name, self.path, self.description, self._unpacked, self.handling)

    def checksum(self) -> str:
        """SHA-256 of the file."""
        return "sha256:" + hashlib.sha256(self.path.read_bytes()).hexdigest()


_KINDS = {
    ("1", Interface.CO_SIMULATION): (".fmi1", "Fmi1Instance"),
    ("2", Interface.CO_SIMULATION): (".fmi2", "Fmi2Instance"),
    ("3", Interface.CO_SIMULATION): (".fmi3", "Fmi3Instance"),
    ("1", Interface.MODEL_EXCHANGE): (".exchange1", "Fmi1Exchange"),
    ("2", Interface.MODEL_EXCHANGE): (".exchange2", "Fmi2Exchange"),
    ("3", Interface.MODEL_EXCHANGE): (".exchange3", "Fmi3Exchange"),
}


def instance_class(description: ModelDescription) -> Callable[..., CompiledInstance]:
    """The class whose instances run an FMU in this process."""
    # Loading fmpy's bindings is left until something runs.
    module, name = _KINDS[description.fmi_version[0], description.interface]
    return getattr(import_module(module, __package__), name)


@lru_cache(maxsize=256)
def _load(path: Path, modified: int, size: int, handling: Handling) -> CompiledFmu:
    return CompiledFmu(path, handling)


def load_fmu(path: Path, handling: Handling = Handling()) -> CompiledFmu:  # noqa: B008 (it is frozen)
    """The FMU of a file, read once as long as the file stays the same. Raises: FmuError."""
    if not path.is_file():
        raise FmuError(f"{path}: no such file")
    found = path.stat()
    return _load(path.resolve(), found.st_mtime_ns, found.st_size, handling)


class NativeCalls(NamedTuple):
    """What a loop outside the interpreter has to call; memory and functions live as long as the instance.

    Attributes:
        version: of FMI, 2 or 3.
        component: the FMU's handle.
        step: address of the step function.
        no_rollback: whether no state is kept.
        returned: addresses where an FMI 3 step tells: event, terminate, early return, time reached.
        inputs, outputs: what is set before a step and read after it.
    """

    version: int
    component: int
    step: int
    no_rollback: bool
    returned: tuple[int, int, int, int]
    inputs: tuple[Block, ...]
    outputs: tuple[Block, ...]


class CompiledInstance(ABC):
    """What instances of all versions of FMI have in common; see the FmuInstance protocol."""

    # Names of functions that differ between the versions in no more than that.
    _INSTANTIATE = _EXIT = _TERMINATE = _FREE = ""

    def __init__(
        self,
        name: str,
        path: Path,
        description: ModelDescription,
        unpacked: Unpacked,
        handling: Handling,
    ) -> None:
        from .library import LogBook, load_library

        self.name = name
        self.path = path
        self.description = description
        self.handling = handling
        self._unpacked = unpacked
        self._time: float | None = None
        self._freed = False
        self._saved_states = 0
        self._arrays: dict[int, Any] = {}
        self._inputs: list[Block] = []
        self._outputs: list[Block] = []
        self._slave: Any = None
        self._component: Any = None
        self._log = LogBook(name)
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
    def _accessor(self, variable: Variable, verb: str) -> tuple[Any, Any]:
        """ctypes type of the variable's values and the function that gets or sets them."""

    @abstractmethod
    def _enter(self, start_time: float, stop_time: float | None) -> None: ...

    @abstractmethod
    def _derivative(
        self, unknowns: Any, counts: tuple[int, int], knowns: Any, seed: Any, answer: Any
    ) -> None: ...

    @abstractmethod
    def do_step(self, point: Point) -> StepStatus:
        """Step from `point` by its step size."""

    # For loops outside the interpreter.

    def native_calls(self) -> NativeCalls | None:
        """What `write_inputs`, `do_step` and `read_outputs` call; None if they do more than that."""
        return None

    def judge_step(self, status: int, point: Point) -> StepStatus:
        """What a status that the step function returned means; only where there are native calls.

        Raises: StepError.
        """
        raise NotImplementedError

    def _moves_plainly(self) -> bool:
        """Whether every bound port is moved as it is: no aliases that negate, no parts of arrays."""
        return all(block.plain for block in (*self._inputs, *self._outputs))

    def stand_at(self, time: float) -> None:
        """Note that the last step taken began at `time` [s]."""
        self._time = time

    def fail_block(self, block: Block, status: int) -> None:
        """Raises: StepError for a get or set function that returned `status`."""
        self._fail(block.name, status)

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

    def _fail(self, function: str, status: int) -> None:
        if status >= FATAL:
            self._unpacked.corrupt = True
        label = STATUS.get(status, f"illegal status {status}")
        what = f"{function} returned {label}"
        raise StepError(what, instance=self.name, time=self._time, status=label, log=self.log_lines())

    def log_lines(self) -> tuple[str, ...]:
        """The latest lines that the FMU logged, oldest first."""
        return self._log.lines()

    def _instantiation_failed(self) -> FmuError:
        lines = "".join(f"\n    {line}" for line in self.log_lines())
        log = f"\n  log of the FMU:{lines}" if lines else "\n  The FMU logged nothing."
        return FmuError(f"{self.path}: instance {self.name} could not be made{log}")

    # Ports.

    def bind(self, inputs: Sequence[str], u: Array, outputs: Sequence[str], y: Array) -> None:
        """See FmuInstance.bind."""
        self._inputs = self._blocks(inputs, u, "Set")
        self._outputs = self._blocks(outputs, y, "Get")

    def _blocks(self, names: Sequence[str], memory: Array, verb: str) -> list[Block]:
        if memory.dtype != np.float64 or not memory.flags.c_contiguous or memory.shape != (len(names),):
            raise ValueError(
                f"{self.name}: memory for {len(names)} ports must be contiguous float64 of that length"
            )
        groups: dict[str, list[tuple[int, Variable]]] = {}
        for position, name in enumerate(names):
            variable = self.description.variables[name]
            groups.setdefault(variable.type, []).append((position, variable))
        blocks = []
        for fmi_type, ports in groups.items():
            ctype, function = self._accessor(ports[0][1], verb)
            block = Block(fmi_type, ctype, function.__name__, ports, memory)
            block.address = cast(function, c_void_p).value or 0
            block.call = self._bare(function, block)
            if verb == "Set" and block.partial:
                block.refill = self._bare(self._accessor(ports[0][1], "Get")[1], block)
            blocks.append(block)
        return blocks

    def _bare(self, function: Any, block: Block) -> Callable[[], int]:
        """A get or set function with its arguments already converted, which halves the cost of a call."""
        addresses = [c_void_p(addressof(block.references)), c_void_p(addressof(block.values))]
        arguments = [c_void_p(self._component), addresses[0], c_size_t(len(block.references)), addresses[1]]
        if self.description.fmi_version.startswith("3"):
            arguments.append(c_size_t(len(block.values)))  # FMI 3 counts values besides references
        types = [type(argument) for argument in arguments]
        return partial(CFUNCTYPE(c_int, *types)(cast(function, c_void_p).value), *arguments)

    def _complete_arrays(self) -> None:
        """Elements of input arrays that are fed by nothing keep their start values."""
        for block in self._inputs:
            if block.refill is not None:
                status = block.refill()
                if status > 1:
                    self._fail(block.name.replace("Set", "Get"), status)

    def write_inputs(self) -> None:
        """Send the bound inputs to the FMU."""
        for block in self._inputs:
            if not block.direct:
                block.send()
            status = block.call()
            if status > 1:
                self._fail(block.name, status)

    def read_outputs(self) -> None:
        """Fetch the bound outputs from the FMU."""
        for block in self._outputs:
            status = block.call()
            if status > 1:
                self._fail(block.name, status)
            if not block.direct:
                block.fetch()

    def set_values(self, values: Mapping[str, Value]) -> None:
        """Set variables by name, in the FMU's units."""
        arrays: dict[int, Variable] = {}
        for name, value in values.items():
            variable = self.description.variables[name]
            ctype, function = self._accessor(variable, "Set")
            given = value.encode() if isinstance(value, str) else -value if variable.negated else value
            if variable.elements == 1:
                self._access(function, variable, (ctype * 1)(given), ctype)
            else:
                self._array(variable)[variable.element] = given
                arrays[variable.reference] = variable
        for variable in arrays.values():
            ctype, function = self._accessor(variable, "Set")
            self._access(function, variable, self._array(variable), ctype)

    def _array(self, variable: Variable) -> Any:
        """All elements of the array that `variable` belongs to, as they were set last."""
        if variable.reference not in self._arrays:
            ctype, _ = self._accessor(variable, "Set")
            own = [one for one in self.description.variables.values() if one.reference == variable.reference]
            starts = [one.start for one in sorted(own, key=lambda one: one.element)[: variable.elements]]
            buffer = (ctype * variable.elements)()
            # Before initialisation an FMU need not give values: what it declares is asked first.
            if ctype is not c_char_p and None not in starts:
                buffer[:] = starts
            else:
                self._access(self._accessor(variable, "Get")[1], variable, buffer, ctype)
                if ctype is c_char_p:  # the FMU's own texts need not outlive the next call
                    buffer[:] = [bytes(text or b"") for text in buffer]
            self._arrays[variable.reference] = buffer
        return self._arrays[variable.reference]

    def get_values(self, names: Sequence[str]) -> dict[str, Value]:
        """Values of variables by name, in the FMU's units."""
        values: dict[str, Value] = {}
        for name in names:
            variable = self.description.variables[name]
            ctype, function = self._accessor(variable, "Get")
            buffer = (ctype * variable.elements)()
            self._access(function, variable, buffer, ctype)
            value = buffer[variable.element]
            if ctype is c_char_p:
                value = (value or b"").decode("utf-8", errors="replace")
            elif variable.negated:
                value = -value
            values[name] = bool(value) if variable.kind is Kind.BOOLEAN else value
        return values

    def _access(self, function: Any, variable: Variable, buffer: Any, ctype: Any) -> None:
        reference = (c_uint * 1)(variable.reference)
        extra = (len(buffer),) if self.description.fmi_version.startswith("3") else ()
        status = function(self._component, reference, 1, cast(buffer, POINTER(ctype)), *extra)
        if status > 1:
            self._fail(f"{function.__name__} of {variable.name}", status)

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
        if self._unpacked.corrupt:
            return
        self._call(self._TERMINATE)

    def free(self) -> None:
        """Release the instance, its library and, after the last instance, the unpacked files."""
        if self._freed:
            return
        self._freed = True
        try:
            if not self._unpacked.corrupt:
                if self._component is not None:
                    self._function(self._FREE)(self._component)
                if self._slave is not None:
                    self._slave.freeLibrary()
        finally:
            self._component = None
            self._inputs, self._outputs = [], []
            self._log.close()
            self._unpacked.release()

    def last_successful_time(self) -> float | None:
        """How far a discarded step came [s]; None where the FMU does not say."""
        return None

    def _need(self, capability: str, flag: str) -> None:
        if not getattr(self.description.capabilities, capability):
            raise FmuError(
                f"{self.path}: instance {self.name} cannot do this, since the FMU does not declare {flag}"
            )

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.name} of {self.path.name}>"
