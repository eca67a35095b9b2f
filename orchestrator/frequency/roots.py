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

from ..errors import OrchestratorError
from .quasi import Complex, QuasiPolynomial
from .transfer import Array

__all__ = ["Roots", "count_right_of", "rightmost_roots"]

_RESIDUAL = 1e-12
_ORDERS = (16, 32, 64, 128, 256)
# A discretisation that has found some roots but not all asked for is refined no further than this: the others
# lie so far to the left that they do not matter.
_ENOUGH = 64


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
    radius = 1.001 * equation.reach(line) + abs(line) + 1e-300
    # Counter-clockwise: from the lower to the upper end, through the right.
    half_angle = float(np.arccos(np.clip(line / radius, -1.0, 1.0)))
    top = radius * np.sin(half_angle)
    angles = np.linspace(-half_angle, half_angle, 33)
    arc = radius * np.exp(1j * angles)
    # Conjugate symmetry: the upper half of the contour turns as much as the lower.
    path = np.concatenate([arc[16:], line + 1j * np.linspace(top, 0.0, 65)[1:]])
    path[16] = line + 1j * top
    begin, end = path[:-1], path[1:]
    on_arc = np.arange(len(begin)) < 16
    turn, depth = 0.0, 0
    at_begin, at_end = equation(begin), equation(end)
    while begin.size:
        middle = np.where(
            on_arc, radius * np.exp(0.5j * (np.angle(begin) + np.angle(end))), 0.5 * (begin + end)
        )
        at_middle = equation(middle)
        reach = np.maximum(np.abs(begin - middle), np.abs(end - middle)) * np.where(on_arc, 1.001, 1.0)
        bound = reach * equation.slope_bound(np.abs(middle) + reach, np.minimum(begin.real, end.real))
        fine = bound < np.abs(at_middle)
        turn += float(
            np.sum(np.angle(at_middle[fine] / at_begin[fine]) + np.angle(at_end[fine] / at_middle[fine]))
        )
        coarse = ~fine
        depth += 1
        if depth > 60:
            raise OrchestratorError(
                f"a root lies on the line Re s = {line:g} to within rounding: roots cannot be counted there"
            )
        begin, end = (
            np.concatenate([begin[coarse], middle[coarse]]),
            np.concatenate([middle[coarse], end[coarse]]),
        )
        at_begin, at_end = (
            np.concatenate([at_begin[coarse], at_middle[coarse]]),
            np.concatenate([at_middle[coarse], at_end[coarse]]),
        )
        on_arc = np.concatenate([on_arc[coarse], on_arc[coarse]])
    return round(turn / np.pi)


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
