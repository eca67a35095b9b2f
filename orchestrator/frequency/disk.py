"""Disk margins: by how much gain and phase of several loops may change at once.

Each loop is multiplied by a factor of the disk (1 + a d/2)/(1 - a d/2) with |d| < 1. The disk margin is the
largest a for which all such systems are stable (Seiler, Packard, Gahinet, IEEE Control Systems Magazine 40,
2020). It is 1 over the peak of the structured singular value of S - 1/2. The upper bound by scaling stands
for this value: exact up to three loops, and safe for more.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..base.arrays import Array, Complex
from .delay_system import DelaySystem
from .modes import Modes
from .refine import minima

_PEAKS = 4
_BALANCED = 12


@dataclass(frozen=True)
class DiskMargin:
    """What loops bear at once.

    Attributes:
        connections: that are opened.
        margin: a; at 2 or more, any gain is allowed; NaN where the closed system is unstable.
        omega: where it is least [rad/s].
        sensitivity_peak: largest singular value of the sensitivity (1 + L)^-1, which of several loops depends
            on the units of their signals.
        sensitivity_peak_at: [rad/s].
    """

    connections: tuple[str, ...]
    margin: float
    omega: float
    sensitivity_peak: float
    sensitivity_peak_at: float

    @property
    def gain(self) -> tuple[float, float]:
        """Factors by which the gains of all loops may fall and rise, each on its own."""
        low, high = max(1.0 - 0.5 * self.margin, 0.0), 1.0 + 0.5 * self.margin
        return low / high, high / low if low > 0.0 else np.inf

    @property
    def phase(self) -> float:
        """By how much the phases of all loops may turn, each on its own and in either sense [deg]."""
        return float(np.degrees(2.0 * np.arctan(0.5 * self.margin)))


def sensitivity(system: DelaySystem, connections: Sequence[str], omega: ArrayLike) -> Complex:
    """(1 + L)^-1 with connections opened, shape (k, loops, loops); omega: shape (k,) [rad/s]."""
    omega = np.atleast_1d(np.asarray(omega, np.float64))
    returned = np.eye(len(connections)) + system.open_loops(connections, omega)
    # A root that lies on the axis to rounding makes it infinite.
    returned[np.linalg.det(returned) == 0.0] += 1e-15 * np.eye(len(connections))
    return np.linalg.inv(returned)


def disk_margin(system: DelaySystem, connections: Sequence[str], modes: Modes | None = None) -> DiskMargin:
    """The disk margin of loops that are opened at once; of one connection, its own.

    Args:
        connections: as links name them.
        modes: what `system.modes` gave.
    """
    modes = modes or system.modes()
    half = 0.5 * np.eye(len(connections))

    def peak(w: Array) -> Array:
        return np.array([_bound(one) for one in sensitivity(system, connections, w) - half])

    def largest(w: Array) -> Array:
        return np.linalg.norm(sensitivity(system, connections, w), 2, axis=(1, 2))

    omega = system.frequencies(modes)
    whole = sensitivity(system, connections, omega)
    if modes.unstable:
        margin, place = np.nan, np.nan
    else:
        place, value = _highest(peak, omega, _balanced(whole - half))
        margin = 1.0 / value
    at, most = _highest(largest, omega, np.linalg.norm(whole, 2, axis=(1, 2)))
    return DiskMargin(tuple(connections), margin, place, most, at)


def _highest(function: Callable[[Array], Array], omega: Array, values: Array) -> tuple[float, float]:
    """Where a function is largest and its value, near the largest of its values on a grid."""
    inner = np.flatnonzero((values[1:-1] >= values[:-2]) & (values[1:-1] >= values[2:])) + 1
    tops = inner[np.argsort(-values[inner])][:_PEAKS]
    at, least = minima(lambda w: -function(w), omega[tops - 1], omega[tops + 1])
    ends = omega[[0, -1]]
    pairs = zip([*ends, *at], [*function(ends), *-least], strict=True)
    return max(((float(w), float(value)) for w, value in pairs), key=lambda one: one[1])


def _balanced(matrices: Complex) -> Array:
    """Largest singular values after Osborne's scaling, shape (k,)."""
    m = matrices.copy()
    count = m.shape[-1]
    for _ in range(_BALANCED if count > 1 else 0):
        for k in range(count):
            others = [one for one in range(count) if one != k]
            row = np.linalg.norm(m[:, k, others], axis=1)
            column = np.linalg.norm(m[:, others, k], axis=1)
            usable = (row > 0.0) & (column > 0.0)
            scale = np.sqrt(np.where(usable, column, 1.0) / np.where(usable, row, 1.0))
            m[:, k, :] *= scale[:, None]
            m[:, :, k] /= scale[:, None]
    return np.linalg.norm(m, 2, axis=(1, 2))


def _bound(matrix: Complex) -> float:
    """The least norm of D M D^-1 over diagonal matrices D."""
    count = len(matrix)
    if count == 1:
        return float(abs(matrix[0, 0]))

    from scipy.optimize import minimize, minimize_scalar

    def norm(logs: Array) -> float:
        scale = np.exp(np.concatenate([[0.0], np.atleast_1d(logs)]))
        return float(np.linalg.norm(scale[:, None] * matrix / scale, 2))

    if count == 2:
        found = minimize_scalar(norm, bounds=(-30.0, 30.0), method="bounded", options={"xatol": 1e-10})
        return min(float(found.fun), float(np.linalg.norm(matrix, 2)))
    # Convex, but with edges.
    best = minimize(norm, np.zeros(count - 1), method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-12})
    best = minimize(norm, best.x, method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-12})
    return float(best.fun)
