"""A descent to the least sum of squares: Levenberg and Marquardt's, with Broyden's updates of derivatives."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .study import Array

_MAX_ITERATIONS = 30
# Steps after which updated derivatives are computed again.
_STALE = 5
# A descent has converged when the cost falls by less.
_CONVERGED = 0.3
# Damping at first, how often it is raised in vain, and that, as a share of the curvature, which holds nothing
# back.
_DAMPED, _RAISED, _UNDAMPED = 1e-3, 6, 1e-9


def cost_of(r: Array, z: Array) -> float:
    """Sum of squares of normalised residuals and parameters; infinite where a model runs away."""
    with np.errstate(over="ignore", invalid="ignore"):
        cost = float(r @ r + z @ z)
    return cost if math.isfinite(cost) else math.inf


@dataclass
class Place:
    """State of a descent.

    Attributes:
        z: normalised parameters; r: residuals; cost: see `cost_of`; jacobian: derivatives of the residuals;
            fresh: whether these were taken here, and did not only follow the steps.
    """

    z: Array
    r: Array
    cost: float
    jacobian: Array
    fresh: bool

    @property
    def hessian(self) -> Array:
        """Curvature of half the cost, as if the residuals were linear."""
        return self.jacobian.T @ self.jacobian + np.eye(len(self.z))


@dataclass
class Descent:
    """The problem of a descent.

    Attributes:
        residuals: of normalised parameters; derivatives: of parameters and residuals there, shape
            (residuals, parameters).
        low, high: least and largest parameters; smooth: places of those that derivatives say about.
    """

    residuals: Callable[[Array], Array]
    derivatives: Callable[[Array, Array], Array]
    low: Array
    high: Array
    smooth: NDArray[np.intp]
    _damping: float = _DAMPED

    def run(self, at: Place, aim: float) -> None:
        """Descend from a place, which is moved.

        Args:
            aim: a cost; a descent that will not come near it is given up.
        """
        self._damping, stale = _DAMPED, 0
        for iteration in range(_MAX_ITERATIONS):
            fresh_before = at.fresh
            hessian, slope = at.hessian, at.jacobian.T @ at.r + at.z
            free = self._free(at.z, slope)
            if at.fresh:
                promised = float(slope[free] @ np.linalg.solve(hessian[np.ix_(free, free)], slope[free]))
                if promised < _CONVERGED:
                    break
            gain = self._advance(at, hessian, slope, free)
            if gain < _CONVERGED and fresh_before:
                break
            if iteration > 3 and at.cost > aim and 10.0 * gain < at.cost - aim:
                break
            stale = 0 if at.fresh else stale + 1
            if not fresh_before and (gain < max(_CONVERGED, 2e-4 * at.cost) or stale > _STALE):
                at.jacobian, at.fresh, self._damping = self.derivatives(at.z, at.r), True, _DAMPED

    def _free(self, z: Array, slope: Array) -> NDArray[np.intp]:
        """Places to move: not of parameters at a bound that the slope leads beyond.

        Others would be moved as if these could follow.
        """
        held = ((z <= self.low) & (slope > 0.0)) | ((z >= self.high) & (slope < 0.0))
        return self.smooth[~held[self.smooth]]

    def _advance(self, at: Place, hessian: Array, slope: Array, free: NDArray[np.intp]) -> float:
        """Take the longest step that lowers the cost; returns the gain, 0 if there is none."""
        for _ in range(_RAISED):
            damped = (hessian + self._damping * np.diag(np.diag(hessian)))[np.ix_(free, free)]
            z, r, cost = self._at(self._less(at.z, free, np.linalg.solve(damped, slope[free])))
            if at.cost < cost < math.inf:
                # Along a valley, as of two numbers that only count by their sum, a long step is right but
                # for a little across: the valley is steep, and no shorter step would go far along it.
                back = np.linalg.solve(damped, (at.jacobian.T @ r + z)[free])
                second = self._at(self._less(z, free, back))
                if second[2] < at.cost:
                    z, r, cost = second
            if cost < at.cost:
                move, gain = z - at.z, at.cost - cost
                # Broyden's update: the derivatives along the step just taken are known.
                at.jacobian += np.outer(r - at.r - at.jacobian @ move, move / (move @ move))
                at.z, at.r, at.cost, at.fresh = z, r, cost, False
                self._damping = max(self._damping / 10.0, _UNDAMPED)
                return gain
            self._damping *= 10.0
        return 0.0

    def _at(self, z: Array) -> tuple[Array, Array, float]:
        r = self.residuals(z)
        return z, r, cost_of(r, z)

    def _less(self, z: Array, places: NDArray[np.intp], step: Array) -> Array:
        """Parameters less a step in some places, within their bounds."""
        ahead = z.copy()
        ahead[places] -= step
        return np.clip(ahead, self.low, self.high)
