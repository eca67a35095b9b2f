"""The loop over communication points: in Python here, or handed to the native loop (`native/loop.py`)."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any, Protocol, runtime_checkable

from ..base.errors import ConfigError, Problem, SimulationEnded
from ..fmi import Array, Point
from ..master import MasterAlgorithm
from ..master.base import ended
from ..master.energy import Ledger, Step
from ..master.running_instances import Instances, instantiate
from ..system.instance_pool import InstancePool
from ..system.signal_vector import Layout, Signals
from ..system.system import System
from .grid import Grid
from .native import choose_loop, schedule
from .pacing import Pace
from .whole_numbers import WholeNumbers

Observer = Callable[[Point, Signals], None]


@runtime_checkable
class BlockObserver(Protocol):
    """An observer that can take many points at once, which is what the native loop gives."""

    def __call__(self, point: Point, signals: Signals) -> None:
        """See one point."""

    def observe_block(self, first: int, times: Array, values: Array) -> None:
        """See consecutive points.

        Args:
            first: index of the first one.
            times: shape (n,) [s].
            values: numeric signals, shape (n, layout.size), column by column in memory; the next call reuses
                it, so that what is to be kept must be copied.
        """


@dataclass
class Report:
    """What is reported about a run besides its signals.

    Attributes:
        instance_time: wall time spent in each instance's steps [s].
        log: the latest warnings and errors that each instance logged.
        loop: which one ran, "python" or "native".
        stepping_time: wall time of the loop itself, without loading and initialising [s].
        external: what links to external programs counted, by instance.
        ended: the end that an FMU asked for before the last communication point; None where none did.
    """

    instance_time: dict[str, float] = field(default_factory=dict)
    log: dict[str, list[str]] = field(default_factory=dict)
    loop: str = ""
    stepping_time: float = 0.0
    external: dict[str, Any] = field(default_factory=dict)
    ended: SimulationEnded | None = None
    _begun: float | None = field(default=None, repr=False)

    def stepping_begins(self) -> None:
        """The loop is ready for its first step."""
        self._begun = perf_counter()

    def stepping_ends(self) -> None:
        """The loop took its last step, or failed at it; perhaps it never began."""
        if self._begun is not None:
            self.stepping_time = perf_counter() - self._begun


class _Stop:
    """Whether the user asked for an end."""

    requested = False

    def is_requested(self) -> bool:
        """Whether the user asked for an end."""
        return self.requested

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
    *,
    loop: str = "auto",
    ledger: Ledger | None = None,
    pace: Pace | None = None,
    layout: Layout | None = None,
    pool: InstancePool | None = None,
) -> None:
    """Run a system.

    A run ends before its last communication point where an FMU asks for it. The last point is then the one at
    which it asks, or the one before if it asks within a step.

    Observers see every communication point, before the step that begins there: values belong to that instant.
    The native loop shows them up to 16384 points at once, after the steps that begin there.

    Args:
        observers: called with the point and the signals; signals are new at every point and may be kept.
        report: filled also when the run fails.
        loop: "python", "native" (machine code; the same results to the bit) or "auto": native where that is
            possible and faster; "prefer native": where that is possible.
        ledger: of the coupling; filled also when the run fails. One without bonds costs nothing.
        pace: by which steps begin; as soon as they can without.
        layout: of the signals, where it holds more than those of the system; see `Layout.of`.
        pool: of instances, where many runs follow each other.
    Raises: ConfigError if the master, or the native loop that is asked for, cannot run the system; StepError
        if an FMU fails or an iteration does not converge; FmuError if an FMU cannot be loaded;
        KeyboardInterrupt, between two steps, if the user asks for it.
    """
    observers = tuple(observers)
    report = report or Report()
    problems = master.check(system)
    if system.longest_step is not None and float(grid.step_size) > system.longest_step * (1.0 + 1e-9):
        what = f"step size {float(grid.step_size)!r} s is longer than {system.longest_step!r} s"
        problems.append(Problem("run.step_size", what, "the system's delays were checked by that one"))
    if problems:
        raise ConfigError(problems)
    with (
        _held_interrupts() as stop,
        instantiate(system, layout or Layout.of(system), pool) as instances,
    ):
        whole_numbers = WholeNumbers(instances)
        if len(whole_numbers.places):
            observers = (*observers, whole_numbers)
        try:
            report.loop = choose_loop(loop, instances, master, grid.steps, bool(ledger))
            signals = instances.initialise(float(grid.start), grid.latest)
            try:
                with nullcontext() if pace is None else pace.quiet():
                    if report.loop == "native":
                        _loop_natively(instances, master, grid, observers, stop, ledger or None, report, pace)
                    else:
                        report.stepping_begins()
                        _loop(instances, master, grid, observers, stop, signals, ledger or None, pace)
            except SimulationEnded as end:
                report.ended = end
            finally:
                report.stepping_ends()
            instances.terminate()
        finally:
            report.instance_time, report.log = instances.elapsed(), instances.warnings()
            report.external = instances.link_statistics()
    if stop.requested:  # after the last step: of several runs the next is not to begin
        raise KeyboardInterrupt


def _loop(
    instances: Instances,
    master: MasterAlgorithm,
    grid: Grid,
    observers: tuple[Observer, ...],
    stop: _Stop,
    signals: Signals,
    ledger: Ledger | None,
    pace: Pace | None,
) -> None:
    parts: tuple[Step, ...] = ()
    if ledger is not None:
        instances.noted_inputs = ledger.books.inputs
    for point in grid:
        if ledger is not None:
            if parts:
                ledger.stepped(point, parts)
            else:
                ledger.begin(point.time, signals.values)
        for observe in observers:
            observe(point, signals)
        if pace is not None:
            pace.wait(point.time, stop.is_requested)
        if stop.requested:
            raise KeyboardInterrupt
        if not point.last:
            _end_if_asked(instances, point)
            signals, info = master.step(instances.system, instances, point, signals)
            info.raise_on_failure(point)
            if ledger is not None:
                given = instances.inputs_over_step(ledger.books.inputs)
                parts = info.parts or (Step(point.step_size, signals.values, given),)


def _end_if_asked(instances: Instances, point: Point) -> None:
    """Raises: SimulationEnded if an instance asked for it at the end of its latest step."""
    if instances.ender is not None:
        raise ended(instances.running[instances.ender].name, point, point.time)


def _loop_natively(
    instances: Instances,
    master: MasterAlgorithm,
    grid: Grid,
    observers: tuple[Observer, ...],
    stop: _Stop,
    ledger: Ledger | None,
    report: Report,
    pace: Pace | None,
) -> None:
    # numba takes longer to import than a short run takes.
    from .native.loop import run_native

    step_size = float(grid.step_size)
    planned = schedule(instances, master)
    if ledger is not None and planned is not None:
        ledger.schedule(instances, planned.order, planned.late, step_size)
        observers = (*observers, ledger)
    blockwise = [one for one in observers if isinstance(one, BlockObserver)]

    def observe_blocks(first: int, times: Array, values: Array) -> None:
        for one in blockwise:
            one.observe_block(first, times, values)

    def observe_points(first: int, times: Array, values: Array) -> None:
        # All take turns at every point, so that where one raises the others have seen what they would have.
        for index, (time, row) in enumerate(zip(times.tolist(), values, strict=True), start=first):
            signals = Signals(row.copy())
            for observe in observers:
                observe(Point(index, time, step_size), signals)

    seen = observe_blocks if len(blockwise) == len(observers) else observe_points
    shown = seen if observers else None
    paced = None if pace is None else lambda time: pace.wait(time, stop.is_requested)
    reached = run_native(instances, master, grid, shown, stop.is_requested, report.stepping_begins, paced)
    time = float(grid.times(reached, reached + 1)[0])
    point = Point(reached, time, step_size, reached == grid.steps)
    signals = instances.signals(time)
    for observe in observers:
        observe(point, signals)
    if paced is not None and point.last:
        paced(time)
    if stop.requested:
        raise KeyboardInterrupt
    if not point.last:
        _end_if_asked(instances, point)
