"""Solve x = F(x), where every value of F costs a step of FMUs and no derivative of F may be at hand.

Residuals are reported relative to max(|F(x)|, nominal), per component.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from .arrays import Array

Function = Callable[[Array], Array]

# Of a one-sided difference: balances truncation and rounding for functions of order one.
_DIFFERENCE = float(np.sqrt(np.finfo(np.float64).eps))
# Differences carry an error of about 1.5e-8: what is nearer to singular than this cannot be reported from it.
_SINGULAR = 1e-7


class Singular(Exception):
    """I - dF/dx has no inverse: there is no solution, or no single one."""


class Solver(Protocol):
    """Proposes the next x. One serves a sequence of like problems, and may carry what it learns over."""

    def begin(self) -> None:
        """A new problem begins."""

    def propose(self, x: Array, f: Array, function: Function) -> Array:
        """The next x, shape (n,), given f = F(x). Raises: Singular."""


class Solution(NamedTuple):
    """How it went.

    Attributes:
        x: the last x, shape (n,).
        value: F(x); nothing else was evaluated after it.
        residual: |F(x) - x| / max(|F(x)|, nominal), shape (n,).
        iterations: evaluations of F, differences not counted.
        converged: whether every residual is within the tolerance.
        why: what ended it otherwise; empty if the iterations were used up.
    """

    x: Array
    value: Array
    residual: Array
    iterations: int
    converged: bool
    why: str = ""


def relative_residual(x: Array, f: Array, nominal: Array) -> Array:
    """Residual relative to max(|f|, nominal), shape (n,); infinite where a value is not finite."""
    with np.errstate(invalid="ignore", over="ignore"):
        residual = np.abs(f - x) / np.maximum(np.abs(f), nominal)
    residual[~np.isfinite(residual)] = np.inf
    return residual


def solve(
    function: Function,
    start: Array,
    nominal: Array,
    solver: Solver,
    *,
    tolerance: float,
    max_iterations: int,
    discrete: NDArray[np.bool_] | None = None,
) -> Solution:
    """Iterate x -> F(x) until every relative residual is within the tolerance.

    Args:
        function: F, shape (n,) -> (n,).
        start: first x, shape (n,).
        nominal: magnitudes below which a component counts as zero, shape (n,), positive.
        solver: made for the components that are not discrete.
        tolerance: of the relative residual.
        max_iterations: evaluations of F besides those for differences, at least 1.
        discrete: components that take only certain values: they are passed on as they come and must agree
            exactly, shape (n,).
    """
    solver.begin()
    smooth = slice(None) if discrete is None or not discrete.any() else ~discrete
    x = start.copy()
    for iteration in range(1, max_iterations + 1):
        f = function(x)
        residual = relative_residual(x, f, nominal)
        if discrete is not None:
            jumped = discrete & (f != x)
            residual[jumped] = np.inf
        if (residual <= tolerance).all():
            return Solution(x, f, residual, iteration, True)
        if iteration == max_iterations:
            break
        if discrete is not None and jumped.any():
            # A different problem from here onwards: residuals before and after a jump cannot be compared.
            solver.begin()
            x = np.where(discrete, f, x)
            continue
        following = f.copy()

        def restricted(part: Array, held: Array = x) -> Array:
            whole = held.copy()
            whole[smooth] = part
            return function(whole)[smooth]

        try:
            following[smooth] = solver.propose(x[smooth], f[smooth], restricted)
        except Singular as error:
            return Solution(x, f, residual, iteration, False, str(error))
        if not np.isfinite(following).all():
            return Solution(x, f, residual, iteration, False, "the values grow beyond all bounds")
        x = following
    return Solution(x, f, residual, iteration, False)


class FixedPoint:
    """x + w (F(x) - x): converges where F contracts, or is made to by the relaxation w."""

    def __init__(self, relaxation: float = 1.0) -> None:
        self._relaxation = relaxation

    def begin(self) -> None:
        """See Solver.begin."""

    def propose(self, x: Array, f: Array, function: Function) -> Array:
        """See Solver.propose."""
        return x + self._relaxation * (f - x)


class Anderson:
    """Anderson's mixing over the latest iterates (type II; Walker and Ni, SIAM J. Numer. Anal. 49, 2011).

    In coupled problems known as interface quasi-Newton with inverse least squares (IQN-ILS).
    """

    def __init__(self, nominal: Array, depth: int = 5, relaxation: float = 1.0) -> None:
        self._nominal, self._depth, self._relaxation = nominal, depth, relaxation
        self.begin()

    def begin(self) -> None:
        """See Solver.begin."""
        self._x: list[Array] = []
        self._r: list[Array] = []

    def propose(self, x: Array, f: Array, function: Function) -> Array:
        """See Solver.propose."""
        r = f - x
        self._x = [*self._x[-self._depth :], x]
        self._r = [*self._r[-self._depth :], r]
        following = x + self._relaxation * r
        if len(self._x) == 1 or not np.isfinite(r).all():
            return following
        dx, dr = np.diff(self._x, axis=0).T, np.diff(self._r, axis=0).T
        scale = 1.0 / np.maximum(self._nominal, np.abs(f))
        # Columns of very unlike length, as a diverging start gives, would drown one another.
        length = np.linalg.norm(dr * scale[:, None], axis=0)
        length[length == 0.0] = 1.0
        weight = np.linalg.lstsq(dr * scale[:, None] / length, r * scale, rcond=None)[0] / length
        return following - (dx + self._relaxation * dr) @ weight


class Newton:
    """Newton's method on r(x) = F(x) - x, with Broyden's update between evaluations of the slope.

    The slope is evaluated first of all, and again where convergence is slow; it is carried over to the next
    problem. A step that makes the residual larger is halved.
    """

    def __init__(self, nominal: Array, slope: Callable[[], Array] | None = None) -> None:
        """See the class.

        Args:
            nominal: shape (n,).
            slope: gives dF/dx, shape (n, n), at the x that was evaluated last, exactly or nearly: it serves
                to begin with, where it does not do differences are taken; None: differences throughout.
        """
        self._nominal = nominal
        self._slope = slope
        self._matrix: Array | None = None
        self.begin()

    def begin(self) -> None:
        """See Solver.begin."""
        self._best: tuple[Array, Array, float] | None = None
        self._fresh = False
        self._damping = 1.0
        self._step = np.zeros(0)

    def propose(self, x: Array, f: Array, function: Function) -> Array:
        """See Solver.propose."""
        r = f - x
        # Over the nominal values alone: relative to F(x), running off to infinity would pass for progress.
        size = float((np.abs(r) / self._nominal).max()) if np.isfinite(r).all() else np.inf
        before = self._best
        if before is None or size < before[2]:
            self._best = (x, r, size)
            self._damping = 1.0
            slow = False
            if before is not None and self._matrix is not None:
                self._update(x - before[0], r - before[1])
                slow = size > 0.3 * before[2]
            if self._matrix is None or (slow and not self._fresh):
                self._build(x, f, function)
            else:
                self._fresh = False
            self._step = self._solved(x, f, r, function)
            return x + self._step
        best, its_residual, _ = before
        if not self._fresh:
            self._build(best, best + its_residual, function)
            self._step = self._solved(best, best + its_residual, its_residual, function)
        else:
            self._damping *= 0.5
        return best + self._damping * self._step

    def _update(self, dx: Array, dr: Array) -> None:
        assert self._matrix is not None
        weighted = dx / self._nominal**2
        length = float(dx @ weighted)
        if length > 0.0:
            self._matrix = self._matrix + np.outer(dr - self._matrix @ dx, weighted) / length

    def _build(self, x: Array, f: Array, function: Function) -> None:
        count = len(x)
        if self._slope is not None:
            slope, self._slope = self._slope(), None
        else:
            slope = np.empty((count, count))
            for j in range(count):
                moved = x.copy()
                moved[j] += _DIFFERENCE * max(abs(x[j]), abs(f[j]), self._nominal[j])
                # The difference that was made, not the one that was meant: they differ by rounding.
                slope[:, j] = (function(moved) - f) / (moved[j] - x[j])
        if not np.isfinite(slope).all():
            raise Singular("its slope is not finite")
        if _is_singular(slope):
            raise Singular("its loop gain is 1, so that there is no solution or no single one")
        self._matrix = slope - np.eye(count)
        self._fresh = True

    def _solved(self, x: Array, f: Array, r: Array, function: Function) -> Array:
        assert self._matrix is not None
        try:
            return np.linalg.solve(self._matrix, -r).astype(np.float64, copy=False)
        except np.linalg.LinAlgError:
            self._build(x, f, function)
            return np.linalg.solve(self._matrix, -r).astype(np.float64, copy=False)


def _is_singular(slope: Array) -> bool:
    """Whether I - slope cannot be distinguished from a singular matrix."""
    # Singular values would depend on the components' units, newtons beside metres; eigenvalues do not.
    gains = np.linalg.eigvals(slope)
    return bool(np.abs(gains - 1.0).min() < _SINGULAR * max(1.0, float(np.abs(gains).max())))
