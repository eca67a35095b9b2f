"""Intermediate update of FMI 3.0: an FMU's inputs and outputs at points within its step.

An FMU that declares `providesIntermediateUpdate` calls back at points that it chooses, such as the ends of
its integrator's steps. Inputs that it declares for that follow the master's curve there instead of one held
value; outputs can be watched. Without a curve and a watcher nothing is set and nothing is got.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .block import Block
from .instance import Array

if TYPE_CHECKING:
    from .fmi3 import Fmi3Instance

__all__ = ["Intermediate", "Watcher"]

Watcher = Callable[[float, Array], None]


class Intermediate:
    """Serves the intermediate updates of one instance.

    Attributes:
        watcher: called with each intermediate time [s] and the bound outputs there, shape (outputs,), NaN
            where the FMU does not declare that they can be got; None: outputs are left alone.
    """

    def __init__(self, instance: Fmi3Instance) -> None:
        self._instance = instance
        self.watcher: Watcher | None = None
        self._positions: list[int] = []
        self._values = np.zeros(0)
        self._blocks: list[Block] = []
        self._got, self._seen = np.zeros(0), np.zeros(0)
        self._gotten: list[Block] = []
        self._shown: list[int] = []
        self._begin = self._values
        self._slopes: list[Array] = []
        self._origin: float | None = None
        self._failure: BaseException | None = None

    def bind(
        self,
        inputs: Sequence[str],
        outputs: Sequence[str],
        blocks: Callable[[Sequence[str], Array, str], list[Block]],
    ) -> None:
        """Choose those of the bound ports that can be reached within a step; `blocks` makes their blocks."""
        followed, variables = self._instance.description.followed, self._instance.description.variables
        self._positions = [place for place, name in enumerate(inputs) if name in followed]
        self._values = np.zeros(len(self._positions))
        self._blocks = blocks([inputs[place] for place in self._positions], self._values, "Set")
        self._shown = [place for place, name in enumerate(outputs) if variables[name].intermediate]
        self._got, self._seen = np.zeros(len(self._shown)), np.full(len(outputs), np.nan)
        self._gotten = blocks([outputs[place] for place in self._shown], self._got, "Get")
        self.hold()

    @property
    def blocks(self) -> Sequence[Block]:
        """What is set within a step."""
        return self._blocks

    def hold(self) -> None:
        """Forget the curve: inputs keep the value that they have at the beginning of a step."""
        self._slopes, self._origin = [], None

    def follow(self, order: int, begin: Array, slopes: Array) -> None:
        """Take derivatives of an order, 1 or 2, of all bound inputs, and their values at the beginning."""
        self._begin = begin[self._positions]
        self._slopes = [*self._slopes[: order - 1], slopes[self._positions]]

    def begin(self, time: float) -> None:
        """A step begins; the first one after a curve was given is the one that the curve begins with."""
        if self._origin is None:
            self._origin = time

    def raise_failure(self) -> None:
        """Raise what went wrong in an update: an exception would not get through the FMU."""
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure

    def update(
        self,
        environment: Any,
        time: float,
        set_requested: bool,
        get_allowed: bool,
        step_finished: bool,
        can_return: bool,
        return_requested: Any,
        return_time: Any,
    ) -> None:
        """fmi3IntermediateUpdateCallback."""
        try:
            if self._failure is None:
                if set_requested and self._slopes:
                    self._set(time)
                if get_allowed and step_finished and self.watcher is not None:
                    self.watcher(time, self._get())
        except BaseException as error:
            self._failure = error
        if self._failure is not None and can_return:
            return_requested[0], return_time[0] = True, time

    def _get(self) -> Array:
        for block in self._gotten:
            status = block.call()
            if status > 1:
                self._instance.fail_block(block, status)
            if not block.direct:
                block.fetch()
        self._seen[self._shown] = self._got
        return self._seen.copy()

    def _set(self, time: float) -> None:
        passed = time - self._origin if self._origin is not None else 0.0
        # Taylor's series, as FMI 2 defines it for its input derivatives.
        self._values[:] = self._begin
        for order, slope in enumerate(self._slopes, 1):
            self._values += slope * (passed**order / order)
        for block in self._blocks:
            if not block.direct:
                self._instance.send_block(block)
            status = block.call()
            if status > 1:
                self._instance.fail_block(block, status)
