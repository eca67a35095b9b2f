"""Samples that are lost now and then."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar

from pydantic import Field

from .base import Array, Numbers, Pure
from .draws import Seeded, uniform


class Dropout(Seeded):
    """y = x at the latest of the instants start + phase + n period that was not lost. Zero size: 0.

    Each but the first is lost with the given probability, independently. Draws are like those of `noise`:
    functions of seed and number alone. The instants are to be communication points: of one that lies between
    two, x is that of the second.
    """

    main: ClassVar[str] = "probability"
    jittable: ClassVar[bool] = True

    probability: Annotated[float, Pure("1")] = Field(ge=0, le=1, description="Of a sample to be lost.")
    period: Annotated[float, Pure("s")] = Field(
        gt=0, description="Time between two samples.", allow_inf_nan=False
    )
    phase: Annotated[float, Pure("s")] = Field(
        0.0, ge=0, description="Time of the first one after the start.", allow_inf_nan=False
    )

    def numbers(self) -> list[float]:
        return [self.probability, self.period, self.phase, *self.key()]

    @staticmethod
    def kernel(time: float, x: Numbers, options: Numbers, memory: Array, commit: bool) -> float:
        """See Effect.kernel.

        Memory: whether there is an instant before, the first one [s], number of the latest sample, lost or
        not, and the value that holds.
        """
        if options[0] == 0.0:
            return x[0]
        start = time
        if memory[0] != 0.0:
            start = memory[1]
        number = math.floor((time - start - options[2]) / options[1] + 1e-6)
        y = x[0]
        if memory[0] != 0.0:
            y = memory[3]
            if number > memory[2]:
                if uniform(options[3], options[4], options[5], number) >= options[0]:
                    y = x[0]
        if commit:
            memory[0] = 1.0
            memory[1] = start
            memory[2] = number
            memory[3] = y
        return y

    def room(self, step_size: float | None) -> int:
        return 4

    def smooth(self) -> bool:
        return self.probability == 0.0
