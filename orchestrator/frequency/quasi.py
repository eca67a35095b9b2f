"""Quasi-polynomials: what stands in the characteristic equation of a loop with delays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.errors import ConfigError, Problem
from .transfer import Array, Transfer, horner, plus, product, times, trimmed

__all__ = ["QuasiPolynomial", "characteristic"]

Complex = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class QuasiPolynomial:
    """sum over i, j of a_ij s^j exp(-tau_i s), of retarded type: the delay-free part has the highest power.

    Attributes:
        coefficients: a, shape (terms, degree + 1, *batch), ascending powers.
        delays: tau, shape (terms, *batch) [s]; the first is zero.
    """

    coefficients: Array
    delays: Array

    @property
    def degree(self) -> int:
        """The highest power of s."""
        return self.coefficients.shape[1] - 1

    def __call__(self, s: ArrayLike) -> Complex:
        """Value at s [rad/s]."""
        return self.with_slope(s)[0]

    def with_slope(self, s: ArrayLike) -> tuple[Complex, Complex]:
        """Value at s, and its derivative there."""
        s = np.asarray(s, np.complex128)
        value, slope = np.zeros_like(s), np.zeros_like(s)
        for row, delay in zip(self.coefficients, self.delays, strict=True):
            inner, inner_slope = np.zeros_like(s), np.zeros_like(s)
            for coefficient in row[::-1]:
                inner_slope = inner_slope * s + inner
                inner = inner * s + coefficient
            decay = np.exp(-s * delay)
            value = value + inner * decay
            slope = slope + (inner_slope - delay * inner) * decay
        return value, slope

    def size(self, s: ArrayLike) -> Array:
        """Sum of the terms' absolute values at s: what rounding errors of the value are relative to."""
        s = np.asarray(s, np.complex128)
        total = np.zeros(s.shape)
        for row, delay in zip(self.coefficients, self.delays, strict=True):
            total = total + horner(np.abs(row), np.abs(s)) * np.exp(-s.real * delay)
        return total

    def slope_bound(self, magnitude: ArrayLike, leftmost: ArrayLike) -> Array:
        """Upper bound of the derivative's absolute value where |s| <= magnitude and Re s >= leftmost."""
        magnitude, leftmost = np.asarray(magnitude), np.asarray(leftmost)
        total = np.zeros(np.broadcast_shapes(magnitude.shape, leftmost.shape))
        for row, delay in zip(self.coefficients, self.delays, strict=True):
            inner, inner_slope = np.zeros_like(magnitude), np.zeros_like(magnitude)
            for coefficient in np.abs(row[::-1]):
                inner_slope = inner_slope * magnitude + inner
                inner = inner * magnitude + coefficient
            total = total + (inner_slope + delay * inner) * np.exp(-leftmost * delay)
        return total

    def reach(self, leftmost: float) -> Array:
        """A radius beyond which there is no root with Re s >= leftmost, shape (*batch) [rad/s].

        There the highest power outweighs all others: Cauchy's bound, each delay's exponential taken at its
        largest.
        """
        weights = np.exp(-leftmost * self.delays)
        weighed = np.einsum("ij...,i...->j...", np.abs(self.coefficients), weights)
        others = weighed[:-1] / np.abs(self.coefficients[0, -1])
        if not self.degree:
            return np.zeros(others.shape[1:])
        powers = (self.degree - np.arange(self.degree)).reshape(-1, *([1] * (others.ndim - 1)))
        # The largest of (n b_j)^(1/(n - j)) is such a radius.
        return np.max((self.degree * others) ** (1.0 / powers), axis=0)

    def pick(self, *index: Any) -> QuasiPolynomial:
        """One of a batch, or some of it, without highest powers that are zero throughout."""
        shape = (slice(None), slice(None), *index)
        delays = np.broadcast_to(self.delays, (len(self.delays), *self.coefficients.shape[2:]))
        chosen = self.coefficients[shape]
        present = np.flatnonzero(chosen[0].reshape(chosen.shape[1], -1).any(axis=1))
        return QuasiPolynomial(chosen[:, : present[-1] + 1], delays[(slice(None), *index)])

    def scaled(self, scale: float) -> QuasiPolynomial:
        """The same in z = s/scale, over its leading coefficient: numbers near one."""
        powers = scale ** (np.arange(self.degree + 1) - self.degree)
        powers = powers.reshape(1, -1, *([1] * (self.coefficients.ndim - 2)))
        return QuasiPolynomial(self.coefficients * powers / self.coefficients[0, -1], self.delays * scale)


def characteristic(loop: Transfer, name: str = "loop") -> QuasiPolynomial:
    """Numerator of 1 + L(s) over the common denominator: its roots are those of the closed loop.

    Common factors of numerator and denominator are kept: an unstable one would be unstable still.

    Raises: ConfigError if the closed loop is not of retarded type: L improper, an algebraic loop, or a
        neutral equation.
    """
    factors: list[Array] = []
    for term in loop.terms:
        for factor in term.factors:
            needed = sum(one is factor or _same(one, factor) for one in term.factors)
            if sum(one is factor or _same(one, factor) for one in factors) < needed:
                factors.append(factor)
    below = trimmed(product(factors))
    _refuse_improper(loop, name)
    rows: list[tuple[Array, Array]] = [(np.zeros(()), below)]
    for term in loop.terms:
        left = list(factors)
        for factor in term.factors:
            left.pop(next(i for i, one in enumerate(left) if one is factor or _same(one, factor)))
        added = times(term.numerator, product(left))
        for index, (delay, total) in enumerate(rows):
            if np.shape(delay) == np.shape(term.delay) and np.array_equal(delay, term.delay):
                rows[index] = delay, plus(total, added)
                break
        else:
            if not np.any(term.delay):
                rows[0] = rows[0][0], plus(rows[0][1], added)
            else:
                rows.append((term.delay, added))
    batch = np.broadcast_shapes(*(np.shape(delay) for delay, _ in rows), *(row.shape[1:] for _, row in rows))
    coefficients = np.zeros((len(rows), len(below), *batch))
    for index, (_, row) in enumerate(rows):
        row = trimmed(row)
        coefficients[index, : len(row)] = row.reshape(
            len(row), *([1] * (len(batch) + 1 - row.ndim)), *row.shape[1:]
        )
    return QuasiPolynomial(coefficients, np.stack([np.broadcast_to(delay, batch) for delay, _ in rows]))


def _same(one: Array, other: Array) -> bool:
    return one.shape == other.shape and bool(np.array_equal(one, other))


def _refuse_improper(loop: Transfer, name: str) -> None:
    for term in loop.terms:
        above = len(trimmed(term.numerator)) - 1
        below = len(trimmed(term.denominator())) - 1
        got = f"a term of the loop has a numerator of degree {above} over a denominator of degree {below}"
        if above > below:
            raise ConfigError(
                [
                    Problem(
                        name,
                        f"the loop is improper: {got}",
                        "",
                        "Give the part that differentiates a time constant.",
                    )
                ]
            )
        if above == below and not np.all(term.delay > 0.0):
            raise ConfigError(
                [
                    Problem(
                        name,
                        f"algebraic loop: {got}, without delay",
                        "a loop whose gain falls to zero at high frequency",
                        "Give a part of the loop a delay or a lag.",
                    )
                ]
            )
        if above == below:
            raise ConfigError(
                [
                    Problem(
                        name,
                        f"the closed loop is of neutral type: {got}, with delay",
                        "a loop whose gain falls to zero at high frequency",
                        "Give a part of the loop a lag.",
                    )
                ]
            )
