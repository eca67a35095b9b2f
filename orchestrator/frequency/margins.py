"""Margins of a loop with delays, all crossovers considered; critical delays and their directions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, minimize_scalar

from .quasi import characteristic
from .roots import count_right_of
from .spans import at_rest, span
from .transfer import Array, Transfer

__all__ = ["CriticalDelay", "Crossover", "Margins", "critical_delays", "gain_crossovers", "margins"]

# Deepest dips on the grid that are followed down: a sharp one may be deeper than the deepest there.
_DIPS = 8

Response = Callable[[NDArray[np.complex128]], NDArray[np.complex128]]


@dataclass(frozen=True)
class Crossover:
    """Where |L| = 1.

    Attributes:
        omega: [rad/s].
        phase_margin: angle of L above -180 degrees, in (-180, 180] [deg].
        delay_margin: the smallest further delay, >= 0, that turns L to -1 [s].
        falling: whether |L| falls there: then roots move to the right with more delay, else to the left.
    """

    omega: float
    phase_margin: float
    delay_margin: float
    falling: bool


@dataclass(frozen=True)
class Margins:
    """Margins of a loop.

    Attributes:
        unstable: closed-loop roots with positive real part.
        crossovers: where |L| = 1, ascending.
        phase_crossovers: (omega [rad/s], factor by which the gain may grow there) where L is real and
            negative, omega = 0 among them.
        modulus_margin: least distance of L from -1, and where [rad/s].
        sensitivity_peak, complementary_peak: largest |1/(1 + L)| and |L/(1 + L)|.
        complementary_peak_at: [rad/s].
    """

    unstable: int
    crossovers: tuple[Crossover, ...]
    phase_crossovers: tuple[tuple[float, float], ...]
    modulus_margin: float
    modulus_margin_at: float
    complementary_peak: float
    complementary_peak_at: float

    @property
    def stable(self) -> bool:
        """Whether the closed loop is stable: margins below are distances from instability only then."""
        return self.unstable == 0

    @property
    def sensitivity_peak(self) -> float:
        """Largest |1/(1 + L)|."""
        return 1.0 / self.modulus_margin

    @property
    def phase_margin(self) -> float:
        """The smallest phase margin by absolute value, signed [deg]; infinite without crossover."""
        return min((one.phase_margin for one in self.crossovers), key=abs, default=np.inf)

    @property
    def delay_margin(self) -> float:
        """The further delay that a stable loop bears [s]; NaN if it is unstable, infinite if it bears any."""
        if not self.stable:
            return np.nan
        return min((one.delay_margin for one in self.crossovers), default=np.inf)

    @property
    def gain_margin(self) -> tuple[float, float]:
        """Factors by which the gain may fall and rise around one; 0 and infinity where nothing limits it."""
        factors = [factor for _, factor in self.phase_crossovers]
        return (
            max((one for one in factors if one < 1.0), default=0.0),
            min((one for one in factors if one > 1.0), default=np.inf),
        )


def margins(loop: Transfer) -> Margins:
    """All margins of a loop with negative feedback: of 1 + L(s).

    Raises: ConfigError if the loop is improper, algebraic or neutral; OrchestratorError if it stands exactly
        on the border.
    """
    equation = characteristic(loop)
    omega = span(loop)
    crossovers = tuple(
        Crossover(
            w,
            float(np.degrees(np.angle(-loop(1j * w)))),
            float(np.mod(np.angle(-loop(1j * w)), 2.0 * np.pi)) / w,
            falling,
        )
        for w, falling in gain_crossovers(loop, omega)
    )
    still = at_rest(loop)
    # Where L does not integrate, the locus begins on the real axis: its first crossing is at no frequency.
    real = [(0.0, -1.0 / still)] if -np.inf < still < 0.0 else []
    wide = _beyond(omega, loop.longest_delay)
    value = loop(1j * wide)
    # Where L is real but for rounding, as with a double integrator at low frequency, a change of sign says
    # nothing.
    sign = np.where(np.abs(value.imag) > 1e-9 * np.abs(value), np.sign(value.imag), 0.0)
    for index in np.flatnonzero(sign[:-1] * sign[1:] < 0.0):
        if value.real[index] < 0.0 and value.real[index + 1] < 0.0:
            w = brentq(lambda w: loop(1j * w).imag, wide[index], wide[index + 1], xtol=1e-300, rtol=1e-14)
            factor = float(-1.0 / loop(1j * w).real)
            # Far beyond the loop's bandwidth a long delay may turn L by more than a half between two points.
            if factor > 0.0:
                real.append((w, factor))
    least_at, least = _lowest(lambda w: np.abs(1.0 + loop(1j * w)), omega)
    peak_at, peak = _lowest(lambda w: -np.abs(loop(1j * w) / (1.0 + loop(1j * w))), omega)
    return Margins(count_right_of(equation), crossovers, tuple(real), least, least_at, -peak, peak_at)


def gain_crossovers(response: Response, omega: Array) -> list[tuple[float, bool]]:
    """Where |response(j w)| = 1 between the given frequencies, and whether it falls there.

    Pairs of crossovers closer than two neighbouring frequencies are found where the extremum between them
    shows.
    """

    def level(w: float | Array) -> Array:
        return np.log(np.maximum(np.abs(response(1j * np.asarray(w, np.float64))), 1e-300))

    values = level(omega)
    inner = np.arange(1, len(omega) - 1)
    # Not below only: halfway between two frequencies a peak has the same level at both.
    turning = inner[(values[inner] - values[inner - 1]) * (values[inner + 1] - values[inner]) <= 0.0]
    extra = []
    for index in turning:
        sign = 1.0 if values[index] > 0.0 else -1.0
        if (
            sign * values[index]
            > max(abs(values[index] - values[index - 1]), abs(values[index + 1] - values[index])) * 4
        ):
            continue
        found = minimize_scalar(
            lambda w, sign=sign: sign * float(level(w)),
            bounds=(omega[index - 1], omega[index + 1]),
            method="bounded",
            options={"xatol": 1e-12 * omega[index]},
        )
        extra.append(found.x)
    if extra:
        omega = np.sort(np.concatenate([omega, extra]))
        values = level(omega)
    crossings = []
    for index in np.flatnonzero((values[:-1] > 0.0) != (values[1:] > 0.0)):
        w = brentq(lambda w: float(level(w)), omega[index], omega[index + 1], xtol=1e-300, rtol=1e-14)
        crossings.append((float(w), bool(values[index] > values[index + 1])))
    return crossings


@dataclass(frozen=True)
class CriticalDelay:
    """A delay at which roots stand on the imaginary axis.

    Attributes:
        delay: [s].
        omega: of the roots [rad/s].
        to_right: whether they move to the right with growing delay.
        unstable_beyond: closed-loop roots with positive real part just above this delay.
    """

    delay: float
    omega: float
    to_right: bool
    unstable_beyond: int


def critical_delays(fixed: Transfer, delayed: Transfer, up_to: float) -> tuple[int, list[CriticalDelay]]:
    """All delays tau in (0, up_to] at which 1 + fixed(s) + delayed(s) exp(-tau s) has imaginary roots.

    Args:
        fixed: the part of the loop that does not pass the delay; Transfer() if all does.
        delayed: the part that does, without the delay itself.
        up_to: [s].
    Returns: unstable roots without the delay, and the critical delays in ascending order.
    """
    total = fixed + delayed
    begin = count_right_of(characteristic(total), 1e-9 * characteristic(total).reach(0.0))

    def ratio(s: NDArray[np.complex128]) -> NDArray[np.complex128]:
        return delayed(s) / (1.0 + fixed(s))

    found = []
    for w, falling in gain_crossovers(ratio, span(Transfer(fixed.terms + delayed.terms))):
        first = float(np.mod(np.angle(-ratio(np.asarray(1j * w))), 2.0 * np.pi)) / w
        count = int((up_to - first) * w / (2.0 * np.pi)) + 1 if first <= up_to else 0
        found += [(first + 2.0 * np.pi * turn / w, w, falling) for turn in range(count)]
    unstable, critical = begin, []
    for delay, w, falling in sorted(found):
        unstable += 2 if falling else -2
        critical.append(CriticalDelay(delay, w, falling, unstable))
    return begin, critical


def _beyond(omega: Array, delay: float) -> Array:
    """The frequencies, two more decades, and two more turns of the delay's phase."""
    turns = omega[-1] + np.linspace(0.0, 4.0 * np.pi / delay, 801) if delay else omega[-1:]
    return np.unique(np.concatenate([omega, np.geomspace(omega[-1], 100.0 * omega[-1], 3001), turns]))


def _lowest(function: Callable[[Array], Array], omega: Array) -> tuple[float, float]:
    """Where a function of the frequency is least, and its value; the deepest dips are followed down."""
    values = function(omega)
    padded = np.concatenate([[np.inf], values, [np.inf]])
    dips = np.flatnonzero((values <= padded[:-2]) & (values <= padded[2:]))
    best = int(np.argmin(values))
    least = float(omega[best]), float(values[best])
    for index in dips[np.argsort(values[dips], kind="stable")][:_DIPS]:
        low, high = omega[max(index - 1, 0)], omega[min(index + 1, len(omega) - 1)]
        found = minimize_scalar(
            lambda w: float(function(np.asarray(w))),
            bounds=(low, high),
            method="bounded",
            options={"xatol": 1e-12 * high},
        )
        if found.fun < least[1]:
            least = float(found.x), float(found.fun)
    return least
