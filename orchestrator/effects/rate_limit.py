"""A limit of how fast a signal may change."""

from __future__ import annotations

from typing import Annotated, ClassVar

from pydantic import Field

from .base import Array, Effect, Numbers, OfSignal


class RateLimit(Effect):
    """y follows x, beginning at its first value, as fast as the rate allows. Zero size: an infinite rate."""

    main: ClassVar[str] = "rate"
    jittable: ClassVar[bool] = True

    rate: Annotated[float, OfSignal("s")] = Field(gt=0, description="Largest change per time; inf for none.")

    @staticmethod
    def kernel(time: float, x: Numbers, options: Numbers, memory: Array, commit: bool) -> float:
        """See Effect.kernel. Memory: whether there is an instant before, its time [s] and value."""
        y = x[0]
        if memory[0] != 0.0 and time > memory[1]:
            most = options[0] * (time - memory[1])
            if y > memory[2] + most:
                y = memory[2] + most
            elif y < memory[2] - most:
                y = memory[2] - most
        if commit:
            memory[0] = 1.0
            memory[1] = time
            memory[2] = y
        return y

    def room(self, step_size: float | None) -> int:
        return 3
