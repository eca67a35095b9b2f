"""Communication steps at the pace of the clock: when each begins, and how late it was."""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import perf_counter_ns, sleep
from typing import Any

from ..base.errors import OrchestratorError
from ..base.histogram import Histogram
from ..config import RealtimeModel
from ..config.base import exact_time

# No sleep is longer, so that an interrupt is noted soon [ns].
_LONGEST_SLEEP = 50_000_000


class Pace:
    """Paces one run: the step that begins at time t has its deadline (t - start) / speed after the first.

    A deadline is missed where the step before it is still under way. Deadlines stand on a grid of their own,
    so that nothing adds up; what `on_miss` says happens to them then.

    Args:
        model: how to pace.
        start: of the run [s].
    """

    def __init__(self, model: RealtimeModel, start: float) -> None:
        self._model, self._start = model, start
        self._spin = int(float(exact_time(model.spin)) * 1e9)
        self._origin: int | None = None
        self._begun = 0
        self._latency, self._busy = Histogram(), Histogram()
        self._steps = self._missed = self._row = self._longest_row = self._worst = self._shifted = 0
        self._scheduler = ""

    def wait(self, time: float, stopped: Callable[[], bool]) -> None:
        """Wait until the step that begins at a time may begin [s].

        Args:
            stopped: whether to wait no longer.
        Raises: OrchestratorError if deadlines are missed that must not be.
        """
        arrived = perf_counter_ns()
        if self._origin is None:
            self._origin = self._begun = arrived
            return
        due = self._origin + round((time - self._start) * 1e9 / self._model.speed)
        self._busy.add(arrived - self._begun)
        self._steps += 1
        late = arrived - due
        if late > 0:
            self._miss(time, late)
            if self._model.on_miss == "shift":
                self._origin += late
                self._shifted += late
        else:
            self._row = 0
            self._sleep(due, stopped)
        self._begun = perf_counter_ns()
        self._latency.add(self._begun - due)

    def _sleep(self, due: int, stopped: Callable[[], bool]) -> None:
        while (left := due - perf_counter_ns()) > self._spin and not stopped():
            sleep(min(left - self._spin, _LONGEST_SLEEP) * 1e-9)
        while perf_counter_ns() < due and not stopped():
            pass

    def _miss(self, time: float, late: int) -> None:
        self._missed += 1
        self._row += 1
        self._longest_row = max(self._longest_row, self._row)
        self._worst = max(self._worst, late)
        if self._model.on_miss == "stop" and self._row >= self._model.misses:
            raise OrchestratorError(
                f"run.realtime: at time {time:.12g} s {self._row} deadlines in a row were missed, the last "
                f"by {late * 1e-6:.3g} ms; on_miss: stop allows {self._model.misses - 1}\n"
                "  Take a larger step_size, compiled FMUs or a lower speed."
            )

    @contextmanager
    def quiet(self) -> Iterator[None]:
        """Keep the garbage collector, and other programs if `priority` is given, from the loop."""
        collects = gc.isenabled()
        gc.collect()
        gc.disable()
        try:
            with self._prioritised():
                yield
        finally:
            if collects:
                gc.enable()

    @contextmanager
    def _prioritised(self) -> Iterator[None]:
        wanted = self._model.priority
        self._scheduler = "as any other program"
        if wanted is None:
            yield
            return
        if not hasattr(os, "sched_setscheduler"):
            self._scheduler += f"; SCHED_FIFO {wanted} was asked for, {sys.platform} has none"
            yield
            return
        before = os.sched_getscheduler(0), os.sched_getparam(0)
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(wanted))
        except OSError as error:
            self._scheduler += f"; SCHED_FIFO {wanted} was refused ({error})"
            yield
            return
        self._scheduler = f"SCHED_FIFO {wanted}"
        try:
            yield
        finally:
            os.sched_setscheduler(0, *before)

    def summary(self) -> dict[str, Any]:
        """What came of it; times in s.

        `latency`: from a step's deadline to its beginning. `busy`: from its beginning to its end. Histograms
        hold ten classes per decade; quantiles are exact to 2.3 %.
        """
        return {
            "speed": self._model.speed,
            "on_miss": self._model.on_miss,
            "scheduler": self._scheduler,
            "steps": self._steps,
            "missed": self._missed,
            "longest_row_of_misses": self._longest_row,
            "worst_miss": self._worst * 1e-9,
            "shifted": self._shifted * 1e-9,
            "latency": self._latency.summary() | {"histogram": self._latency.classes()},
            "busy": self._busy.summary() | {"histogram": self._busy.classes()},
        }
