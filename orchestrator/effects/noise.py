"""Noise that is the same in every run."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar, Self

from pydantic import Field

from .base import Array, Effect, Numbers, OfSignal, Pure

__all__ = ["Noise"]


class Noise(Effect):
    """y = x + deviation * n, with n normally distributed, drawn anew every period from the start on.

    The n-th draw is a function of seed and n alone (and of the element, for arrays): it does not depend on
    master, step size, loop or machine. Zero size: deviation 0.
    """

    main: ClassVar[str] = "deviation"
    jittable: ClassVar[bool] = True

    deviation: Annotated[float, OfSignal()] = Field(
        ge=0, description="Standard deviation.", allow_inf_nan=False
    )
    period: Annotated[float, Pure("s")] = Field(
        gt=0, description="How long a draw is held.", allow_inf_nan=False
    )
    seed: int = Field(ge=0, lt=2**48, strict=True, description="Of the draws; there is no default.")
    element: int = Field(0, ge=0, exclude=True, description="Set for the elements of arrays.")

    def numbers(self) -> list[float]:
        """See Effect.numbers: seed and element are cut into parts of at most 24 bits."""
        return [self.deviation, self.period, self.seed % 2**24, self.seed // 2**24, self.element]

    @staticmethod
    def kernel(time: float, x: Numbers, options: Numbers, memory: Array, commit: bool) -> float:
        """See Effect.kernel. Memory: whether there is an instant before, and the first one [s].

        A hash of 32 bits, its constants found by Wellons ("lowbias32"), makes two uniform numbers of it, of
        which Box and Muller's transform makes a normal one.
        """
        if options[0] == 0.0:
            return x[0]
        start = time
        if memory[0] != 0.0:
            start = memory[1]
        number = math.floor((time - start) / options[1] + 1e-6)
        state = 0x9E3779B9
        high, low = 0, 0
        for part in range(7):
            if part == 0:
                state ^= int(options[2])
            elif part == 1:
                state ^= int(options[3])
            elif part == 2:
                state ^= int(options[4])
            elif part == 3:
                state ^= number & 0xFFFFFFFF
            elif part == 4:
                state ^= number >> 32
            elif part == 5:
                high = state
                state = (state + 0x9E3779B9) & 0xFFFFFFFF
            else:
                low = state
            state ^= state >> 16
            state = (state * 0x7FEB352D) & 0xFFFFFFFF
            state ^= state >> 15
            state = (state * 0x846CA68B) & 0xFFFFFFFF
            state ^= state >> 16
        one = (high + 0.5) / 4294967296.0
        other = (low + 0.5) / 4294967296.0
        normal = math.sqrt(-2.0 * math.log(one)) * math.cos(2.0 * math.pi * other)
        if commit:
            memory[0] = 1.0
            memory[1] = start
        return x[0] + options[0] * normal

    def room(self, step_size: float | None) -> int:
        """See Effect.room."""
        return 2

    def smooth(self) -> bool:
        """See Effect.smooth."""
        return self.deviation == 0.0

    def for_element(self, element: int) -> Self:
        """See Effect.for_element: elements draw independently."""
        return self.model_copy(update={"element": element})
