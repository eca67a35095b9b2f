"""The signal times a number, which may have a unit."""

from __future__ import annotations

from typing import Any, ClassVar

from pydantic import Field

from ..base.errors import Problem
from ..base.quantities import Measure
from ..base.units import ONE, UnitError, parse_quantity, parse_unit
from .base import Array, Effect, Numbers, times_unit


def split(value: Any) -> tuple[float, str]:
    """A number and the name of its unit, "1" if it has none. Raises: UnitError."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return parse_quantity(str(value)).to(ONE), ONE.name
    quantity = parse_quantity(str(value))
    return float(quantity.value), quantity.unit.name


class Gain(Effect):
    """y = factor * x; a factor of 2 N/m makes newtons of metres. Zero size: 1."""

    main: ClassVar[str] = "factor"
    jittable: ClassVar[bool] = True

    factor: float = Field(description="A number, with a unit or without: 0.5, 2 N/m.", allow_inf_nan=False)
    unit: str = Field("1", exclude=True, description="Of the factor, if not given with it.")

    @staticmethod
    def kernel(time: float, x: Numbers, options: Numbers, memory: Array, commit: bool) -> float:
        return x[0] * options[0]

    @classmethod
    def prepare(cls, options: dict[str, Any], measure: Measure, place: Any) -> list[Problem]:
        try:
            if "factor" in options and "unit" not in options:
                options["factor"], options["unit"] = split(options["factor"])
        except UnitError as error:
            return [Problem(place("factor"), f"factor: {error}", "a number, with a unit or without")]
        return []

    def numbers(self) -> list[float]:
        return [self.factor]

    def outgoing(self, measure: Measure) -> Measure | str:
        unit = parse_unit(self.unit)
        if unit == ONE:
            return measure
        if measure.unit is None:
            return (
                "the signal's unit is not known, so that a factor with a unit makes no known one. Give a "
                "bare number, the factor in the units of both ends: the unit is not checked then."
            )
        if unit.offset or measure.unit.offset:
            return "a unit with an offset cannot be multiplied"
        return times_unit(measure, unit)

    def nominal(self, nominal: float) -> float:
        return nominal * abs(self.factor) or nominal
