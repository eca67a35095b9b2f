"""An error that grows with time."""

from __future__ import annotations

from typing import Annotated, ClassVar

from pydantic import Field

from .base import Array, Effect, Numbers, OfSignal


class Drift(Effect):
    """y = x + rate (t - start). Zero size: 0."""

    main: ClassVar[str] = "rate"
    jittable: ClassVar[bool] = True

    rate: Annotated[float, OfSignal("s")] = Field(description="Growth per time.", allow_inf_nan=False)

    @staticmethod
    def kernel(time: float, x: Numbers, options: Numbers, memory: Array, commit: bool) -> float:
        """See Effect.kernel. Memory: whether there is an instant before, and the first one [s]."""
        if options[0] == 0.0:
            return x[0]
        start = time
        if memory[0] != 0.0:
            start = memory[1]
        if commit:
            memory[0] = 1.0
            memory[1] = start
        return x[0] + options[0] * (time - start)

    def room(self, step_size: float | None) -> int:
        return 2
