"""Sums of rational transfer functions with exact delays: sum of N_i(s)/D_i(s) exp(-tau_i s).

Coefficients may be arrays, so that one expression stands for a whole chart of loops.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.errors import ConfigError, Problem

__all__ = ["Array", "Term", "Transfer", "times"]

Array = NDArray[np.float64]

_HIGHEST_PADE_ORDER = 14


def _aligned(one: Array, other: Array) -> tuple[Array, Array]:
    """Both with as many axes, so that batches broadcast and powers do not take part."""
    axes = max(one.ndim, other.ndim)
    return (
        one.reshape(len(one), *([1] * (axes - one.ndim)), *one.shape[1:]),
        other.reshape(len(other), *([1] * (axes - other.ndim)), *other.shape[1:]),
    )


def times(one: Array, other: Array) -> Array:
    """Product of two polynomials, coefficients along the first axis in ascending powers."""
    one, other = _aligned(one, other)
    product = np.zeros((len(one) + len(other) - 1, *np.broadcast_shapes(one.shape[1:], other.shape[1:])))
    for power, coefficient in enumerate(one):
        product[power : power + len(other)] += coefficient * other
    return product


def plus(one: Array, other: Array) -> Array:
    """Sum of two polynomials."""
    one, other = _aligned(one, other)
    total = np.zeros((max(len(one), len(other)), *np.broadcast_shapes(one.shape[1:], other.shape[1:])))
    total[: len(one)] += one
    total[: len(other)] += other
    return total


def trimmed(polynomial: Array) -> Array:
    """The polynomial without leading coefficients that are zero throughout."""
    present = np.flatnonzero(polynomial.reshape(len(polynomial), -1).any(axis=1))
    return polynomial[: present[-1] + 1] if present.size else polynomial[:1]


def horner(polynomial: Array, s: NDArray[Any]) -> NDArray[Any]:
    """Value of a polynomial at s."""
    value = np.zeros(np.broadcast_shapes(np.shape(s), polynomial.shape[1:]), np.result_type(s, 1.0))
    for coefficient in polynomial[::-1]:
        value = value * s + coefficient
    return value


def _equal(one: Array, other: Array) -> bool:
    return one is other or (one.shape == other.shape and bool(np.array_equal(one, other)))


@dataclass(frozen=True, eq=False)
class Term:
    """numerator(s) / product of factors(s) * exp(-delay s).

    Attributes:
        numerator: coefficients, shape (n + 1, *batch), ascending powers of s.
        factors: of the denominator, each as the numerator.
        delay: shape (*batch) [s], not negative.
    """

    numerator: Array
    factors: tuple[Array, ...]
    delay: Array

    def denominator(self) -> Array:
        """The factors' product."""
        product = np.ones(1)
        for factor in self.factors:
            product = times(product, factor)
        return product

    def same_place(self, other: Term) -> bool:
        """Whether delay and denominator are the same, so that numerators may be added."""
        return (
            _equal(self.delay, other.delay)
            and len(self.factors) == len(other.factors)
            and all(_equal(a, b) for a, b in zip(self.factors, other.factors, strict=True))
        )


@dataclass(frozen=True, eq=False)
class Transfer:
    """A sum of terms; add, subtract and multiply them like numbers."""

    terms: tuple[Term, ...] = ()

    @staticmethod
    def rational(
        numerator: ArrayLike, denominator: ArrayLike = (1.0,), delay: float = 0.0, name: str = "transfer"
    ) -> Transfer:
        """numerator/denominator exp(-delay s), coefficients in descending powers of s, as in python-control.

        Args:
            numerator, denominator: shapes (n + 1,), (d + 1,).
            delay: [s].
            name: stands in messages.
        Raises: ConfigError if a number is not finite, the denominator is zero or the delay is negative.
        """
        above, below = (np.atleast_1d(np.asarray(one, np.float64))[::-1] for one in (numerator, denominator))
        problems = []
        if not (np.isfinite(above).all() and np.isfinite(below).all()):
            problems.append(Problem(name, "a coefficient is not a finite number"))
        if not below.any():
            problems.append(Problem(name, "the denominator is zero", "it needs a coefficient that is not"))
        if not (np.isfinite(delay) and delay >= 0.0):
            problems.append(Problem(name, f"delay is {delay!r} s", "allowed: finite and not negative"))
        if problems:
            raise ConfigError(problems)
        return Transfer.made(above, (trimmed(below),), np.asarray(delay, np.float64))

    @staticmethod
    def of_control(system: Any, delay: float = 0.0, name: str = "transfer") -> Transfer:
        """A python-control system with one input and one output, behind a delay [s].

        Raises: ConfigError as `rational`, and if the system is discrete or has several ports.
        """
        import control

        rational = control.tf(system)
        if rational.ninputs != 1 or rational.noutputs != 1 or rational.isdtime(strict=True):
            what = f"it has {rational.ninputs} inputs, {rational.noutputs} outputs and dt = {rational.dt}"
            raise ConfigError([Problem(name, what, "one input, one output, continuous time")])
        return Transfer.rational(rational.num[0][0], rational.den[0][0], delay, name)

    @staticmethod
    def made(numerator: Array, factors: tuple[Array, ...] = (), delay: ArrayLike = 0.0) -> Transfer:
        """One term as it is: ascending powers, unchecked."""
        return Transfer((Term(np.asarray(numerator), factors, np.asarray(delay, np.float64)),))

    @staticmethod
    def gain(value: ArrayLike) -> Transfer:
        """A constant."""
        return Transfer.made(np.asarray(value, np.float64)[None])

    def __add__(self, other: Transfer) -> Transfer:
        terms = list(self.terms)
        for term in other.terms:
            for index, mine in enumerate(terms):
                if mine.same_place(term):
                    terms[index] = Term(plus(mine.numerator, term.numerator), mine.factors, mine.delay)
                    break
            else:
                terms.append(term)
        return Transfer(
            tuple(Term(trimmed(t.numerator), t.factors, t.delay) for t in terms if t.numerator.any())
        )

    def __neg__(self) -> Transfer:
        return Transfer(tuple(Term(-term.numerator, term.factors, term.delay) for term in self.terms))

    def __sub__(self, other: Transfer) -> Transfer:
        return self + -other

    def __mul__(self, other: Transfer | float) -> Transfer:
        if not isinstance(other, Transfer):
            other = Transfer.gain(other)
        product = Transfer()
        for one in self.terms:
            for two in other.terms:
                numerator = times(one.numerator, two.numerator)
                product += Transfer.made(numerator, one.factors + two.factors, one.delay + two.delay)
        return product

    __rmul__ = __mul__

    def __call__(self, s: ArrayLike) -> NDArray[np.complex128]:
        """Value at s [rad/s], exact in the delays."""
        s = np.asarray(s, np.complex128)
        value = np.zeros_like(s)
        for term in self.terms:
            below = np.ones_like(s)
            for factor in term.factors:
                below = below * horner(factor, s)
            value = value + horner(term.numerator, s) / below * np.exp(-s * term.delay)
        return value

    def frequency_response(self, omega: ArrayLike) -> Any:
        """python-control's FrequencyResponseData at omega, shape (n,) [rad/s], without an approximation."""
        import control

        omega = np.asarray(omega, np.float64)
        return control.frd(self(1j * omega), omega)

    @property
    def longest_delay(self) -> float:
        """The largest delay of all terms [s]."""
        return max((float(np.max(term.delay)) for term in self.terms), default=0.0)

    def pade(self, error: float, up_to: float) -> tuple[Any, int]:
        """A rational model whose every delay is replaced by the lowest Pade approximant that is good enough.

        An approximant of equal degrees n has modulus one, so its error is one of phase alone; it is found by
        comparison on 2000 frequencies up to `up_to`, below which it grows monotonically.

        Args:
            error: allowed |Pade(j w) - exp(-j w tau)| at all w <= up_to.
            up_to: highest frequency [rad/s].
        Returns: python-control's TransferFunction, and the order n of the longest delay's approximant.
        Raises: ConfigError if no order up to 14 is good enough: coefficients beyond lose their digits.
        """
        import control

        if not (error > 0.0 and up_to > 0.0):
            got = f"error = {error!r}, up_to = {up_to!r} rad/s"
            raise ConfigError([Problem("pade", got, "both are to be positive")])
        highest, total = 0, control.tf([0.0], [1.0])
        for term in self.terms:
            delay = float(term.delay)
            order = pade_order(delay, error, up_to)
            above, below = control.pade(delay, order) if order else ([1.0], [1.0])
            rational = control.tf(term.numerator[::-1], term.denominator()[::-1])
            total = total + rational * control.tf(above, below)
            highest = max(highest, order)
        return total, highest


def pade_order(delay: float, error: float, up_to: float) -> int:
    """The lowest order n whose (n, n) Pade approximant of exp(-delay s) has at most this error.

    Args: as `Transfer.pade`, delay in s. Returns: 0 where there is no delay.
    Raises: ConfigError if none up to 14 does.
    """
    if delay == 0.0:
        return 0
    phase = np.linspace(0.0, delay * up_to, 2001)
    for order in range(1, _HIGHEST_PADE_ORDER + 1):
        # Coefficients of the numerator in (-x), the denominator in x, for a delay of one.
        powers = np.arange(order + 1)
        weights = [
            math.factorial(2 * order - j) * math.comb(order, j) / math.factorial(2 * order) for j in powers
        ]
        below = np.polynomial.polynomial.polyval(1j * phase, weights)
        if np.max(np.abs(np.conj(below) / below - np.exp(-1j * phase))) <= error:
            return order
    raise ConfigError(
        [
            Problem(
                "pade",
                f"no order up to {_HIGHEST_PADE_ORDER} has an error below {error:g} up to {up_to:g} rad/s "
                f"for a delay of {delay:g} s",
                "",
                "Allow a larger error or a lower frequency, or use the exact frequency response.",
            )
        ]
    )


def polynomial(*coefficients: ArrayLike) -> Array:
    """A polynomial from its coefficients in ascending powers, which may be arrays of one shape."""
    return np.stack(np.broadcast_arrays(*(np.asarray(one, np.float64) for one in coefficients)))


def product(factors: Sequence[Array]) -> Array:
    """The product of polynomials; 1 of none."""
    total = np.ones(1)
    for factor in factors:
        total = times(total, factor)
    return total
