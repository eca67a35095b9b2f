"""The communication grid and the one loop."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

from .config import RunModel
from .errors import ConfigError, Problem
from .fmi import Point
from .instances import instantiate
from .master import MasterAlgorithm
from .signals import Layout, Signals
from .system import System

__all__ = ["Grid", "Observer", "Report", "simulate"]

Observer = Callable[[Point, Signals], None]


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
        start, stop, step = run.times()
        if step <= 0:
            raise ConfigError([Problem(place, f"step_size {run.step_size} is not positive")])
        if stop <= start:
            raise ConfigError(
                [Problem(place, f"stop_time {run.stop_time} is not after start_time {run.start_time}")]
            )
        count = (stop - start) / step
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

    def __len__(self) -> int:
        return self.steps + 1

    def __iter__(self) -> Iterator[Point]:
        # Quotients of whole numbers are rounded once: no sum of steps runs away, and instants that two grids
        # share are equal to the bit.
        denominator = self.start.denominator * self.step_size.denominator
        begin = self.start.numerator * self.step_size.denominator
        stride = self.step_size.numerator * self.start.denominator
        step = float(self.step_size)
        for index in range(self.steps):
            yield Point(index, (begin + index * stride) / denominator, step)
        yield Point(self.steps, (begin + self.steps * stride) / denominator, step, True)


@dataclass
class Report:
    """What is told of a run besides its signals.

    Attributes:
        instance_time: wall time spent in each instance's steps [s].
        log: the latest warnings and errors that each instance logged.
    """

    instance_time: dict[str, float] = field(default_factory=dict)
    log: dict[str, list[str]] = field(default_factory=dict)


class _Stop:
    """Whether the user asked for an end."""

    requested = False

    def __call__(self, number: int, frame: Any) -> None:
        if self.requested:
            raise KeyboardInterrupt  # asked twice: an FMU may hang
        self.requested = True


@contextmanager
def _held_interrupts() -> Iterator[_Stop]:
    """Interrupts are noted, for the loop to act on between steps.

    Raised within a step they would surface in a Python FMU, which makes an error of its own of them.
    """
    stop = _Stop()
    own = threading.current_thread() is threading.main_thread()
    if not own or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield stop
        return
    signal.signal(signal.SIGINT, stop)
    try:
        yield stop
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def simulate(
    system: System,
    master: MasterAlgorithm,
    grid: Grid,
    observers: Iterable[Observer] = (),
    report: Report | None = None,
) -> None:
    """Run a system.

    Observers see every communication point, before the step that begins there: values belong to that instant.

    Args:
        observers: called with the point and the signals; signals are new at every point and may be kept.
        report: filled also when the run fails.
    Raises: ConfigError if the master cannot run the system; StepError if an FMU fails or an iteration does
        not converge; FmuError if an FMU cannot be loaded; KeyboardInterrupt, between two steps, if the user
        asks for it.
    """
    observers = tuple(observers)
    problems = master.check(system)
    if problems:
        raise ConfigError(problems)
    with _held_interrupts() as stop, instantiate(system, Layout.of(system)) as instances:
        try:
            signals = instances.initialise(float(grid.start), float(grid.stop))
            for point in grid:
                for observe in observers:
                    observe(point, signals)
                if stop.requested:
                    raise KeyboardInterrupt
                if not point.last:
                    signals, info = master.step(system, instances, point, signals)
                    info.raise_on_failure(point)
        finally:
            if report is not None:
                report.instance_time, report.log = instances.elapsed(), instances.warnings()
