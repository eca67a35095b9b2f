"""Who gave a number that is not finite: an FMU, or the effects on a connection."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NoReturn

import numpy as np

from ..base.errors import StepError
from ..fmi import Array, FmuInstance, Point
from ..system.connection import Port
from ..system.signal_vector import Layout, Wired
from ..system.system import System


class NonFiniteSources:
    """Names the source of numbers that are not finite."""

    def __init__(
        self,
        system: System,
        layout: Layout,
        running: Sequence[FmuInstance],
        values: Array,
        inputs: Sequence[Array],
    ) -> None:
        """
        Args:
            running: the instances; the list may still be filled.
            values: the signals as they stand, shape (layout.size,); inputs: of each instance. Both are looked
                at when something is to be reported.
        """
        self._system, self._layout, self._running = system, layout, running
        self._values, self._inputs = values, inputs

    def check_initial(self, port: Port, value: float) -> None:
        """Raises: StepError if the value that a port has before the first instant is not finite."""
        if not np.isfinite(value):
            self._raise_non_finite(port, value, None)

    def blame_inputs(self, index: int, point: Point, error: StepError) -> None:
        """Name the FMU that produced a NaN, not the one that fails on it.

        Raises: StepError in place of `error` if the instance's inputs are not finite.
        """
        if np.isfinite(self._inputs[index]).all():
            return
        position = int(np.flatnonzero(~np.isfinite(self._inputs[index]))[0])
        source = int(self._layout.inputs[index].source[position])
        if not np.isfinite(self._values[source]):
            time = point.time + point.step_size
            self.report_non_finite(time, source, error)

    def report_non_finite(
        self, time: float | None, place: int | None = None, cause: Exception | None = None
    ) -> None:
        """Name the first signal that is not finite, or the one at `place`; for what an effect made of such a
        signal, that one.

        Args:
            time: the instant that the signals belong to [s]; None before the first.
        Raises: StepError if one is not finite.
        """
        wanted = None if place is None else {place}
        for one in reversed(self._layout.wired):  # what a signal is made of stands before it
            if wanted is not None and one.place in wanted:
                wanted |= {*one.source.tolist(), *(n for _, reads in one.links for n in reads.tolist())}
        for index in self._system.order:
            span = self._layout.spans[index]
            for position in np.flatnonzero(~np.isfinite(self._values[span])):
                if wanted is None or span.start + position in wanted:
                    port = Port(self._system.instances[index].name, self._layout.outputs[index][position])
                    self._raise_non_finite(port, float(self._values[span][position]), time, cause)
        for one in self._layout.wired:
            if not np.isfinite(self._values[one.place]) and (wanted is None or one.place in wanted):
                self.raise_made(one, time, cause)

    def raise_made(self, one: Wired, time: float | None, cause: Exception | None = None) -> NoReturn:
        """Raises: StepError for what effects made."""
        raise StepError(
            f"{one.connection}: the effects give {float(self._values[one.place])!r}",
            instance=one.connection.source.instance,
            time=time,
            status="not finite",
            remedy="Check the effects' options.",
        ) from cause

    def _raise_non_finite(
        self, port: Port, value: float, time: float | None, cause: Exception | None = None
    ) -> NoReturn:
        one = self._running[self._system.position[port.instance]]
        text = str(self._system.variable(port)).removeprefix(port.variable)
        raise StepError(
            f"{port.variable}{text} is {value!r}",
            instance=port.instance,
            time=time,
            status="not finite",
            log=one.log_lines(),
            remedy="Check the values that it is given, or take a smaller step size.",
        ) from cause
