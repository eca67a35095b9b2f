"""A switch: full output in one sense or the other."""

from __future__ import annotations

from typing import Annotated, ClassVar

from pydantic import Field

from .base import Array, Effect, Numbers, OfSignal


class Relay(Effect):
    """y = level where x is above half the width, -level where it is below minus that, else as before.

    Zero size: a level of 0. Where no value came before, the sign of x counts.
    """

    main: ClassVar[str] = "level"
    jittable: ClassVar[bool] = True

    level: Annotated[float, OfSignal(difference=True)] = Field(
        ge=0, description="What comes out, with either sign.", allow_inf_nan=False
    )
    width: Annotated[float, OfSignal(difference=True)] = Field(
        0.0, ge=0, description="Distance between switching up and switching down.", allow_inf_nan=False
    )

    @staticmethod
    def kernel(time: float, x: Numbers, options: Numbers, memory: Array, commit: bool) -> float:
        """See Effect.kernel. Memory: the sign of the last value; 0 before the first."""
        if options[0] == 0.0:
            return x[0]
        sign = memory[0]
        if sign == 0.0:
            sign = 1.0 if x[0] >= 0.0 else -1.0
        if x[0] > 0.5 * options[1]:
            sign = 1.0
        elif x[0] < -0.5 * options[1]:
            sign = -1.0
        if commit:
            memory[0] = sign
        return sign * options[0]

    def room(self, step_size: float | None) -> int:
        return 1

    def smooth(self) -> bool:
        return self.level == 0.0
