"""Numbers with units as configs give them, read in the unit of what takes them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from .errors import Problem, listed
from .units import ONE, Unit, UnitError, parse_unit, quantity_in


class Measure(NamedTuple):
    """What a number is measured in.

    Attributes:
        name: of the unit, as declared; empty if none is.
        unit: None where none is declared, or one that is not known here.
        display_units: further units that are taken for it, by name.
    """

    name: str = ""
    unit: Unit | None = None
    display_units: Mapping[str, Unit] = {}


def quantity(
    label: str, measure: Measure, value: object, place: str, difference: bool = False
) -> float | Problem:
    """A number in the unit of `measure`, or what is wrong with it.

    Args:
        label: what takes it, for the message; empty if the place is enough.
        value: a number, or text with number and unit.
        place: where it was written.
        difference: see `units.Quantity.exactly`.
    """
    before, named = (f"{label}: ", f"{label} ") if label else ("", "")
    if isinstance(value, bool):
        return Problem(place, f"{named}must be a number, got {str(value).lower()}")
    if isinstance(value, int | float):
        if not measure.name or measure.unit == ONE:
            try:
                return float(value)
            except OverflowError:  # of a whole number
                return Problem(
                    place, f"{before}about 1e{math.log10(abs(value)):.0f} is beyond double precision"
                )
        allowed = f"a unit must be given, for zero too; its unit is {measure.name}"
        return Problem(place, f"{before}{value!r} has no unit", allowed, f"Write {value!r} {measure.name}.")
    if not isinstance(value, str):
        return Problem(place, f"{named}must be a number, got {value!r}")
    if measure.unit is None:
        return _unknown_unit(before, measure, value, place)
    try:
        # The unit's own name, too, is the FMU's to define: "dimensionless", "radian".
        own = {measure.name: measure.unit} if measure.name else {}
        return quantity_in(value, measure.unit, {**own, **measure.display_units}, difference)
    except UnitError as error:
        allowed = f"its unit is {measure.name}"
        if measure.display_units:
            allowed += f", it also takes {listed(measure.display_units)}"
        return Problem(place, f"{before}cannot take {value!r}, {error}", allowed)


def infinite_quantity(value: object, measure: Measure) -> float | None:
    """An infinite number, "inf N" or "-inf N" (the unit may be left out); None if it is no such."""
    if not isinstance(value, str):
        return None
    number, _, name = value.strip().partition(" ")
    if number not in ("inf", "+inf", "-inf"):
        return None
    name = name.strip()
    if name and name != measure.name:
        try:
            if measure.unit is None or not parse_unit(name).same_dimension(measure.unit):
                return None
        except UnitError:
            return None
    return -math.inf if number == "-inf" else math.inf


def _unknown_unit(before: str, measure: Measure, text: str, place: str) -> float | Problem:
    """A quantity for what has no unit declared, or one unknown here: only the same word will do."""
    number, _, unit = text.strip().partition(" ")
    try:
        if measure.name and unit.strip() == measure.name:
            return float(number)
    except ValueError:
        pass
    if measure.name:
        allowed = f"its unit, {measure.name}, is not known here: give the number in that unit"
        return Problem(
            place, f"{before}cannot take {text!r}", allowed, f"Write it as <number> {measure.name}."
        )
    return Problem(
        place, f"{before}cannot take {text!r}", "the FMU declares no unit for it", "Give a bare number."
    )
