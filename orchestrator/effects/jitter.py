"""A delay that is another one every period."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar

from pydantic import Field

from .base import Array, Numbers, Pure
from .delay import FEWEST, earlier, enlarged
from .draws import Seeded, uniform


class Jitter(Seeded):
    """y(t) = x(t - U), with U drawn again every period, between 0 and the jitter. Zero size: 0.

    Of a signal that changes once per period a change arrives so much later, as packets do. Draws are like
    those of `noise`: functions of seed and number alone.
    """

    main: ClassVar[str] = "jitter"
    jittable: ClassVar[bool] = True

    jitter: Annotated[float, Pure("s")] = Field(ge=0, description="The longest delay.", allow_inf_nan=False)
    period: Annotated[float, Pure("s")] = Field(
        gt=0, description="How long a draw is held.", allow_inf_nan=False
    )
    phase: Annotated[float, Pure("s")] = Field(
        0.0, ge=0, description="Time after the start at which periods begin.", allow_inf_nan=False
    )

    def numbers(self) -> list[float]:
        return [self.jitter, self.period, self.phase, *self.key()]

    @staticmethod
    def kernel(time: float, x: Numbers, options: Numbers, memory: Array, commit: bool) -> float:
        """See Effect.kernel. Memory: that of `earlier`, then the first instant [s]."""
        if options[0] == 0.0:
            return x[0]
        last = len(memory) - 1
        start = time
        if memory[0] != 0.0:
            start = memory[last]
        number = max(math.floor((time - start - options[2]) / options[1] + 1e-6), 0)
        back = options[0] * uniform(options[3], options[4], options[5], number)
        y = earlier(time, x[0], back, options[0], False, 0.0, memory, commit)
        if commit:
            memory[last] = start
        return y

    def room(self, step_size: float | None) -> int:
        count = FEWEST if step_size is None else max(FEWEST, math.ceil(self.jitter / step_size) + 4)
        return 4 + 2 * count

    def grown(self, memory: Array) -> Array:
        return memory if memory[0] < (len(memory) - 3) // 2 else self.enlarged(memory)

    def enlarged(self, memory: Array) -> Array:
        return enlarged(memory)

    def smooth(self) -> bool:
        return self.jitter == 0.0
