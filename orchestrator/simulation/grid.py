"""The communication points of a run."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from ..base.errors import ConfigError, Problem
from ..config import RunModel
from ..config.base import exact_time
from ..fmi import Array, Point


def time_problems(
    run: RunModel, place: str = "run", knows: Callable[[str], bool] = lambda key: True
) -> list[Problem]:
    """What is wrong with the times of a config, as far as those are known; `knows`: whether a key is."""
    problems = []
    if knows("step_size") and exact_time(run.step_size) <= 0:
        problems.append(Problem(place, f"step_size {run.step_size} is not positive"))
    if knows("start_time") and knows("stop_time") and exact_time(run.stop_time) <= exact_time(run.start_time):
        what = f"stop_time {run.stop_time} is not after start_time {run.start_time}"
        problems.append(Problem(place, what))
    return problems


MOST_STEPS = 10**12


@dataclass(frozen=True)
class Grid:
    """Equidistant communication points: time = start + index * step size, each rounded once.

    Attributes:
        start, step_size: exact [s].
        steps: number of steps; there is one point more.
    """

    start: Fraction
    step_size: Fraction
    steps: int

    @staticmethod
    def of(run: RunModel, place: str = "run") -> Grid:
        """The grid of a config.

        Raises: ConfigError if the step size is not positive, or the run is not a whole number of steps:
            a shorter last step would act as another delay than the others.
        """
        if problems := time_problems(run, place):
            raise ConfigError(problems)
        start, stop, step = run.times()
        count = (stop - start) / step
        if count > MOST_STEPS:
            what = f"step_size {run.step_size} makes more than {MOST_STEPS:.0e} steps"
            raise ConfigError([Problem(place, what, remedy="Take a larger step or an earlier stop_time.")])
        if math.ulp(max(abs(float(start)), abs(float(stop)))) > step:
            what = (
                f"step_size {run.step_size} is below the resolution of times near stop_time {run.stop_time}"
            )
            raise ConfigError([Problem(place, what, remedy="Take a larger step, or begin at 0 s.")])
        if count.denominator != 1:
            below = count.numerator // count.denominator
            near = [f"{float(start + n * step)!r} s" for n in (below, below + 1) if n > 0]
            raise ConfigError(
                [
                    Problem(
                        place,
                        f"stop_time {run.stop_time} is {float(count):.6g} steps of {run.step_size} away",
                        "a whole number of steps after start_time is needed",
                        f"Nearest stop times: {', '.join(near)}.",
                    )
                ]
            )
        return Grid(start, step, int(count))

    def halved(self) -> Grid:
        """The same stretch of time with half the step size."""
        return Grid(self.start, self.step_size / 2, self.steps * 2)

    @property
    def stop(self) -> Fraction:
        """The last instant [s]."""
        return self.start + self.steps * self.step_size

    @property
    def latest(self) -> float:
        """The last instant as FMUs add it up: the last step's begin plus its size, if beyond `stop` [s].

        It may be so by a rounding, and FMUs are met that refuse to go beyond the stop time they are reported.
        """
        begin = float(self.start + (self.steps - 1) * self.step_size)
        return max(float(self.stop), begin + float(self.step_size))

    def __len__(self) -> int:
        return self.steps + 1

    def _fractions(self) -> tuple[int, int, int]:
        """begin, stride and denominator of time = (begin + index * stride) / denominator.

        Quotients of whole numbers are rounded once: no sum of steps runs away, and instants that two grids
        share are equal to the bit.
        """
        denominator = self.start.denominator * self.step_size.denominator
        begin = self.start.numerator * self.step_size.denominator
        return begin, self.step_size.numerator * self.start.denominator, denominator

    def times(self, first: int, end: int) -> Array:
        """Times of the points first <= index < end, shape (end - first,) [s]."""
        begin, stride, denominator = self._fractions()
        largest = max(abs(begin + first * stride), abs(begin + end * stride), denominator)
        if largest < 2**53:  # then floats hold them exactly, and their quotient is rounded once, too
            times = np.arange(first, end, dtype=np.float64)
            times *= stride
            times += begin
            times /= denominator
            return times
        return np.array([(begin + index * stride) / denominator for index in range(first, end)])

    def __iter__(self) -> Iterator[Point]:
        begin, stride, denominator = self._fractions()
        step = float(self.step_size)
        for index in range(self.steps):
            yield Point(index, (begin + index * stride) / denominator, step)
        yield Point(self.steps, (begin + self.steps * stride) / denominator, step, True)
