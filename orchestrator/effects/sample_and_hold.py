"""A signal that is sampled at instants of its own."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar

from pydantic import Field

from .base import Array, Effect, Numbers, Pure


class SampleAndHold(Effect):
    """y = x at the latest of the instants start + phase + n period, held until the next. Zero size: 0.

    Where such an instant lies between two communication points, x there is taken from the straight line
    between them. Before the first one y is the first value of x.
    """

    main: ClassVar[str] = "period"
    jittable: ClassVar[bool] = True

    period: Annotated[float, Pure("s")] = Field(
        ge=0, description="Time between two samples.", allow_inf_nan=False
    )
    phase: Annotated[float, Pure("s")] = Field(
        0.0, ge=0, description="Time of the first one after the start.", allow_inf_nan=False
    )

    @staticmethod
    def kernel(time: float, x: Numbers, options: Numbers, memory: Array, commit: bool) -> float:
        """See Effect.kernel.

        Memory: whether there is an instant before, the first one [s], number of the latest sample, its value,
        and time [s] and value of the instant before.
        """
        if options[0] == 0.0:
            return x[0]
        start = time
        if memory[0] != 0.0:
            start = memory[1]
        # Grids meet sampling instants up to rounding: a millionth of a period early counts.
        number = float(math.floor((time - start - options[1]) / options[0] + 1e-6))
        y = x[0]
        if memory[0] != 0.0:
            y = memory[3]
            if number > memory[2]:
                y = x[0]
                behind = time - (start + options[1] + number * options[0])
                step = time - memory[4]
                if behind > 1e-6 * step and step > 0.0:
                    share = min(behind / step, 1.0)
                    y = x[0] + share * (memory[5] - x[0])
        if commit:
            memory[0] = 1.0
            memory[1] = start
            memory[2] = number
            memory[3] = y
            memory[4] = time
            memory[5] = x[0]
        return y

    def room(self, step_size: float | None) -> int:
        return 6

    def smooth(self) -> bool:
        return self.period == 0.0
