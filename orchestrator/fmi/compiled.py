"""FMUs from files, of FMI 2.0 and 3.0, for co-simulation.

Within a step every instance gets one call that sets its inputs, one that steps, and one that reads its
outputs: FMI 2 denies slaves further rounds of set and get at a communication point (FMI 2.0.4, 4.2.4).
"""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from ctypes import CFUNCTYPE, POINTER, addressof, c_char_p, c_double, c_int, c_size_t, c_uint, c_void_p, cast
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FmuError, StepError
from .archive import Unpacked
from .description import ModelDescription, read_description
from .instance import Array, FmuInstance, Point, StepStatus
from .variable import Kind, Value, Variable

__all__ = ["CompiledFmu", "CompiledInstance", "load_fmu"]

STATUS = {0: "ok", 1: "warning", 2: "discard", 3: "error", 4: "fatal", 5: "pending"}
FATAL = 4


class CompiledFmu:
    """A .fmu file; see the Fmu protocol.

    Raises: FmuError if it is missing, malformed or has no co-simulation interface of FMI 2.0 or 3.0.
    """

    def __init__(self, path: Path) -> None:
        self.path: Path = path
        self.description: ModelDescription = read_description(path)

    @cached_property
    def _unpacked(self) -> Unpacked:
        return Unpacked(self.path, self.description.fmi_version, self.description.model_identifier)

    def check(self) -> None:
        """Raises: FmuError if it cannot run on this platform."""
        self._unpacked.check()

    def instantiate(self, name: str) -> FmuInstance:
        """Unpack, load and instantiate. Raises: FmuError."""
        # Loading fmpy's bindings is left until something runs.
        if self.description.fmi_version.startswith("2"):
            from .fmi2 import Fmi2Instance as Version
        else:
            from .fmi3 import Fmi3Instance as Version
        return Version(name, self.path, self.description, self._unpacked)

    def checksum(self) -> str:
        """SHA-256 of the file."""
        return "sha256:" + hashlib.sha256(self.path.read_bytes()).hexdigest()


@lru_cache(maxsize=256)
def _load(path: Path, modified: int, size: int) -> CompiledFmu:
    return CompiledFmu(path)


def load_fmu(path: Path) -> CompiledFmu:
    """The FMU of a file, read once as long as the file stays the same. Raises: FmuError."""
    if not path.is_file():
        raise FmuError(f"{path}: no such file")
    found = path.stat()
    return _load(path.resolve(), found.st_mtime_ns, found.st_size)


class _Block:
    """Ports of one FMI type: one call moves all of them between the FMU and memory."""

    def __init__(
        self, fmi_type: str, ctype: Any, name: str, references: list[int], positions: list[int], memory: Array
    ) -> None:
        count = len(references)
        self.name = name
        self.references = (c_uint * count)(*references)
        self.memory = memory
        self.positions = positions
        run = slice(positions[0], positions[0] + count)
        # Doubles that lie side by side are moved where they are; anything else goes by way of a buffer.
        self.direct = ctype is c_double and positions == list(range(run.start, run.stop))
        self.values = (ctype * count).from_buffer(memory[run]) if self.direct else (ctype * count)()
        self.real = fmi_type in ("Real", "Float64", "Float32")
        self.call: Callable[[], int] = lambda: 0

    def fetch(self) -> None:
        """Buffer -> memory."""
        for position, value in zip(self.positions, self.values, strict=True):
            self.memory[position] = value

    def send(self) -> None:
        """Memory -> buffer."""
        if self.real:
            self.values[:] = self.memory[self.positions].tolist()
        else:
            self.values[:] = [round(value) for value in self.memory[self.positions].tolist()]


class CompiledInstance(ABC):
    """What instances of FMI 2.0 and 3.0 have in common; see the FmuInstance protocol."""

    def __init__(self, name: str, path: Path, description: ModelDescription, unpacked: Unpacked) -> None:
        from .library import LogBook, load_library

        self.name = name
        self.path = path
        self.description = description
        self._unpacked = unpacked
        self._time: float | None = None
        self._freed = False
        self._saved_states = 0
        self._inputs: list[_Block] = []
        self._outputs: list[_Block] = []
        self._slave: Any = None
        self._component: Any = None
        self._log = LogBook(name)
        folder = unpacked.acquire()
        try:
            self._slave = load_library(
                path, folder, description.fmi_version, description.token, description.model_identifier, name
            )
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

    def _blocks(self, names: Sequence[str], memory: Array, verb: str) -> list[_Block]:
        if memory.dtype != np.float64 or not memory.flags.c_contiguous or memory.shape != (len(names),):
            raise ValueError(
                f"{self.name}: memory for {len(names)} ports must be contiguous float64 of that length"
            )
        groups: dict[str, list[int]] = {}
        variables = [self.description.variables[name] for name in names]
        for position, variable in enumerate(variables):
            groups.setdefault(variable.type, []).append(position)
        blocks = []
        for fmi_type, positions in groups.items():
            ctype, function = self._accessor(variables[positions[0]], verb)
            references = [variables[position].reference for position in positions]
            block = _Block(fmi_type, ctype, function.__name__, references, positions, memory)
            block.call = self._bare(
                function, addressof(block.references), len(references), addressof(block.values)
            )
            blocks.append(block)
        return blocks

    def _bare(self, function: Any, references: int, count: int, values: int) -> Callable[[], int]:
        """A get or set function with its arguments already converted, which halves the cost of a call."""
        arguments = [c_void_p(self._component), c_void_p(references), c_size_t(count), c_void_p(values)]
        if not self.description.fmi_version.startswith("2"):
            arguments.append(c_size_t(count))  # FMI 3 counts values besides references
        types = [type(argument) for argument in arguments]
        return partial(CFUNCTYPE(c_int, *types)(cast(function, c_void_p).value), *arguments)

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
        for name, value in values.items():
            variable = self.description.variables[name]
            ctype, function = self._accessor(variable, "Set")
            buffer = (ctype * 1)(value.encode() if isinstance(value, str) else value)
            self._access(function, variable, buffer, ctype)

    def get_values(self, names: Sequence[str]) -> dict[str, Value]:
        """Values of variables by name, in the FMU's units."""
        values: dict[str, Value] = {}
        for name in names:
            variable = self.description.variables[name]
            ctype, function = self._accessor(variable, "Get")
            buffer = (ctype * 1)()
            self._access(function, variable, buffer, ctype)
            value = buffer[0]
            if ctype is c_char_p:
                value = (value or b"").decode("utf-8", errors="replace")
            values[name] = bool(value) if variable.kind is Kind.BOOLEAN else value
        return values

    def _access(self, function: Any, variable: Variable, buffer: Any, ctype: Any) -> None:
        reference = (c_uint * 1)(variable.reference)
        extra = () if self.description.fmi_version.startswith("2") else (1,)
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
        self._call(f"fmi{self.description.fmi_version[0]}ExitInitializationMode")

    def terminate(self) -> None:
        """End a run that went well."""
        if self._unpacked.corrupt:
            return
        self._call(f"fmi{self.description.fmi_version[0]}Terminate")

    def free(self) -> None:
        """Release the instance, its library and, after the last instance, the unpacked files."""
        if self._freed:
            return
        self._freed = True
        try:
            if not self._unpacked.corrupt:
                if self._component is not None:
                    self._function(f"fmi{self.description.fmi_version[0]}FreeInstance")(self._component)
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

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.name} of {self.path.name}>"
