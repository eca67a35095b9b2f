"""Moving values between a running FMU and memory: ports that are bound, and variables by name."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from ctypes import CFUNCTYPE, POINTER, addressof, c_char_p, c_int, c_size_t, c_uint, c_void_p, cast
from functools import partial
from typing import Any, NoReturn

import numpy as np

from .block import Block, Unfit, check_fit
from .description import ModelDescription
from .instance import Array
from .variable import Kind, Value, Variable


class Values(ABC):
    """The part of an instance that gets and sets; see the FmuInstance protocol."""

    _component: Any = None

    def __init__(self, name: str, description: ModelDescription) -> None:
        self.name = name
        self.description = description
        self._arrays: dict[int, Any] = {}
        self._inputs: list[Block] = []
        self._outputs: list[Block] = []

    @abstractmethod
    def _accessor(self, variable: Variable, verb: str) -> tuple[Any, Any]:
        """Ctypes type of the variable's values and the function that gets or sets them."""

    @abstractmethod
    def _fail(self, function: str, status: int) -> NoReturn:
        """Raises: StepError for a function that returned `status`."""

    @abstractmethod
    def _refuse(self, error: Unfit) -> NoReturn:
        """Raises: StepError for a value that a variable cannot hold."""

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
            self._refill(block)

    def _refill(self, block: Block) -> None:
        if block.refill is not None:
            status = block.refill()
            if status > 1:
                self._fail(block.name.replace("Set", "Get"), status)

    def write_inputs(self) -> None:
        """Send the bound inputs to the FMU."""
        for block in self._inputs:
            if not block.direct:
                self.send_block(block)
            status = block.call()
            if status > 1:
                self._fail(block.name, status)

    def send_block(self, block: Block) -> None:
        """Memory -> the block's buffer. Raises: StepError if a variable cannot hold its value."""
        try:
            block.send()
        except Unfit as error:
            self._refuse(error)

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
            given = value.encode() if isinstance(value, str) else variable.as_referenced(value)
            try:
                check_fit(variable, ctype, given)
            except Unfit as error:
                self._refuse(error)
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
            else:
                value = variable.as_referenced(value)
            values[name] = bool(value) if variable.kind is Kind.BOOLEAN else value
        return values

    def _access(self, function: Any, variable: Variable, buffer: Any, ctype: Any) -> None:
        reference = (c_uint * 1)(variable.reference)
        extra = (len(buffer),) if self.description.fmi_version.startswith("3") else ()
        status = function(self._component, reference, 1, cast(buffer, POINTER(ctype)), *extra)
        if status > 1:
            self._fail(f"{function.__name__} of {variable.name}", status)

    def _moves_plainly(self) -> bool:
        """Whether every bound port is moved as it is: no aliases that negate, no parts of arrays."""
        return all(block.plain for block in (*self._inputs, *self._outputs))
