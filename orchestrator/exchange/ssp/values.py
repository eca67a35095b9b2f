"""Values of parameters as a config has them, and what becomes of a value along a chain of connections."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction

from ...base.errors import Problem, listed, nearest
from ...base.quantities import Measure, quantity
from ...base.units import ONE, Quantity, Unit, UnitError, convert, known_unit
from ...config import Scalar
from ...fmi import Kind, Variable
from .model import Transformation
from .network import Assigned, Node

_TRUE, _FALSE = ("true", "1"), ("false", "0")


def number(text: str) -> int | float:
    """A number as it is written: whole ones without a point. Raises: ValueError."""
    try:
        return int(text)
    except ValueError:
        value = float(text)
        if not math.isfinite(value):
            raise ValueError(f"{text!r} is not finite") from None
        return value


def mapped(text: str, transformation: Transformation) -> str:
    """A value by a table of texts; what is not in it stays as it is."""
    entries = dict(transformation.entries)
    if transformation.kind == "boolean":
        entries = {_truth(source): target for source, target in entries.items()}
        text = _truth(text)
    return entries.get(text, text)


def _truth(text: str) -> str:
    return "true" if text in _TRUE else "false" if text in _FALSE else text


def scalars(given: Assigned, variables: list[Variable], label: str) -> dict[str, Scalar] | Problem:
    """Start values, by the names of a variable or of the elements of an array.

    Args:
        label: of the variable, for messages.
    """
    parameter = given.parameter
    texts = parameter.values
    if len(texts) != len(variables):
        what = f"{label} has {len(variables)} elements, the parameter {len(texts)}"
        return Problem(parameter.place, what, "one value for each is needed, row by row")
    found: dict[str, Scalar] = {}
    for variable, text in zip(variables, texts, strict=True):
        try:
            found[variable.name] = _scalar(given, variable, text)
        except (ValueError, OverflowError) as error:
            what = f"{label} cannot take {text!r} ({parameter.type}): {error}"
            return Problem(parameter.place, what, f"it is {variable} of type {variable.type}")
    return found


def _scalar(given: Assigned, variable: Variable, text: str) -> Scalar:
    """One value. Raises: ValueError with the reason."""
    change = given.transformation
    if change is not None and change.kind != "linear":
        text = mapped(text, change)
        change = None
    kind = variable.kind
    if kind is Kind.REAL:
        return _real(given, variable, text, change)
    if change is not None:
        raise ValueError("linear transformations are for real numbers")
    if kind is Kind.BOOLEAN:
        if _truth(text) not in ("true", "false"):
            raise ValueError("true or false is needed")
        return _truth(text) == "true"
    if kind is Kind.INTEGER:
        value = float(text)
        if value != int(value):
            raise ValueError("a whole number is needed")
        return int(text) if text.lstrip("+-").isdecimal() else int(value)
    if kind is Kind.ENUMERATION:
        if text in variable.items:
            return text
        if not text.lstrip("+-").isdecimal():
            raise ValueError(f"items: {listed(variable.items)}. {nearest(text, variable.items)}".rstrip(". "))
        return int(text)
    if kind is Kind.STRING:
        return text
    raise ValueError(f"values of type {variable.type} are not supported")


def _real(given: Assigned, variable: Variable, text: str, change: Transformation | None) -> Scalar:
    plain, unit, name = number(text), given.parameter.unit, given.parameter.unit_name
    own = variable.unit
    value = float(plain)
    if name and name != variable.unit_name and own is not None and not given.suppress:
        if unit is None:
            raise ValueError(f"unit {name!r} is not defined in the file")
        if not unit.same_dimension(own):
            raise ValueError(f"{name} [{unit.base()}] is no unit for it")
        if change is None and _means(name, unit, variable):
            return f"{text.strip()} {name}"
        if unit != own:
            value = Quantity(Fraction(str(plain)), unit).to(own)
    if change is not None:
        value = change.factor * value + change.offset
    if not math.isfinite(value):
        raise ValueError("it is not finite")
    return variable.written(float(value))


def _means(name: str, unit: Unit, variable: Variable) -> bool:
    """Whether a config reads a unit's name as what the file says it is."""
    return name not in variable.display_units and known_unit(name) == unit and unit != ONE


def same_start(variable: Variable, one: Scalar, other: Scalar) -> bool:
    """Whether two start values of a config are the same for the FMU."""
    if variable.kind is Kind.REAL:
        measure = Measure(variable.unit_name, variable.unit, variable.display_units)
        return quantity("", measure, one, "") == quantity("", measure, other, "")
    if variable.kind is Kind.ENUMERATION:
        return variable.items.get(str(one), one) == variable.items.get(str(other), other)
    return one == other


class SignalPathError(ValueError):
    """A transformation that cannot be had here; the message says why."""


@dataclass
class SignalPath:
    """What becomes of a value on its way: factor * value + offset, or tables in turn.

    Attributes:
        unit, unit_name: of the value where it is now; None: not known.
        items: of the enumeration that it is of.
    """

    unit: Unit | None
    unit_name: str
    items: Mapping[str, int]
    factor: float = 1.0
    offset: float = 0.0
    tables: tuple[tuple[str, ...], ...] = ()

    def through(self, node: Node, suppress: bool, change: Transformation | None) -> None:
        """Go on to the next connector. Raises: SignalPathError."""
        unit = self.unit
        if node.unit is not None or node.unit_name:
            if unit is not None and node.unit is not None and not suppress:
                if not unit.same_dimension(node.unit):
                    raise SignalPathError(
                        f"units differ, {self.unit_name} [{unit.base()}] and {node.unit_name} "
                        f"[{node.unit.base()}], and their conversion is not suppressed"
                    )
                try:
                    self._affine(*convert(unit, node.unit))
                except UnitError as error:
                    raise SignalPathError(str(error)) from None
            self.unit, self.unit_name = node.unit, node.unit_name
        elif suppress:
            self.unit, self.unit_name = None, ""
        if change is None:
            pass
        elif change.kind == "linear":
            self._affine(change.factor, change.offset)
        else:
            self._table(change, node.items)
        if node.items:
            self.items = node.items

    def _affine(self, factor: float, offset: float) -> None:
        if (factor, offset) == (1.0, 0.0):
            return
        if self.tables:
            raise SignalPathError("a table of whole numbers is followed by a linear transformation")
        self.factor, self.offset = factor * self.factor, factor * self.offset + offset

    def _table(self, change: Transformation, items: Mapping[str, int]) -> None:
        if (self.factor, self.offset) != (1.0, 0.0):
            raise SignalPathError("a linear transformation is followed by a table of whole numbers")
        entries = []
        for source, target in change.entries.items():
            if change.kind == "boolean":
                entries.append(f"{_bit(source)} -> {_bit(target)}")
            elif change.kind == "enumeration":
                before, after = self.items.get(source), (items or self.items).get(target)
                if before is None or after is None:
                    missing = source if before is None else target
                    raise SignalPathError(
                        f"no item {missing!r} in the enumeration; items: "
                        f"{listed(self.items if before is None else items or self.items)}"
                    )
                entries.append(f"{before} -> {after}")
            else:
                entries.append(f"{_whole(source)} -> {_whole(target)}")
        self.tables += (tuple(entries),)


def _bit(text: str) -> int:
    if _truth(text) not in ("true", "false"):
        raise SignalPathError(f"{text!r} in a boolean mapping; true or false is needed")
    return int(_truth(text) == "true")


def _whole(text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise SignalPathError(f"{text!r} in an integer mapping is no whole number") from None
