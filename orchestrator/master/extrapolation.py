"""How signals are supposed to run over a step that is yet to be taken."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from math import prod
from typing import Literal

import numpy as np
from pydantic import Field

from ..base.errors import Problem
from ..config import Places
from ..fmi import Array, Point
from ..system.system import System
from .base import Master
from .rates import slow_with_extrapolation
from .running_instances import Curve, Instances


class Extrapolating(Master):
    """Base of the masters that step every instance once, and may extrapolate what feeds it."""

    extrapolation: Literal[0, 1, 2] = Field(
        0, description="Order of the polynomial through the latest points that inputs follow; 0 holds them."
    )

    @property
    def order(self) -> int:
        """See MasterAlgorithm.order; FMUs that hold their inputs are of second order at best."""
        return min(self.extrapolation + 1, 2)

    def check(self, system: System, places: Places | None = None) -> list[Problem]:
        """See MasterAlgorithm.check."""
        return super().check(system, places) + slow_with_extrapolation(system, self.extrapolation, places)


@lru_cache(maxsize=256)
def weights(at: float, nodes: tuple[float, ...]) -> tuple[float, ...]:
    """Lagrange's weights of the values at `nodes` in the polynomial's value at `at`."""
    return tuple(prod((at - other) / (one - other) for other in nodes if other != one) for one in nodes)


def _mixed(factors: Sequence[float], points: Sequence[Array]) -> Array:
    """A weighted sum; a product of matrices would take several times as long on few numbers."""
    total = factors[0] * points[0]
    for weight, one in zip(factors[1:], points[1:], strict=False):
        total += weight * one
    return total


def predicted(instances: Instances) -> Array | None:
    """What the latest step took the signals at its end for, shape (layout.size,); None: it held them."""
    return instances.memory.get("predicted")


class Extrapolation:
    """The curve of all signals over a step, from the points before and, as instances step, from the end.

    The first step knows one point only, and holds it; the second is linear at most. Steps may differ in size,
    and be taken again from an earlier point.
    """

    def __init__(self, instances: Instances, point: Point, values: Array, order: int) -> None:
        self._instances = instances
        memory = instances.memory
        if "points" not in memory:
            memory["points"] = []
            memory["all smooth"] = bool(instances.layout.smooth.all())
        kept = memory["points"]
        self._smooth = None if memory["all smooth"] else instances.layout.smooth
        while kept and kept[-1][0] >= point.time:
            kept.pop()
        # A step that does not begin where the one before it ended starts a new history.
        if kept and abs(kept[-1][0] + kept[-1][1] - point.time) > 1e-6 * kept[-1][1]:
            kept.clear()
        kept.append((point.time, point.step_size, values))
        del kept[: -order - 1]
        self._order = min(order, len(kept) - 1)
        self._end = point.time + point.step_size
        self._points = [one for _, _, one in reversed(kept)]
        self.curve: Curve | None = None
        memory["predicted"] = None
        if not self._order:
            return
        # Where the points stand before the step, newest first, in units of its size: sums of steps, since
        # differences of times would lose digits.
        nodes = [0.0]
        for _, size, _ in reversed(kept[:-1]):
            nodes.append(nodes[-1] - size / point.step_size)
        self._within = weights(0.5, (1.0, *nodes[: self._order]))
        middle, end = (_mixed(weights(at, tuple(nodes)), self._points) for at in (0.5, 1.0))
        if self._smooth is not None:
            middle, end = (np.where(self._smooth, one, values) for one in (middle, end))
        self.curve = Curve(values, middle, end, self._order, point.step_size)
        memory["predicted"] = end.copy()

    def stepped(self, index: int) -> None:
        """An instance has stepped: its signals at the end are known.

        What a connection makes of them and of others that are yet to come is made of these as they are
        supposed to be.
        """
        if self.curve is None:
            return
        layout = self._instances.layout
        span = layout.spans[index]
        self._settle(span, self._instances.values[span])
        if self._instances.connections is not None:
            for one in layout.wired_after[index]:
                self._instances.connections.evaluate_on_trial([one], self._end, self.curve.end)
                place = slice(one.place, one.place + 1)
                self._settle(place, self.curve.end[place].copy())

    def _settle(self, span: slice, known: Array) -> None:
        assert self.curve is not None
        within = _mixed(self._within, [known, *(one[span] for one in self._points)])
        self.curve.end[span] = known
        if self._smooth is not None:
            within = np.where(self._smooth[span], within, known)
        self.curve.middle[span] = within
