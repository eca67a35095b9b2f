"""Whole numbers by a table."""

from __future__ import annotations

from typing import Any, ClassVar

from pydantic import Field

from ..base.errors import Problem
from ..base.quantities import Measure
from .base import Array, Effect, Numbers


class Map(Effect):
    """y = the table's entry for x, or x where it has none; for integers, booleans and enumerations.

    Zero size: a table that is empty. It stands on a connection alone or with others of its kind.
    """

    main: ClassVar[str] = "table"
    jittable: ClassVar[bool] = True

    table: tuple[str, ...] = Field(description="Entries such as 1 -> 3; false -> true is written 0 -> 1.")

    @classmethod
    def prepare(cls, options: dict[str, Any], measure: Measure, place: Any) -> list[Problem]:
        table = options.get("table")
        seen = set()
        for entry in table if isinstance(table, list) else ():
            try:
                source, _ = _pair(entry)
            except (ValueError, AttributeError):
                return [Problem(place("table"), f"cannot read the entry {entry!r}", "written as 1 -> 3")]
            if source in seen:
                return [Problem(place("table"), f"two entries for {source:g}", "each value stands once")]
            seen.add(source)
        return []

    def pairs(self) -> list[tuple[float, float]]:
        """What becomes of what."""
        return [_pair(entry) for entry in self.table]

    def numbers(self) -> list[float]:
        return [number for pair in self.pairs() for number in pair]

    def smooth(self) -> bool:
        return not self.table

    @staticmethod
    def kernel(time: float, x: Numbers, options: Numbers, memory: Array, commit: bool) -> float:
        for place in range(0, len(options), 2):
            if x[0] == options[place]:
                return options[place + 1]
        return x[0]


def _pair(entry: str) -> tuple[float, float]:
    source, _, target = entry.partition("->")
    return float(int(source)), float(int(target))
