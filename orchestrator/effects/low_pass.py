"""A first-order lag."""

from __future__ import annotations

import math
from typing import Annotated, Any, ClassVar

from pydantic import Field

from ..base.errors import Problem
from ..base.quantities import Measure
from .base import Array, Effect, Numbers, Pure


class LowPass(Effect):
    """T y' + y = x, beginning at rest: y = x at the start. Zero size: T = 0.

    Between two instants x is taken for a straight line, on which the solution is exact for any step. The
    corner frequency stands for T = 1/(2 pi cutoff).
    """

    main: ClassVar[str] = "cutoff"
    jittable: ClassVar[bool] = True

    cutoff: Annotated[float | None, Pure("Hz")] = Field(None, gt=0, description="Corner frequency.")
    time_constant: Annotated[float | None, Pure("s")] = Field(
        None, ge=0, description="T, in place of the cutoff.", allow_inf_nan=False
    )

    @classmethod
    def prepare(cls, options: dict[str, Any], measure: Measure, place: Any) -> list[Problem]:
        if (options.get("cutoff") is None) == (options.get("time_constant") is None):
            return [Problem(place(""), "low-pass takes either a cutoff or a time_constant")]
        return []

    def numbers(self) -> list[float]:
        """See Effect.numbers: T [s]."""
        if self.time_constant is not None:
            return [self.time_constant]
        assert self.cutoff is not None
        return [1.0 / (2.0 * math.pi * self.cutoff)]

    @staticmethod
    def kernel(time: float, x: Numbers, options: Numbers, memory: Array, commit: bool) -> float:
        """See Effect.kernel. Memory: whether there is an instant before, its time [s], x and y."""
        if options[0] == 0.0:
            return x[0]
        y = x[0]
        if memory[0] != 0.0:
            y = memory[3]
            if time > memory[1]:
                ratio = (time - memory[1]) / options[0]
                gone = -math.expm1(-ratio)
                y += gone * (memory[2] - y) + (1.0 - gone / ratio) * (x[0] - memory[2])
        if commit:
            memory[0] = 1.0
            memory[1] = time
            memory[2] = x[0]
            memory[3] = y
        return y

    def room(self, step_size: float | None) -> int:
        return 4
