"""Blocks of ports that one FMI call moves between an FMU and memory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from ctypes import c_bool, c_double, c_float, c_uint, sizeof
from math import isfinite
from typing import Any

from .instance import Array
from .variable import Variable

_NOT_WHOLE = (c_bool, c_double, c_float)


class Unfit(ValueError):
    """A value that the type of a variable cannot hold; ctypes would take it modulo the type's size."""


def _whole_range(ctype: Any) -> tuple[int, int] | None:
    """The smallest and the largest number that a type of whole numbers holds; None of other types."""
    if ctype in _NOT_WHOLE or not isinstance(ctype(0).value, int):
        return None
    bits = 8 * sizeof(ctype)
    return (-(1 << bits - 1), (1 << bits - 1) - 1) if ctype(-1).value < 0 else (0, (1 << bits) - 1)


def check_fit(variable: Variable, ctype: Any, value: Any) -> None:
    """Raises: Unfit if a variable, whose values are of that ctype, cannot hold a value."""
    held = _whole_range(ctype)
    if held is None or not isinstance(value, int | float) or held[0] <= value <= held[1]:
        return
    what = f"{variable.name} ({variable.type}) cannot hold {value!r}"
    raise Unfit(f"{what}; it holds whole numbers from {held[0]} to {held[1]}")


class Block:
    """Ports of one FMI type: one call moves all of them between the FMU and memory.

    An array is moved whole, whichever of its elements are ports; aliases of one variable are moved once.

    Attributes:
        name: of the FMI function that gets or sets them.
        address: of that function; 0 until it is known.
        ctype: of a value.
        call: that function with its arguments; gives the FMI status.
        refill: gets what the FMU has into `values`; only where inputs are elements of a larger array.
        references: value references, one of each variable.
        values: their values, arrays flattened in row-major order.
        direct: whether `values` is the caller's memory, so that nothing is copied.
        partial: whether `values` holds elements that are no ports, which must keep what the FMU has.
    """

    def __init__(
        self,
        fmi_type: str,
        ctype: Any,
        name: str,
        ports: Sequence[tuple[int, Variable]],
        memory: Array,
    ) -> None:
        """
        Args:
            ports: positions in `memory` and the variables that stand there, all of one FMI type.
        """
        offsets: dict[int, int] = {}
        count = 0
        for _, variable in ports:
            if variable.reference not in offsets:
                offsets[variable.reference] = count
                count += variable.elements
        self.name = name
        self.address = 0
        self.ctype = ctype
        self._variables = [variable for _, variable in ports]
        self._range = _whole_range(ctype)
        self.references = (c_uint * len(offsets))(*offsets)
        self.memory = memory
        self.positions = [position for position, _ in ports]
        self.slots = [offsets[variable.reference] + variable.element for _, variable in ports]
        self._plain = self.slots == list(range(count)) and not any(one.negated for one in self._variables)
        self.partial = len(set(self.slots)) < count
        first = self.positions[0]
        # Doubles that lie side by side are moved where they are; anything else goes by way of a buffer.
        self.direct = (
            ctype is c_double and self._plain and self.positions == list(range(first, first + count))
        )
        run = memory[first : first + count]
        self.values = (ctype * count).from_buffer(run) if self.direct else (ctype * count)()
        self.real = fmi_type in ("Real", "Float64", "Float32")
        self.call: Callable[[], int] = lambda: 0
        self.refill: Callable[[], int] | None = None

    @property
    def plain(self) -> bool:
        """Whether `values` holds the ports in order and nothing else."""
        return self._plain

    def fetch(self) -> None:
        """Buffer -> memory."""
        if self._plain:
            self.memory[self.positions] = self.values[:]
            return
        for position, slot, variable in zip(self.positions, self.slots, self._variables, strict=True):
            self.memory[position] = variable.as_referenced(self.values[slot])

    def send(self) -> None:
        """Memory -> buffer. Raises: Unfit."""
        values = self.memory[self.positions].tolist()
        if not self._plain:
            pairs = zip(self._variables, values, strict=True)
            values = [variable.as_referenced(value) for variable, value in pairs]
        if not self.real:
            values = self._whole(values)
        if self._plain:
            self.values[:] = values
            return
        for slot, value in zip(self.slots, values, strict=True):
            self.values[slot] = value

    def _whole(self, values: list[float]) -> list[int]:
        """Values as the FMU's whole numbers, checked."""
        try:
            whole = [round(value) for value in values]
        except (OverflowError, ValueError):
            position = next(place for place, value in enumerate(values) if not isfinite(value))
            label = f"{self._variables[position].name} ({self._variables[position].type})"
            raise Unfit(f"{label} cannot hold {values[position]!r}: it is no whole number") from None
        if self._range is not None and not self._range[0] <= min(whole) <= max(whole) <= self._range[1]:
            # Signals are doubles: of 64 bits, that next to the largest number is one beyond it.
            whole = [self._range[1] if float(one) == float(self._range[1]) else one for one in whole]
            for variable, value in zip(self._variables, whole, strict=True):
                check_fit(variable, self.ctype, value)
        return whole
