"""Play: what follows is carried along only where the play is used up."""

from __future__ import annotations

from typing import Annotated, ClassVar

from pydantic import Field

from .base import Array, Effect, Numbers, OfSignal


class Backlash(Effect):
    """y stays where it was unless x is more than half the width away, and then follows. Zero size: 0.

    It begins at the first value of x, in the middle of the play. The path of x counts, not its speed.
    """

    main: ClassVar[str] = "width"
    jittable: ClassVar[bool] = True

    width: Annotated[float, OfSignal(difference=True)] = Field(
        ge=0, description="The total play.", allow_inf_nan=False
    )

    @staticmethod
    def kernel(time: float, x: Numbers, options: Numbers, memory: Array, commit: bool) -> float:
        """See Effect.kernel. Memory: whether there is a value before, and which."""
        if options[0] == 0.0:
            return x[0]
        y = x[0]
        if memory[0] != 0.0:
            half = 0.5 * options[0]
            y = memory[1]
            if x[0] - half > y:
                y = x[0] - half
            elif x[0] + half < y:
                y = x[0] + half
        if commit:
            memory[0] = 1.0
            memory[1] = y
        return y

    def room(self, step_size: float | None) -> int:
        return 2
