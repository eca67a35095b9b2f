"""Margins of a loop with delays, all crossovers considered."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..base.arrays import Array, Complex
from .refine import minima, zeros

# Frequencies over the highest of a grid where only the direct feedthrough of a response remains.
FAR = 1e4 * np.linspace(1.0, 2.0, 64)
# Eigenvalues of one absolute value, as of a loop that is cut twice, cross together.
_TOGETHER = 1e-6
Response = Callable[[Complex], Complex]


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
        feedthrough: |L| far above all crossovers; from 1 on no delay is borne, however small.
    """

    unstable: int
    crossovers: tuple[Crossover, ...]
    phase_crossovers: tuple[tuple[float, float], ...]
    modulus_margin: float
    modulus_margin_at: float
    complementary_peak: float
    complementary_peak_at: float
    feedthrough: float = 0.0

    @property
    def stable(self) -> bool:
        """Whether the closed loop is stable: margins below are distances from instability only then."""
        return self.unstable == 0

    @property
    def sensitivity_peak(self) -> float:
        """Largest |1/(1 + L)|."""
        return 1.0 / self.modulus_margin if self.modulus_margin else np.inf

    @property
    def phase_margin(self) -> float:
        """The smallest phase margin by absolute value, signed [deg]; infinite without crossover."""
        return min((one.phase_margin for one in self.crossovers), key=abs, default=np.inf)

    @property
    def delay_margin(self) -> float:
        """The further delay that a stable loop bears [s]; NaN if it is unstable, infinite if it bears any."""
        if not self.stable:
            return np.nan
        if self.feedthrough >= 1.0:
            return 0.0
        return min((one.delay_margin for one in self.crossovers), default=np.inf)

    @property
    def gain_margin(self) -> tuple[float, float]:
        """Factors by which the gain may fall and rise around one; 0 and infinity where nothing limits it."""
        factors = [factor for _, factor in self.phase_crossovers]
        return (
            max((one for one in factors if one < 1.0), default=0.0),
            min((one for one in factors if one > 1.0), default=np.inf),
        )

    def __repr__(self) -> str:
        low, high = self.gain_margin
        return (
            f"{'stable' if self.stable else 'unstable'}, phase margin {self.phase_margin:.4g} deg, "
            f"delay margin {self.delay_margin:.4g} s, gain times {low:.4g} to {high:.4g}, "
            f"modulus margin {self.modulus_margin:.4g}"
        )


@dataclass(frozen=True)
class DelayMargin:
    """By how much connections may be later, all by the same delay, before the system is unstable.

    Attributes:
        connections: that are later.
        delay: of each of them [s]; NaN if the system is unstable, infinite if it bears any.
        omega: what oscillates there [rad/s]; NaN if nothing does.
    """

    connections: tuple[str, ...]
    delay: float
    omega: float


# Neighbouring levels, as logarithms, that differ by less are the same.
_FLAT = 1e-9


def borne_delay(response: Response, omega: Array) -> tuple[float, float]:
    """The least delay h > 0 with a root of det(1 + exp(-j w h) L(j w)) = 0, and its w; infinite, NaN without.

    An eigenvalue of L has absolute value 1 there, and h = arg(-eigenvalue)/w.

    Args:
        response: L(s) at s of shape (k,), shape (k, loops, loops).
        omega: frequencies that show all of it, shape (n,) [rad/s].
    """

    def eigenvalues(s: Complex) -> Complex:
        found = np.linalg.eigvals(response(s))
        return np.take_along_axis(found, np.argsort(-abs(found), axis=1), 1)

    if np.max(abs(eigenvalues(1j * omega[-1] * FAR))) >= 1.0:
        return 0.0, np.inf
    whole = eigenvalues(1j * omega)
    best = np.inf, np.nan
    # Ordered by their absolute values, eigenvalues are continuous in these.
    for place, known in enumerate(whole.T):

        def one(s: Complex, place: int = place) -> Complex:
            return eigenvalues(s)[:, place]

        crossings = gain_crossovers(one, omega, known)
        for w, _ in crossings:
            at = eigenvalues(np.array([1j * w]))[0]
            turns = np.mod(np.angle(-at[abs(abs(at) - 1.0) < _TOGETHER]), 2.0 * np.pi)
            best = min([best, *((float(turn) / w, w) for turn in turns)])
        if not crossings:  # those that follow are smaller
            break
    return best


def gain_crossovers(
    response: Response, omega: Array, known: Complex | None = None
) -> list[tuple[float, bool]]:
    """Where |response(j w)| = 1 between the given frequencies, and whether it falls there.

    Pairs of crossovers closer than two neighbouring frequencies are found where the extremum between them
    shows.

    Args:
        known: the response at these frequencies; asked for if it is not given.
    """

    def size(values: Complex) -> Array:
        return np.log(np.maximum(np.abs(values), 1e-300))

    def level(w: Array) -> Array:
        return size(response(1j * np.asarray(w, np.float64)))

    values = level(omega) if known is None else size(known)
    inner = np.arange(1, len(omega) - 1)
    # Not below only: halfway between two frequencies a peak has the same level at both.
    turning = inner[(values[inner] - values[inner - 1]) * (values[inner + 1] - values[inner]) <= 0.0]
    beside = np.maximum(
        abs(values[turning] - values[turning - 1]), abs(values[turning + 1] - values[turning])
    )
    # Where the level is that of 1 but for rounding, nothing turns.
    turning = turning[(abs(values[turning]) <= 4.0 * beside) & (beside > _FLAT)]
    if turning.size:
        sign = np.where(values[turning] > 0.0, 1.0, -1.0)

        def turned(w: Array) -> Array:
            return np.resize(sign, len(w)) * level(w)

        peaks = minima(turned, omega[turning - 1], omega[turning + 1])[0]
        omega, values = np.concatenate([omega, peaks]), np.concatenate([values, level(peaks)])
        order = np.argsort(omega)
        omega, values = omega[order], values[order]
    index = np.flatnonzero((values[:-1] > 0.0) != (values[1:] > 0.0))
    found = zeros(level, omega[index], omega[index + 1])
    falling = values[index] > values[index + 1]
    return list(zip(found.tolist(), falling.tolist(), strict=True))
