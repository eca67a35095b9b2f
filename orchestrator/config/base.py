"""What all parts of a config share: strict models, and times with their units."""

from __future__ import annotations

from fractions import Fraction
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from ..base.units import ONE, UnitError, parse_quantity, parse_unit
from ..effects.base import Pure

_SECOND = parse_unit("s")

Time = Annotated[str, Pure("s"), Field(description="A time with its unit.", examples=["0.1 ms", "4 s"])]


class Model(BaseModel):
    """A part of a config: unknown keys are problems, and nothing changes once it is read."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def exact_time(text: str) -> Fraction:
    """A time with its unit [s], exact as written."""
    return parse_quantity(text).exactly(_SECOND)


def checked_time(value: Any) -> str:
    """A time as text. Raises: ValueError if it is none, or lacks its unit."""
    try:
        quantity = parse_quantity(str(value))
        if quantity.unit == ONE:
            raise UnitError(f"{value!r} has no unit; write it as in '{value} s' or '{value} ms'")
        quantity.to(_SECOND)
    except UnitError as error:
        raise ValueError(str(error)) from None
    return str(value)


def seconds(value: str | float) -> float:
    """A time from Python code [s]: a number, or a text with its unit. Raises: ValueError if it is none."""
    return float(exact_time(checked_time(value)) if isinstance(value, str) else value)
