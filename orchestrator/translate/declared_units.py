"""Unit definitions of a model description: base units, display units, units of derivatives."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from dataclasses import dataclass, field

from orchestrator.base.errors import BuildError
from orchestrator.base.units import BASE_NAMES, Unit, UnitError, convert, known_unit, parse_unit


@dataclass
class _Declared:
    unit: Unit | None
    display: dict[str, tuple[float, float]] = field(default_factory=dict)


class UnitTable:
    """The units that variables use, each once.

    Attributes:
        unknown: names that were declared but cannot be read; they get no base unit.
    """

    def __init__(self) -> None:
        self._units: dict[str, _Declared] = {}
        self.unknown: list[str] = []

    def add(self, unit: str, display_unit: str, where: str) -> None:
        """Enter a variable's unit and display unit.

        Args:
            unit, display_unit: as declared, "" if not.
            where: the declaration, for the message of an error.
        Raises: BuildError if the display unit measures something else.
        """
        if not unit:
            if display_unit:
                raise BuildError(
                    f"{where}: displayUnit {display_unit!r} without a unit; declare the unit, too"
                )
            return
        declared = self._units.get(unit)
        if declared is None:
            declared = self._units[unit] = _Declared(self._parse(unit))
        if display_unit and display_unit != unit:
            declared.display[display_unit] = _conversion(declared.unit, unit, display_unit, where)

    def element(self) -> ET.Element | None:
        """Return the element UnitDefinitions, or None if there are no units."""
        if not self._units:
            return None
        root = ET.Element("UnitDefinitions")
        for name in sorted(self._units):
            declared = self._units[name]
            element = ET.SubElement(root, "Unit", name=name)
            if declared.unit is not None:
                attributes = {
                    base: str(power)
                    for base, power in zip(BASE_NAMES, declared.unit.exponents, strict=True)
                    if power
                }
                if declared.unit.factor != 1:
                    attributes["factor"] = repr(float(declared.unit.factor))
                if declared.unit.offset:
                    attributes["offset"] = repr(float(declared.unit.offset))
                ET.SubElement(element, "BaseUnit", attributes)
            for display in sorted(declared.display):
                factor, offset = declared.display[display]
                attributes = {"name": display, "factor": repr(factor)}
                if offset:
                    attributes["offset"] = repr(offset)
                ET.SubElement(element, "DisplayUnit", attributes)
        return root

    def _parse(self, name: str) -> Unit | None:
        try:
            return parse_unit(name)
        except UnitError:
            self.unknown.append(name)
            return None


def derivative_unit(unit: str) -> str:
    """Name of the unit of a derivative: "m" -> "m/s", "m/s" -> "m/s2", "N/m" -> "N/(m.s)", "degC" -> "K/s".

    "" where there is none, as for "" and "degF".
    """
    known = known_unit(unit)
    if known is not None and known.offset:
        # A rate of change has no origin.
        unit = "K" if known.factor == 1 else ""
    if not unit:
        return ""
    numerator, slash, denominator = unit.partition("/")
    if not slash:
        return f"{unit}/s"
    factors = denominator.removeprefix("(").removesuffix(")").split(".")
    if factors[-1] == "s":
        factors[-1] = "s2"
    else:
        factors.append("s")
    return f"{numerator}/{factors[0]}" if len(factors) == 1 else f"{numerator}/({'.'.join(factors)})"


def used_units(units: Iterable[tuple[str, str, str]]) -> UnitTable:
    """Return the table of the given units and display units, each with the place of its declaration."""
    table = UnitTable()
    for unit, display_unit, where in units:
        table.add(unit, display_unit, where)
    return table


def _conversion(unit: Unit | None, name: str, display_name: str, where: str) -> tuple[float, float]:
    """Factor and offset of value_in_display_unit = factor * value + offset."""
    try:
        display = parse_unit(display_name)
        if unit is None:
            raise UnitError(f"unknown unit {name!r}")
        turns = unit.exponents[-1] - display.exponents[-1]
        if unit.exponents[:-1] == display.exponents[:-1] and abs(turns) == 1:
            # A frequency in Hz counts turns of 2 pi rad.
            cycle = 2 * math.pi
            return float(unit.factor / display.factor) * (1 / cycle if turns > 0 else cycle), 0.0
        return convert(unit, display)
    except UnitError as error:
        raise BuildError(
            f"{where}: displayUnit {display_name!r} does not fit unit {name!r}: {error}"
        ) from error
