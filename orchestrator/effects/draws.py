"""Numbers that look random and are the same in every run: functions of seed and count alone."""

from __future__ import annotations

import math
from typing import Self

from pydantic import Field

from .base import Effect

# Plain functions of numbers: the native loop compiles them together with the kernels that call them.


def _mixed(state: int) -> int:
    """A hash of 32 bits, its constants found by Wellons ("lowbias32")."""
    state ^= state >> 16
    state = (state * 0x7FEB352D) & 0xFFFFFFFF
    state ^= state >> 15
    state = (state * 0x846CA68B) & 0xFFFFFFFF
    return state ^ (state >> 16)


def _seeded(low: float, high: float, element: float, number: int) -> int:
    """The hash of a seed in two parts of 24 bits, an array's element, and the number of the draw."""
    state = _mixed(0x9E3779B9 ^ int(low))
    state = _mixed(state ^ int(high))
    state = _mixed(state ^ int(element))
    state = _mixed(state ^ (number & 0xFFFFFFFF))
    return _mixed(state ^ (number >> 32))


def uniform(low: float, high: float, element: float, number: int) -> float:
    """A number from 0 to 1, neither included."""
    return (_seeded(low, high, element, number) + 0.5) / 4294967296.0


def normal(low: float, high: float, element: float, number: int) -> float:
    """A normally distributed number, by Box and Muller's transform of two uniform ones."""
    first = _seeded(low, high, element, number)
    second = _mixed((first + 0x9E3779B9) & 0xFFFFFFFF)
    one = (first + 0.5) / 4294967296.0
    other = (second + 0.5) / 4294967296.0
    return math.sqrt(-2.0 * math.log(one)) * math.cos(2.0 * math.pi * other)


class Seeded(Effect):
    """Base of the effects that draw."""

    seed: int = Field(ge=0, lt=2**48, strict=True, description="Of the draws; there is no default.")
    element: int = Field(0, ge=0, exclude=True, description="Set for the elements of arrays.")

    def key(self) -> list[float]:
        """What `uniform` and `normal` take: the seed in two parts of at most 24 bits, and the element."""
        return [float(self.seed % 2**24), float(self.seed // 2**24), float(self.element)]

    def for_element(self, element: int) -> Self:
        """See Effect.for_element: elements draw independently."""
        return self.model_copy(update={"element": element})
