"""Noise that is the same in every run."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar

from pydantic import Field

from .base import Array, Numbers, OfSignal, Pure
from .draws import Seeded, normal


class Noise(Seeded):
    """y = x + deviation * n, with n normally distributed, drawn again every period from the start.

    With a correlation time T a draw keeps exp(-period/T) of the one before; the deviation stays the same.

    The n-th draw is a function of seed and n alone (and of the element, for arrays): it does not depend on
    master, step size, loop or machine. Zero size: deviation 0.
    """

    main: ClassVar[str] = "deviation"
    jittable: ClassVar[bool] = True

    deviation: Annotated[float, OfSignal(difference=True)] = Field(
        ge=0, description="Standard deviation.", allow_inf_nan=False
    )
    period: Annotated[float, Pure("s")] = Field(
        gt=0, description="How long a draw is held.", allow_inf_nan=False
    )
    correlation: Annotated[float, Pure("s")] = Field(
        0.0, ge=0, description="Time in which draws forget those before; 0: at once.", allow_inf_nan=False
    )

    def numbers(self) -> list[float]:
        return [self.deviation, self.period, *self.key(), self.correlation]

    @staticmethod
    def kernel(time: float, x: Numbers, options: Numbers, memory: Array, commit: bool) -> float:
        """See Effect.kernel.

        Memory: whether there is an instant before, the first one [s], number and value of the latest draw.
        """
        if options[0] == 0.0:
            return x[0]
        start = time
        if memory[0] != 0.0:
            start = memory[1]
        number = math.floor((time - start) / options[1] + 1e-6)
        if options[5] == 0.0 or memory[0] == 0.0:
            value = normal(options[2], options[3], options[4], number)
        else:
            value = memory[3]
            keep = math.exp(-options[1] / options[5])
            for each in range(int(memory[2]) + 1, number + 1):
                value = keep * value + math.sqrt(1.0 - keep * keep) * normal(
                    options[2], options[3], options[4], each
                )
        if commit:
            memory[0] = 1.0
            memory[1] = start
            memory[2] = number
            memory[3] = value
        return x[0] + options[0] * value

    def room(self, step_size: float | None) -> int:
        return 4

    def smooth(self) -> bool:
        return self.deviation == 0.0
