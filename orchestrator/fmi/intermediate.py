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
from .input_curves import InputCurves
from .instance import Array

if TYPE_CHECKING:
    from .binary_instance import CompiledInstance

Watcher = Callable[[float, Array], None]


class Intermediate(InputCurves):
    """Serves the intermediate updates of one instance.

    Attributes:
        watcher: called with each intermediate time [s] and the bound outputs there, shape (outputs,), NaN
            where the FMU does not declare that they can be got; None: outputs are left alone.
    """

    def __init__(self, instance: CompiledInstance) -> None:
        super().__init__(instance)
        self.watcher: Watcher | None = None
        self._got, self._seen = np.zeros(0), np.zeros(0)
        self._gotten: list[Block] = []
        self._shown: list[int] = []
        self._failure: BaseException | None = None

    def bind(
        self,
        inputs: Sequence[str],
        outputs: Sequence[str],
        blocks: Callable[[Sequence[str], Array, str], list[Block]],
    ) -> None:
        """Choose those of the bound ports that can be reached within a step; `blocks` makes their blocks."""
        self.bind_inputs(inputs, blocks)
        variables = self._instance.description.variables
        self._shown = [place for place, name in enumerate(outputs) if variables[name].intermediate]
        self._got, self._seen = np.zeros(len(self._shown)), np.full(len(outputs), np.nan)
        self._gotten = blocks([outputs[place] for place in self._shown], self._got, "Get")

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
                if set_requested:
                    self.set(time)
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
