"""How signals are supposed to run over a step that is yet to be taken."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..fmi import Array, Kind, Point
from ..instances import Curve, Instances

__all__ = ["Extrapolation", "smooth_signals"]

# Weights of the latest points, newest first, of the polynomial through them at the middle and at the end of
# the step that follows: Lagrange's for equidistant points.
_AHEAD = {
    1: ((1.5, -0.5), (2.0, -1.0)),
    2: ((1.875, -1.25, 0.375), (3.0, -3.0, 1.0)),
}
# The same at the middle of a step whose end is known, newest (the end) first.
_WITHIN = {1: (0.5, 0.5), 2: (0.375, 0.75, -0.125)}


def smooth_signals(instances: Instances) -> NDArray[np.bool_]:
    """Which signals are real numbers, shape (layout.size,): others keep their value over a step."""
    smooth = np.zeros(instances.layout.size, np.bool_)
    for port, place in instances.layout.index.items():
        smooth[place] = instances.system.variable(port).kind is Kind.REAL
    return smooth


class Extrapolation:
    """The curve of all signals over a step, from the points before and, as instances step, from the end.

    The first step knows one point only, and holds it; the second is linear at most.
    """

    def __init__(self, instances: Instances, point: Point, values: Array, order: int) -> None:
        self._instances = instances
        kept = instances.memory.setdefault("points", [])
        if "smooth" not in instances.memory:
            instances.memory["smooth"] = smooth_signals(instances)
        self._smooth = instances.memory["smooth"]
        # A step that is not the successor of the one before it begins anew.
        while kept and kept[-1][0] >= point.index:
            kept.pop()
        if kept and kept[-1][0] != point.index - 1:
            kept.clear()
        kept.append((point.index, values))
        del kept[: -order - 1]
        self._points = [one for _, one in reversed(kept)]
        self._order = min(order, len(kept) - 1)
        self._step_size = point.step_size
        self.curve: Curve | None = None
        if self._order:
            middle, end = (
                np.where(self._smooth, self._mixed(weights, self._points), values)
                for weights in _AHEAD[self._order]
            )
            self.curve = Curve(values, middle, end, self._order, point.step_size)

    @staticmethod
    def _mixed(weights: tuple[float, ...], points: list[Array]) -> Array:
        return sum((weight * one for weight, one in zip(weights, points, strict=False)), 0.0)  # type: ignore[return-value]

    def stepped(self, index: int) -> None:
        """An instance has stepped: its signals at the end are known."""
        if self.curve is None:
            return
        span = self._instances.layout.spans[index]
        known = self._instances.values[span]
        points = [known, *(one[span] for one in self._points)]
        within = self._mixed(_WITHIN[self._order], points)
        self.curve.end[span] = known
        self.curve.middle[span] = np.where(self._smooth[span], within, known)
