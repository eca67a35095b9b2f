"""How signals are supposed to run over a step that is yet to be taken."""

from __future__ import annotations

import numpy as np

from ..fmi import Array, Point
from ..instances import Curve, Instances

__all__ = ["Extrapolation"]

# Weights of the latest points, newest first, of the polynomial through them at the middle and at the end of
# the step that follows: Lagrange's for equidistant points.
_AHEAD = {
    1: ((1.5, -0.5), (2.0, -1.0)),
    2: ((1.875, -1.25, 0.375), (3.0, -3.0, 1.0)),
}
# The same at the middle of a step whose end is known, newest (the end) first.
_WITHIN = {1: (0.5, 0.5), 2: (0.375, 0.75, -0.125)}


class Extrapolation:
    """The curve of all signals over a step, from the points before and, as instances step, from the end.

    The first step knows one point only, and holds it; the second is linear at most.
    """

    def __init__(self, instances: Instances, point: Point, values: Array, order: int) -> None:
        self._instances = instances
        kept = instances.memory.setdefault("points", [])
        self._smooth = instances.layout.smooth
        # A step that is not the successor of the one before it begins anew.
        while kept and kept[-1][0] >= point.index:
            kept.pop()
        if kept and kept[-1][0] != point.index - 1:
            kept.clear()
        kept.append((point.index, values))
        del kept[: -order - 1]
        self._points = [one for _, one in reversed(kept)]
        self._order = min(order, len(kept) - 1)
        self._end = point.time + point.step_size
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
        """An instance has stepped: its signals at the end are known.

        What a connection makes of them and of others that are yet to come is made of these as they are
        supposed to be.
        """
        if self.curve is None:
            return
        layout = self._instances.layout
        span = layout.spans[index]
        self._settle(span, self._instances.values[span])
        if self._instances.wires is not None:
            for one in layout.wired_after[index]:
                self._instances.wires.try_out([one], self._end, self.curve.end)
                place = slice(one.place, one.place + 1)
                self._settle(place, self.curve.end[place].copy())

    def _settle(self, span: slice, known: Array) -> None:
        assert self.curve is not None
        points = [known, *(one[span] for one in self._points)]
        within = self._mixed(_WITHIN[self._order], points)
        self.curve.end[span] = known
        self.curve.middle[span] = np.where(self._smooth[span], within, known)
