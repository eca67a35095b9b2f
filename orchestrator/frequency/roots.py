"""Rightmost roots of quasi-polynomials, found by spectral discretisation and certified on their own equation.

Discretisation: the infinitesimal generator of the delay equation by Chebyshev collocation (Breda, Maset,
Vermiglio, SIAM J. Sci. Comput. 27, 2005). Its eigenvalues only begin Newton's method; what counts is the
residual, and that the argument principle finds as many roots to the right of a line as are listed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from ..base.errors import OrchestratorError
from .quasi import Complex, QuasiPolynomial
from .transfer import Array

__all__ = ["Roots", "count_right_of", "rightmost_roots"]

_RESIDUAL = 1e-12
_ORDERS = (16, 32, 64, 128, 256)
# A discretisation that has found some roots but not all asked for is refined no further than this: the others
# lie so far to the left that they do not matter.
_ENOUGH = 64
# Pieces of the upper quarter of a circle to begin with, and equations whose roots are counted at once.
_ON_ARC = 16
_AT_ONCE = 2000


@dataclass(frozen=True)
class Roots:
    """The rightmost roots of a quasi-polynomial.

    Attributes:
        values: roots in order of falling real part, conjugates side by side, shape (n,) [rad/s].
        residuals: of each, |p(s)| over the sum of the absolute values of p's terms, shape (n,).
        line: a real part [rad/s] to the right of which there are these roots and no others, counted by the
            argument principle with bounds that leave no gap but rounding.
        order: of the discretisation that sufficed.
    """

    values: Complex
    residuals: Array
    line: float
    order: int

    @property
    def unstable(self) -> int:
        """How many roots have a positive real part."""
        return int(np.sum(self.values.real > 0.0))

    @property
    def abscissa(self) -> float:
        """The largest real part [rad/s]; negative: stable."""
        return float(self.values[0].real)


def rightmost_roots(equation: QuasiPolynomial, count: int = 6) -> Roots:
    """The rightmost roots: `count` or a few more, or fewer where the next lie out of the discretisation's
    reach.

    Args:
        equation: one quasi-polynomial, not a batch.
        count: how many; roots of nearly the same real part are not torn apart.
    Returns: at least one, complete to the right of `line`.
    Raises: OrchestratorError if no discretisation up to order 256 leads to a set that can be certified.
    """
    scale = _scale(equation)
    small = equation.scaled(scale)
    longest = float(np.max(small.delays))
    if longest == 0.0:
        found = np.roots(small.coefficients.sum(axis=0)[::-1])
        values = _sorted(_polished(small, found))
        return Roots(values * scale, _residuals(small, values), -np.inf, 0)
    best: Roots | None = None
    for order in _ORDERS:
        guesses = _eigenvalues(small, order)
        guesses = guesses[np.argsort(-guesses.real)][: 2 * count + 20]
        values = _sorted(_distinct(_polished(small, guesses)))
        for line, number in _lines(values, count):
            if count_right_of(small, line) != number:
                continue
            kept = values[:number]
            found = Roots(kept * scale, _residuals(small, kept), line * scale, order)
            if number >= count:
                return found
            if best is None or number > len(best.values):
                best = found
            break
        if best is not None and order >= _ENOUGH:
            return best
    raise OrchestratorError(
        f"the rightmost roots could not be certified with a discretisation of order {_ORDERS[-1]}\n"
        "  Two may lie closer together than a part in 1e7, or one on top of another."
    )


def count_right_of(equation: QuasiPolynomial, line: float = 0.0) -> int:
    """Number of roots with Re s > line, by the argument principle around a half-disc that holds them all.

    Every piece of the contour is divided until a bound of the derivative shows that the value's image cannot
    go around zero within it, so that no turn is missed.

    Raises: OrchestratorError if a root lies on the line to within rounding.
    """
    batch = QuasiPolynomial(equation.coefficients[..., None], equation.delays[..., None])
    (count,) = counts_right_of(batch, line)
    if count < 0:
        raise OrchestratorError(
            f"a root lies on the line Re s = {line:g} to within rounding: roots cannot be counted there"
        )
    return int(count)


def counts_right_of(equation: QuasiPolynomial, line: float = 0.0) -> NDArray[np.int64]:
    """`count_right_of` for a batch of one axis, shape (n,); -1 where a root lies on the line."""
    parts = range(0, equation.delays.shape[1], _AT_ONCE)
    return np.concatenate(
        [
            _counts(
                QuasiPolynomial(
                    equation.coefficients[..., low : low + _AT_ONCE],
                    equation.delays[:, low : low + _AT_ONCE],
                ),
                line,
            )
            for low in parts
        ]
    )


def _counts(equation: QuasiPolynomial, line: float) -> NDArray[np.int64]:
    number = equation.delays.shape[1]
    radius = 1.001 * equation.reach(line) + abs(line) + 1e-300
    # Counter-clockwise: from the lower to the upper end, through the right.
    half_angle = np.arccos(np.clip(line / radius, -1.0, 1.0))
    top = radius * np.sin(half_angle)
    # Conjugate symmetry: the upper half of the contour turns as much as the lower.
    arc = radius * np.exp(1j * half_angle * np.linspace(0.0, 1.0, _ON_ARC + 1)[:, None])
    arc[-1] = line + 1j * top
    path = np.concatenate([arc, line + 1j * top * np.linspace(1.0, 0.0, 65)[1:, None]])
    begin, end = path[:-1].ravel(), path[1:].ravel()
    owner = np.tile(np.arange(number), len(path) - 1)
    on_arc = np.repeat(np.arange(len(path) - 1) < _ON_ARC, number)
    turn, depth = np.zeros(number), 0
    at_begin, at_end = _of(equation, owner)(begin), _of(equation, owner)(end)
    while begin.size and depth <= 60:
        own = _of(equation, owner)
        bow = radius[owner] * np.exp(0.5j * (np.angle(begin) + np.angle(end)))
        middle = np.where(on_arc, bow, 0.5 * (begin + end))
        at_middle = own(middle)
        reach = np.maximum(np.abs(begin - middle), np.abs(end - middle)) * np.where(on_arc, 1.001, 1.0)
        bound = reach * own.slope_bound(np.abs(middle) + reach, np.minimum(begin.real, end.real))
        fine = bound < np.abs(at_middle)
        turned = np.angle(at_middle[fine] / at_begin[fine]) + np.angle(at_end[fine] / at_middle[fine])
        turn += np.bincount(owner[fine], turned, number)
        coarse = ~fine
        depth += 1
        begin, end = _halves(begin[coarse], middle[coarse], end[coarse])
        at_begin, at_end = _halves(at_begin[coarse], at_middle[coarse], at_end[coarse])
        on_arc, owner = np.tile(on_arc[coarse], 2), np.tile(owner[coarse], 2)
    counts = np.rint(turn / np.pi).astype(np.int64)
    counts[owner] = -1
    return counts


def _of(equation: QuasiPolynomial, owner: NDArray[np.int64]) -> QuasiPolynomial:
    """For each piece of contour its own equation."""
    return QuasiPolynomial(equation.coefficients[..., owner], equation.delays[:, owner])


def _halves(begin: Complex, middle: Complex, end: Complex) -> tuple[Complex, Complex]:
    return np.concatenate([begin, middle]), np.concatenate([middle, end])


def _scale(equation: QuasiPolynomial) -> float:
    """A frequency typical of the roots: mean of the delay-free polynomial's, or 1/delay."""
    row = np.abs(equation.coefficients).sum(axis=0)
    lowest = int(np.flatnonzero(row)[0])
    longest = float(np.max(equation.delays))
    if lowest == equation.degree:
        return 1.0 / longest if longest else 1.0
    return float((row[lowest] / row[-1]) ** (1.0 / (equation.degree - lowest)))


def _eigenvalues(equation: QuasiPolynomial, order: int) -> Complex:
    """Eigenvalues of the collocated generator: x' = A_0 x + sum of A_i x(t - tau_i) in companion form."""
    n = equation.degree
    longest = float(np.max(equation.delays))
    nodes = 0.5 * longest * (np.cos(np.pi * np.arange(order + 1) / order) - 1.0)
    weights = np.ones(order + 1)
    weights[[0, -1]] = 0.5
    weights[1::2] *= -1.0
    gaps = nodes[:, None] - nodes[None, :]
    np.fill_diagonal(gaps, 1.0)
    derivative = weights[None, :] / weights[:, None] / gaps
    np.fill_diagonal(derivative, 0.0)
    np.fill_diagonal(derivative, -derivative.sum(axis=1))
    generator = np.kron(derivative, np.eye(n))
    generator[:n] = 0.0
    generator[: n - 1, 1:n] = np.eye(n - 1)
    for row, delay in zip(equation.coefficients, equation.delays, strict=True):
        apart = -delay - nodes
        near = int(np.argmin(np.abs(apart)))
        if abs(apart[near]) < 1e-14 * longest:
            values = np.eye(order + 1)[near]
        else:
            values = weights / apart
            values /= values.sum()
        generator[n - 1] -= np.kron(values, row[:n] / equation.coefficients[0, n])
    return scipy.linalg.eigvals(generator)


def _polished(equation: QuasiPolynomial, guesses: Complex) -> Complex:
    """Newton's method from all guesses at once; those that do not converge are dropped."""
    s = np.asarray(guesses, np.complex128).copy()
    with np.errstate(all="ignore"):
        for _ in range(60):
            value, slope = equation.with_slope(s)
            step = value / slope
            # A far leap leaves the neighbourhood that the guess stands for.
            limit = 0.5 * (1.0 + np.abs(s))
            step = step * np.minimum(1.0, limit / np.maximum(np.abs(step), 1e-300))
            s = np.where(np.isfinite(step), s - step, s)
            if not np.any(np.abs(step) > 1e-15 * (1.0 + np.abs(s))):
                break
        good = np.isfinite(s) & (_residuals(equation, s) < _RESIDUAL)
    s = s[good]
    return np.where(np.abs(s.imag) < 1e-9 * (1.0 + np.abs(s)), s.real + 0j, s)


def _residuals(equation: QuasiPolynomial, s: Complex) -> Array:
    return np.abs(equation(s)) / np.maximum(equation.size(s), 1e-300)


def _distinct(values: Complex) -> Complex:
    """The upper half, each once, then mirrored; a double root, found to half the digits, counts once."""
    kept: list[complex] = []
    for one in values[np.argsort(-values.real)]:
        one = complex(one.real, abs(one.imag))
        if all(abs(one - other) > 1e-7 * (1.0 + abs(one)) for other in kept):
            kept.append(one)
    return np.array([z for one in kept for z in ([one] if one.imag == 0.0 else [one, one.conjugate()])])


def _sorted(values: Complex) -> Complex:
    return values[np.lexsort((values.imag < 0.0, np.abs(values.imag), -values.real))]


def _lines(values: Complex, wanted: int) -> list[tuple[float, int]]:
    """Lines clear of the roots, with the roots right of each: for as many as are wanted, then fewer."""
    real = values.real
    lines = []
    for number in (*range(min(wanted, len(real)), len(real) + 1), *range(min(wanted, len(real)) - 1, 0, -1)):
        below = real[number] if number < len(real) else real[-1] - 0.2 * (1.0 + abs(real[-1]))
        gap = real[number - 1] - below
        if gap > 1e-6 * (1.0 + abs(below)):
            lines.append((float(real[number - 1] - 0.5 * gap), number))
    return lines


def newton_batch(equation: QuasiPolynomial, guess: NDArray[np.complex128], steps: int = 12) -> Complex:
    """Newton's method for a whole batch, one guess each; NaN where it does not converge."""
    s = np.array(guess, np.complex128)
    with np.errstate(all="ignore"):
        for _ in range(steps):
            value, slope = equation.with_slope(s)
            s = s - value / slope
        return np.where(_residuals(equation, s) < 1e-10, s, np.nan)
