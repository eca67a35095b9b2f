"""A pure transport delay."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from .base import Array, Effect, Numbers, OfSignal, Pure

FEWEST = 16


def earlier(
    time: float,
    value: float,
    delay: float,
    largest_delay: float,
    has_before: bool,
    before: float,
    memory: Array,
    commit: bool,
) -> float:
    """The value of a signal `delay` seconds ago, interpolated linearly between two instants.

    Args:
        value: of the signal now. delay, largest_delay: the delay now, and the longest of any instant [s].
        has_before, before: whether the signal before the start is reported, and what it was.
        memory: a ring of instants. How many there are, place of the oldest, whether it is the start, then
            times [s], then values; an odd entry at the end is not of it.
        commit: see Effect.kernel.
    Returns: NaN where there is no room for the instant.
    """
    size = (len(memory) - 3) // 2
    count, oldest = int(memory[0]), int(memory[1])
    wanted = time - delay
    # The two instants around the wanted one; the newest is (time, x), which is not in the ring yet.
    right_time, right = time, value
    left_time, left = time, value
    older = count
    while older > 0 and left_time > wanted:
        older -= 1
        place = 3 + (oldest + older) % size
        right_time, right = left_time, left
        left_time, left = memory[place], memory[place + size]
    y = left
    if left_time <= wanted:
        if right_time > left_time:
            share = (wanted - left_time) / (right_time - left_time)
            # Times are rounded: a delay of whole steps is to meet the points.
            if share > 1.0 - 1e-9:
                y = right
            elif share > 1e-9:
                y = left + share * (right - left)
    elif has_before and (count == 0 or memory[2] != 0.0):
        y = before
        if count > 0 and left_time - wanted <= 1e-9 * (right_time - left_time):
            y = left
    if commit:
        if count == 0:
            memory[2] = 1.0
        while count > 1 and memory[3 + (oldest + 1) % size] <= time - largest_delay:
            oldest = (oldest + 1) % size
            count -= 1
            memory[2] = 0.0
        if count == size:
            return math.nan
        place = 3 + (oldest + count) % size
        memory[place] = time
        memory[place + size] = value
        memory[0] = count + 1
        memory[1] = oldest
    return y


def enlarged(memory: Array) -> Array:
    """The memory of `earlier` in room for twice as many instants."""
    size = (len(memory) - 3) // 2
    count, oldest = int(memory[0]), int(memory[1])
    longer = np.zeros(len(memory) + 2 * size)
    longer[0], longer[2] = count, memory[2]
    places = 3 + (oldest + np.arange(count)) % size
    longer[3 : 3 + count] = memory[places]
    longer[3 + 2 * size : 3 + 2 * size + count] = memory[places + size]
    longer[3 + 4 * size :] = memory[3 + 2 * size :]
    return longer


class Delay(Effect):
    """y(t) = x(t - time), on the straight line between two instants. Zero size: 0.

    Before the start x is its first value, or what `before` says. A delay of whole communication steps gives
    the values of the points before, to the bit.
    """

    main: ClassVar[str] = "time"
    jittable: ClassVar[bool] = True

    time: Annotated[float, Pure("s")] = Field(ge=0, description="The delay.", allow_inf_nan=False)
    before: Annotated[float | None, OfSignal()] = Field(
        None, description="The signal before the start; its first value if not given.", allow_inf_nan=False
    )

    def numbers(self) -> list[float]:
        """See Effect.numbers: the delay [s], whether there is a value before the start, and which."""
        return [self.time, float(self.before is not None), self.before or 0.0]

    @staticmethod
    def kernel(time: float, x: Numbers, options: Numbers, memory: Array, commit: bool) -> float:
        """See Effect.kernel. Memory: see `earlier`. Without room for the instant it gives NaN."""
        if options[0] == 0.0:
            return x[0]
        return earlier(time, x[0], options[0], options[0], options[1] != 0.0, options[2], memory, commit)

    def room(self, step_size: float | None) -> int:
        count = FEWEST if step_size is None else max(FEWEST, math.ceil(self.time / step_size) + 4)
        return 3 + 2 * count

    def grown(self, memory: Array) -> Array:
        """See Effect.grown: adaptive masters take as many instants as they like."""
        return memory if memory[0] < (len(memory) - 3) // 2 else self.enlarged(memory)

    def enlarged(self, memory: Array) -> Array:
        return enlarged(memory)

    def passes_at_once(self, step_size: float | None) -> bool:
        """See Effect.passes_at_once: a delay shorter than a step lies on the line to the newest value."""
        return step_size is None or self.time < step_size * (1.0 - 1e-9)
