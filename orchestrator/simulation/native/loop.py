"""The communication loop in chunks of native steps, with Python between them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from time import perf_counter_ns
from typing import TYPE_CHECKING, NoReturn

import numpy as np
from numpy.typing import NDArray

from ...base.errors import StepError
from ...fmi import Array, Point, StepStatus
from ...fmi.binary_instance import CompiledInstance
from ...master import MasterAlgorithm
from ...master.base import failure
from ...master.running_instances import Instances
from . import kernel
from .choice import Schedule, kernel_of, schedule
from .table_columns import Outcome, Phase
from .tables import Tables

if TYPE_CHECKING:
    from ..grid import Grid

# Steps of a chunk. Python between two chunks takes some 50 us.
_FEWEST, _MOST = 16, 16384
# Numbers that a chunk may record. One block of memory serves all chunks: to touch memory for the first time
# costs more than the steps themselves, and what stays within a core's cache is fastest.
_NUMBERS = 1 << 16
# Columns that lie a power of two apart would share a few lines of the cache.
_APART = 8
# A chunk lasts about this long, so that interrupts, progress and files are not kept waiting [ns].
_LONGEST = 50_000_000
# Reading the clock costs as much as the step of a small FMU: where steps are short, one in so many is timed;
# where they last longer than this, each is [ns].
_TIMED_EVERY, _SHORT = 64, 2_000


def run_native(
    instances: Instances,
    master: MasterAlgorithm,
    grid: Grid,
    seen: Callable[[int, Array, Array], None] | None,
    check: Callable[[], bool],
    begun: Callable[[], None] | None = None,
    paced: Callable[[float], None] | None = None,
) -> int:
    """Take all steps of a grid; what happens, and what fails, is the same as with `master.step`.

    Args:
        instances: initialised; `choose_loop` has found them fit.
        seen: called after each chunk of steps, about the points at which they began: index of the first,
            times, shape (n,) [s], and signals, shape (n, layout.size). The next chunk reuses their memory.
            None: nobody looks.
        check: called before each chunk; whether to stop there.
        begun: called before the first, when the machine code is there.
        paced: called with the time of each point at which a step begins, before it does [s]; chunks are
            single steps then.
    Returns: the index of the point that was reached.
    Raises: StepError.
    """
    planned = schedule(instances, master)
    width = instances.layout.size
    largest = _largest(width, seen is not None, paced is not None)
    columns = np.empty((width, 0 if seen is None else largest + _APART))
    native = None if planned is None else _Native.of(instances, planned, float(grid.step_size), columns)
    if native is None:
        raise ValueError("these instances, or this master, cannot be run by the native loop")
    native.take(0, np.empty(0))  # brings the machine code from disk, or compiles it
    if begun is not None:
        begun()
    index, size = 0, min(_FEWEST, largest)
    while index < grid.steps and not check():
        times = grid.times(index, min(index + size, grid.steps))
        if paced is not None:
            paced(float(times[0]))
            if check():
                break
        begin = perf_counter_ns()
        done = native.take(index, times)
        took = perf_counter_ns() - begin
        native.share_elapsed(took)
        if seen is not None:
            count = done + native.failed
            seen(index, times[:count], columns[:, :count].T)
        index += done
        if done:
            for one, part in zip(native.running, instances.system.instances, strict=True):
                latest = _latest(part.ratio, grid, index)
                if latest is not None:
                    one.stand_at(latest)
        if native.failed:
            native.fail(Point(index, float(times[done]), float(grid.step_size)))
        if (ender := int(native.outcome[Outcome.ENDER])) >= 0:
            instances.ender = ender
            break
        native.timed_every = _TIMED_EVERY if took < done * len(native.running) * _SHORT else 1
        size = min(2 * size, largest) if took < _LONGEST else max(size // 2, 1)
    return index


def _largest(width: int, seen: bool, paced: bool) -> int:
    """How many steps a chunk has at most.

    Args:
        width: signals that each of them records, where they are seen.
    """
    largest = 1 if paced else _MOST
    while seen and largest > _FEWEST and largest * width > _NUMBERS:
        largest //= 2
    return largest


@dataclass
class _Native:
    """Instances in machine code, and what it says about the steps that it took.

    Attributes:
        running: the instances; planned: their order.
        columns: where signals are recorded, shape (layout.size, at least a chunk).
        run: the kernel; timed_every: one in so many steps is timed.
        elapsed: time that steps took, per instance [ns]; begun: when the last step of each began [s];
            outcome: by `Outcome`.
    """

    instances: Instances
    running: list[CompiledInstance]
    planned: Schedule
    tables: Tables
    step_size: float
    columns: Array
    run: Callable[..., int]
    elapsed: NDArray[np.int64]
    begun: Array
    outcome: NDArray[np.int64]
    timed_every: int = 1

    @staticmethod
    def of(instances: Instances, planned: Schedule, step_size: float, columns: Array) -> _Native | None:
        """None where some instance is not in machine code."""
        running = [one for one in instances.running if isinstance(one, CompiledInstance)]
        calls = [found for one in running if (found := one.native_calls()) is not None]
        if len(calls) != len(instances):
            return None
        tables = Tables.of(instances, calls, planned, step_size)
        run = getattr(kernel, kernel_of(bool(len(tables.wiring.paths)), tables.curves.order > 0))
        elapsed, outcome = np.zeros(len(running), np.int64), np.zeros(len(Outcome), np.int64)
        begun = np.zeros(len(running))
        return _Native(instances, running, planned, tables, step_size, columns, run, elapsed, begun, outcome)

    def take(self, first: int, times: Array) -> int:
        """Take the steps that begin at `times`, shape (n,) [s], the first at point `first`: how many."""
        tables, wiring = self.tables, self.tables.wiring
        return self.run(
            tables.order,
            tables.late,
            tables.steps,
            tables.calls,
            tables.plan,
            tables.places,
            tables.source,
            tables.gain,
            tables.offset,
            tables.values,
            tables.inputs,
            first,
            times,
            self.step_size,
            self.begun,
            self.columns,
            self.elapsed,
            self.timed_every,
            tables.timer,
            wiring.paths,
            wiring.links,
            wiring.legs,
            wiring.gains,
            wiring.offsets,
            wiring.reads,
            wiring.after,
            wiring.bounds,
            tables.curves.table,
            self.step_size**2,
            self.outcome,
        )

    @property
    def failed(self) -> bool:
        """Whether the steps taken last ended with one that failed."""
        return bool(self.outcome[Outcome.PHASE] != Phase.DONE)

    def share_elapsed(self, took: int) -> None:
        """Share out the duration of the instances' steps that were timed; all together `took` [ns]."""
        total = int(self.elapsed.sum())
        if total:
            # A step that was timed may by chance have been interrupted: they did not take longer than all.
            factor = min(float(self.timed_every), took / total)
            self.instances.add_elapsed([round(factor * part) for part in self.elapsed.tolist()])
            self.elapsed[:] = 0

    def fail(self, point: Point) -> NoReturn:
        """Raises: StepError or SimulationEnded, as the interpreter's loop does for such a step."""
        who = int(self.outcome[Outcome.WHO])
        status = _judged(self.instances, self.tables, self.outcome, point, self.begun)
        failure(self.instances, who, status).raise_on_failure(point)
        raise AssertionError("a step that did not fail ended the native loop")


def _latest(ratio: Fraction, grid: Grid, steps: int) -> float | None:
    """When the last step of an instance began, after so many communication steps [s]; None: it took none.

    Args:
        ratio: of its step and the communication step.
    """
    every, parts = ratio.numerator, ratio.denominator
    begin = steps // every * every - every
    if begin < 0:
        return None
    return float(grid.times(begin, begin + 1)[0]) + float(grid.step_size) * ((parts - 1) / parts)


def _own(ratio: Fraction, point: Point, begun: float, part: int) -> Point:
    """The step of an instance that ends with, or is a part of, that from a communication point."""
    every, parts = ratio.numerator, ratio.denominator
    if every > 1:
        return Point(point.index // every, begun, every * point.step_size)
    begin = point.time + point.step_size * (part / parts)
    return point if parts == 1 else Point(point.index * parts + part, begin, point.step_size / parts)


def _judged(
    instances: Instances, tables: Tables, outcome: NDArray[np.int64], point: Point, begun: Array
) -> StepStatus:
    """The status of a failed step. Raises: StepError, as the interpreter's loop does."""
    who, phase, row, status, part, _ = outcome.tolist()
    if phase == Phase.FINITE:
        instances.signals(point.time + point.step_size)
    one = instances.running[who]
    assert isinstance(one, CompiledInstance)
    try:
        ratio, begin = instances.system.instances[who].ratio, float(begun[who])
        if part and phase in (Phase.CONVERT, Phase.SET, Phase.BEND):
            one.stand_at(_own(ratio, point, begin, part - 1).time)
        if phase == Phase.CONVERT:
            one.send_block(tables.blocks[row])
        if phase == Phase.SET:
            one.fail_block(tables.blocks[row], status)
        if phase == Phase.BEND:
            one.fail_derivatives(status)
        own = _own(ratio, point, begin, part if phase == Phase.ADVANCE else ratio.denominator - 1)
        one.stand_at(own.time)
        if phase == Phase.GET:
            one.fail_block(tables.blocks[row], status)
        return one.step_status(status, own)
    except StepError as error:
        instances.nonfinite_sources.blame_inputs(who, point, error)
        raise
