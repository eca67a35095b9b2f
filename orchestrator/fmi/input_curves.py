"""The course of inputs over a step, where they follow the master's curve instead of one held value."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from .block import Block
from .instance import Array

if TYPE_CHECKING:
    from .binary_instance import CompiledInstance


class InputCurves:
    """Sets those inputs of one instance that follow a curve, at points within its step."""

    def __init__(self, instance: CompiledInstance) -> None:
        self._instance = instance
        self._positions: list[int] = []
        self._values = np.zeros(0)
        self._blocks: list[Block] = []
        self._begin = self._values
        self._slopes: list[Array] = []
        self._origin: float | None = None

    def bind_inputs(
        self, inputs: Sequence[str], blocks: Callable[[Sequence[str], Array, str], list[Block]]
    ) -> None:
        """Choose those of the bound inputs that can follow a curve; `blocks` makes what sets them."""
        followed = self._instance.description.followed
        self._positions = [place for place, name in enumerate(inputs) if name in followed]
        self._values = np.zeros(len(self._positions))
        self._blocks = blocks([inputs[place] for place in self._positions], self._values, "Set")
        self.hold()

    @property
    def blocks(self) -> Sequence[Block]:
        """What is set within a step."""
        return self._blocks

    @property
    def has_curve(self) -> bool:
        """Whether there is a curve to follow."""
        return bool(self._slopes)

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

    def set(self, time: float) -> None:
        """Give the inputs the values of an instant [s]; without a curve nothing is set."""
        if not self._slopes:
            return
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
