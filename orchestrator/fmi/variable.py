"""Variables of an FMU: what the model description says of each, in enums and numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from ..base.units import ONE, Unit

Value = float | int | bool | str | bytes

# As it is commonly written: rounded to single precision it is the largest number there.
_LARGEST_SINGLE = 3.4028235e38


class Causality(StrEnum):
    """FMI causality of a variable."""

    PARAMETER = "parameter"
    CALCULATED_PARAMETER = "calculatedParameter"
    STRUCTURAL_PARAMETER = "structuralParameter"
    INPUT = "input"
    OUTPUT = "output"
    LOCAL = "local"
    INDEPENDENT = "independent"


class Variability(StrEnum):
    """FMI variability of a variable."""

    CONSTANT = "constant"
    FIXED = "fixed"
    TUNABLE = "tunable"
    DISCRETE = "discrete"
    CONTINUOUS = "continuous"


class Initial(StrEnum):
    """How a variable gets its value at initialisation."""

    EXACT = "exact"
    APPROX = "approx"
    CALCULATED = "calculated"


class Kind(StrEnum):
    """What values a variable takes, whatever their width: only like kinds are connected."""

    REAL = "Real"
    INTEGER = "Integer"
    BOOLEAN = "Boolean"
    ENUMERATION = "Enumeration"
    STRING = "String"
    BINARY = "Binary"
    CLOCK = "Clock"

    @property
    def numeric(self) -> bool:
        """Whether values are kept as float64 signals."""
        return self in (Kind.REAL, Kind.INTEGER, Kind.BOOLEAN, Kind.ENUMERATION)


@dataclass(frozen=True, slots=True)
class Variable:
    """A variable of an FMU: a scalar, or one element of an array.

    Attributes:
        name, description: as in the model description.
        reference: the value reference.
        type: the FMI type, for example "Real", "Float64", "UInt8", "Enumeration".
        kind: the family of that type.
        causality, variability, initial: FMI attributes, defaults filled in.
        unit: None where the FMU declares none or one that cannot be read.
        unit_name: the unit's name as declared, empty if none.
        display_units: units that the FMU offers for display, by name, scaled to base units.
        start, minimum, maximum: None where not declared.
        nominal: magnitude that is usual for it, in its unit; FMI's default is 1.
        items: names of an enumeration and their values.
        shape: dimensions of an array that is kept whole, () for a scalar and for an element of an array.
        element: place of an element in its array, row by row from 0; elements: length of that array.
        negated: whether the value is the negative, of a Boolean the opposite, of what the reference stands
            for (FMI 1.0's negatedAlias).
        intermediate: whether it may be set or got within a step (FMI 3.0's intermediateUpdate).
        clocks: names of the clocks of which one has to tick before it may be set (FMI 3.0).
    """

    name: str
    reference: int
    type: str
    kind: Kind
    causality: Causality
    variability: Variability
    initial: Initial | None = None
    unit: Unit | None = None
    unit_name: str = ""
    display_units: Mapping[str, Unit] = field(default_factory=dict)
    start: Value | None = None
    nominal: float = 1.0
    minimum: float | None = None
    maximum: float | None = None
    items: Mapping[str, int] = field(default_factory=dict)
    shape: tuple[int, ...] = ()
    description: str = ""
    element: int = 0
    elements: int = 1
    negated: bool = False
    intermediate: bool = False
    clocks: tuple[str, ...] = ()

    @property
    def carried(self) -> bool:
        """Whether connections carry its values as they are, beside the numbers: text and binary values."""
        return self.kind in (Kind.STRING, Kind.BINARY)

    @property
    def unrecorded(self) -> str:
        """Why results cannot hold its values; empty if they can. They hold numbers, as 64-bit floats."""
        if self.causality is Causality.INPUT:
            return "an input: record its source"
        if self.shape:
            return f"an array of shape {self.shape}, which is not taken apart"
        if not self.kind.numeric:
            return f"of type {self.kind}: results hold numbers, Booleans and items of enumerations only"
        return ""

    def rounded(self, value: Any) -> str:
        """Of a whole number that a signal, a 64-bit float, does not hold: what it holds instead; else empty.

        The largest number of a type is held, though the float next to it is one more.
        """
        if not isinstance(value, int) or self.kind not in (Kind.INTEGER, Kind.ENUMERATION):
            return ""
        whole = int(float(value))
        held = self.held_range or (-(1 << 63), (1 << 63) - 1)
        return "" if value in (whole, held[1]) else str(whole)

    def as_referenced(self, value: Any) -> Any:
        """What stands for a value under the reference, and the other way round."""
        if not self.negated:
            return value
        return not value if self.kind is Kind.BOOLEAN else -value

    def written(self, value: Value) -> Value:
        """A value as a config gives it: a real number with its unit, if it has one, an item by its name."""
        if self.kind is Kind.ENUMERATION:
            return next((name for name, item in self.items.items() if item == value), value)
        if self.kind is not Kind.REAL or not isinstance(value, float):
            return value
        # Of the negative zero no whole number is left.
        whole = (
            value.is_integer() and abs(value) < 2**53 and (value != 0.0 or math.copysign(1.0, value) > 0.0)
        )
        plain = int(value) if whole else value
        return plain if not self.unit_name or self.unit == ONE else f"{plain!r} {self.unit_name}"

    @property
    def held_range(self) -> tuple[float, float] | None:
        """The smallest and the largest number that its type holds: of integers, or Float32; else None."""
        if self.type == "Float32":
            return -_LARGEST_SINGLE, _LARGEST_SINGLE
        if self.kind is not Kind.INTEGER:
            return None
        signed, digits = not self.type.startswith("U"), self.type[self.type.index("Int") + 3 :]
        bits = int(digits) if digits.isdecimal() else 32  # "Integer"
        return (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)

    @property
    def settable(self) -> bool:
        """Whether a value may be given before initialisation (FMI 2.0.4, 4.2.4; FMI 3.0, 2.3.2)."""
        if self.variability is Variability.CONSTANT or self.kind is Kind.CLOCK:
            return False
        if self.causality in (Causality.INPUT, Causality.PARAMETER):
            return True
        if self.causality in (Causality.INDEPENDENT, Causality.STRUCTURAL_PARAMETER):
            return False
        return self.initial in (Initial.EXACT, Initial.APPROX)

    def __str__(self) -> str:
        """Name and unit, or kind where it is no real number: "force [N]"."""
        if self.kind is not Kind.REAL:
            return f"{self.name} ({self.kind})"
        return f"{self.name} [{self.unit_name}]" if self.unit_name else f"{self.name} (no unit)"
