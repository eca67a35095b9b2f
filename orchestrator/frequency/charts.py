"""Stability charts over any two parameters, for all points at once.

A loop with one delay is judged exactly (Walton, Marshall, IEE Proc. D 134, 1987): the roots without delay
are counted
by Routh's scheme, and each crossing of the imaginary axis, of which |a(jw)|^2 = |b(jw)|^2 tells frequency and
direction, adds or takes away a pair. A loop with several delays is judged by the argument principle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.errors import ConfigError, Problem
from .loop import Loop
from .quasi import QuasiPolynomial
from .roots import count_right_of, counts_right_of, newton_batch
from .transfer import Array

__all__ = ["Chart", "chart", "first_order_damping", "unstable_roots"]

Count = NDArray[np.int64]


@dataclass(frozen=True)
class Chart:
    """Stability over two parameters.

    Attributes:
        loop: with numbers for all parameters: the operating point.
        x_name, y_name: parameters; x, y: their values, shapes (nx,), (ny,), SI.
        unstable: number of roots with positive real part, shape (ny, nx).
        growth: exp(pi sigma/omega) of the contact's root, shape (ny, nx); NaN where it does not oscillate.
        rule: c - k (tau + 2 xi_n/omega_n), the first-order rule, positive where it expects stability, shape
            (ny, nx) [N.s/m]; None with an active controller.
    """

    loop: Loop
    x_name: str
    y_name: str
    x: Array
    y: Array
    unstable: Count
    growth: Array
    rule: Array | None

    @property
    def stable(self) -> NDArray[np.bool_]:
        """Where no root has a positive real part, shape (ny, nx)."""
        return self.unstable == 0


def chart(loop: Loop, x: tuple[str, ArrayLike], y: tuple[str, ArrayLike]) -> Chart:
    """Judge a loop at every pair of values.

    Args:
        loop: gives all other parameters.
        x, y: parameter, as "robot.tau_m", and its values, SI.
    Raises: ConfigError if a parameter does not exist, is out of range or is the other one.
    """
    (x_name, across), (y_name, up) = x, y
    across, up = np.asarray(across, np.float64), np.asarray(up, np.float64)
    if x_name == y_name:
        raise ConfigError(
            [Problem(loop.name, f"both axes are {x_name}", "two different parameters are needed")]
        )
    grid = loop.with_parameters(dict(zip((x_name, y_name), np.meshgrid(across, up), strict=True)))
    equation = grid.characteristic()
    unstable = unstable_roots(equation)
    growth = _growth(grid, equation, unstable)
    return Chart(loop, x_name, y_name, across, up, unstable, growth, first_order_damping(grid))


def first_order_damping(loop: Loop) -> Array | None:
    """C - k (tau_m + 2 xi_n/omega_n + the sensor's delay and lag) [N.s/m]; None with a controller."""
    if loop.named("ComplianceController"):
        return None
    robot, contact = (loop.parameters_of(loop.only(model)) for model in ("RobotResponse", "DockingContact"))
    late = np.asarray(robot["tau_m"] + 2.0 * np.asarray(robot["xi_n"]) / robot["omega_n"])
    for name in loop.named("ForceSensor"):
        sensor = loop.parameters_of(name)
        cutoff = np.asarray(sensor["cutoff"], np.float64)
        late = (
            late
            + sensor["tau_s"]
            + np.where(cutoff > 0, 1 / (2 * np.pi * np.where(cutoff > 0, cutoff, 1)), 0)
        )
    return np.asarray(contact["damping"] - contact["stiffness"] * late)


def unstable_roots(equation: QuasiPolynomial) -> Count:
    """Number of roots with positive real part of each quasi-polynomial of a batch, shape (*batch)."""
    batch = equation.coefficients.shape[2:]
    flat = QuasiPolynomial(
        equation.coefficients.reshape(*equation.coefficients.shape[:2], -1),
        equation.delays.reshape(len(equation.delays), -1),
    )
    rows = len(flat.delays)
    counts = np.full(flat.delays.shape[1], -1)
    # A batch may hold loops of lower order, such as one without a low-pass; they are judged one by one.
    full = flat.coefficients[0, -1] != 0.0
    if rows <= 2 and full.any():
        whole = flat.pick(full)
        counts[full] = _routh(whole.coefficients[0]) if rows == 1 else _one_delay(whole)
    elif full.any():
        counts[full] = counts_right_of(flat.pick(full))
    for index in np.flatnonzero(counts < 0):
        counts[index] = count_right_of(flat.pick(index))
    return counts.reshape(batch)


def _routh(a: Array) -> Count:
    """Sign changes in Routh's first column, shape (n,); -1 where the scheme is singular.

    Args: a: ascending coefficients, shape (degree + 1, n), the leading ones not zero.
    """
    scaled = a / a[-1]
    high, low = scaled[::-1][0::2].copy(), scaled[::-1][1::2].copy()
    changes = np.zeros(a.shape[1], np.int64)
    singular = np.zeros(a.shape[1], np.bool_)
    previous = high[0]
    with np.errstate(all="ignore"):
        for _ in range(len(a) - 1):
            first = low[0]
            singular |= ~np.isfinite(first) | (first == 0.0)
            changes += (first > 0.0) != (previous > 0.0)
            padded = np.zeros_like(high)
            padded[: len(low)] = low
            following = high[1:] - high[0] / first * padded[1:]
            high, low, previous = low, following, first
            if not len(low):
                break
    return np.where(singular, -1, changes)


def _one_delay(equation: QuasiPolynomial) -> Count:
    """Counts for a(s) + b(s) exp(-tau s); -1 where the delay-free case is singular."""
    a, b = equation.coefficients
    tau = equation.delays[1]
    counts = _routh(a + b)
    singular = counts < 0
    gap = _square(a) - _square(b)
    for x, rising in _positive_roots(gap):
        with np.errstate(all="ignore"):
            w = np.sqrt(x)
            ratio = _at(b, w) / _at(a, w)
            first = np.mod(np.angle(-ratio), 2.0 * np.pi) / w
            passed = np.where(tau > first, np.floor((tau - first) * w / (2.0 * np.pi)) + 1.0, 0.0)
            pairs = np.where(np.isfinite(passed), passed, 0.0).astype(np.int64)
        # |b/a| falls where |a|^2 - |b|^2 rises: there roots cross to the right with growing delay.
        counts = counts + np.where(rising, 2, -2) * pairs
    return np.where(singular, -1, counts)


def _at(polynomial: Array, w: Array) -> NDArray[np.complex128]:
    value = np.zeros(w.shape, np.complex128)
    for coefficient in polynomial[::-1]:
        value = value * (1j * w) + coefficient
    return value


def _square(a: Array) -> Array:
    """|a(j w)|^2 as a polynomial in x = w^2, ascending."""
    even, odd = a[0::2].copy(), a[1::2].copy()
    even[1::2] *= -1.0
    odd[1::2] *= -1.0
    total = np.zeros_like(a)
    for one, shift in ((even, 0), (odd, 1)):
        for i, p in enumerate(one):
            for j, q in enumerate(one):
                if i + j + shift < len(total):
                    total[i + j + shift] += p * q
    return total


def _positive_roots(polynomial: Array) -> list[tuple[Array, NDArray[np.bool_]]]:
    """Positive real roots of each column and whether the polynomial rises there; NaN where there is none.

    Where Descartes' rule leaves exactly one, safeguarded Newton finds it for all columns at once; the others'
    roots are eigenvalues of companion matrices.
    """
    degree, count = len(polynomial) - 1, polynomial.shape[1]
    monic = polynomial / polynomial[-1]
    magnitude = np.abs(monic[:-1])
    scale = (
        np.max((degree * magnitude) ** (1.0 / (degree - np.arange(degree)))[:, None], axis=0)
        if degree
        else None
    )
    if scale is None:
        return []
    scaled = monic * scale ** (np.arange(degree + 1)[:, None] - degree)
    signs = np.sign(np.where(np.abs(scaled) < 1e-300, 0.0, scaled))
    changes, last = np.zeros(count, np.int64), np.ones(count)
    for row in signs[::-1]:
        changes += (row != 0.0) & (row != last)
        last = np.where(row != 0.0, row, last)
    single = changes == 1
    result: list[tuple[Array, NDArray[np.bool_]]] = []
    if single.any():
        root = np.full(count, np.nan)
        root[single] = _bracketed(scaled[:, single]) * scale[single]
        result.append((root, np.ones(count, np.bool_)))
    several = np.flatnonzero(changes > 1)
    if several.size:
        companion = np.zeros((several.size, degree, degree))
        companion[:, np.arange(1, degree), np.arange(degree - 1)] = 1.0
        companion[:, :, -1] = -scaled[:-1, several].T
        values = np.linalg.eigvals(companion)
        good = (values.real > 0.0) & (np.abs(values.imag) < 1e-9 * np.abs(values))
        ordered = np.sort(np.where(good, values.real, np.inf), axis=1)[:, ::-1]
        found = np.isfinite(ordered)
        # The largest root is passed rising, the next falling, and so on.
        rising = np.cumsum(found, axis=1) % 2 == 1
        for column in range(degree):
            root = np.full(count, np.nan)
            root[several] = np.where(found[:, column], ordered[:, column], np.nan) * scale[several]
            upward = np.zeros(count, np.bool_)
            upward[several] = rising[:, column]
            result.append((root, upward))
    return result


def _bracketed(polynomial: Array) -> Array:
    """The only root in (0, 1], by Newton's method with bisection where it leaves the bracket."""
    low, high = np.zeros(polynomial.shape[1]), np.full(polynomial.shape[1], 1.0)
    x = 0.5 * (low + high)
    for _ in range(200):
        value, slope = np.zeros_like(x), np.zeros_like(x)
        for coefficient in polynomial[::-1]:
            slope = slope * x + value
            value = value * x + coefficient
        high, low = np.where(value > 0.0, x, high), np.where(value > 0.0, low, x)
        with np.errstate(all="ignore"):
            next_x = x - value / slope
        # Roots may be many decades below one: halving in the logarithm gets there.
        middle = np.where(low > 0.0, np.sqrt(low * high), 1e-3 * high)
        next_x = np.where((next_x > low) & (next_x < high), next_x, middle)
        done = np.abs(next_x - x) <= 1e-15 * x
        x = next_x
        if done.all():
            break
    return x


def _growth(loop: Loop, equation: QuasiPolynomial, unstable: Count) -> Array:
    """Growth per contact of the root that begins, without delay and lag, at the contact's own."""
    contact, satellite = (loop.parameters_of(loop.only(m)) for m in ("DockingContact", "SatelliteDynamics"))
    mass, decay = np.asarray(satellite["mass"]), 0.5 * np.asarray(contact["damping"]) / satellite["mass"]
    square = contact["stiffness"] / mass - np.square(decay)
    start = np.broadcast_to(
        np.where(square > 0.0, -decay + 1j * np.sqrt(np.abs(square)), np.nan), unstable.shape
    )
    root = newton_batch(equation, start, 8)
    # What disagrees with the count has gone to another root: once more, with the delays growing step by step.
    wrong = ~np.isfinite(root) | ((root.real > 0.0) & (unstable == 0)) | (root.imag <= 0.0)
    if wrong.any() and not wrong.all():
        followed = start
        for part in np.linspace(0.1, 1.0, 10):
            followed = newton_batch(
                QuasiPolynomial(equation.coefficients, equation.delays * part), followed, 6
            )
        root = np.where(wrong, followed, root)
    with np.errstate(all="ignore"):
        growth = np.exp(np.pi * root.real / root.imag)
        return np.where((root.imag > 0.0) & ~((root.real > 0.0) & (unstable == 0)), growth, np.nan)
