"""Repeated force samples: lost ones, and those repeated in contact or at an end of the range."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.optimize import minimize_scalar

from .study import Array

# Samples at the ends of a contact, where the force is not smooth.
_ENDS = 3
# Samples do not repeat by chance more seldom than that: the force is not quite as smooth as a line.
_SELDOM = 2e-3
# Samples so near an end of a run's range, in deviations of their noise, may be at the end by chance; and log
# least evidence that they are not [nats].
_NEAR, _PILED = 3.0, 10.0
# Variance of the distances of lost samples, or of those between, over what chance makes of it, below which
# they are regular; and how many samples before one may say whether it is lost.
_REGULAR, _BEFORE = 0.7, 4
# Fewer distances say nothing of that.
_FEWEST = 50


def held_longer(
    repeats: Sequence[Array], contact: Sequence[Array], windows: Sequence[Sequence[slice]]
) -> float:
    """Log evidence that samples repeat in contact more often than out of it [nats]."""
    inside = np.concatenate([again[touching] for again, touching in zip(repeats, contact, strict=True)])
    free = [again[window] for again, some in zip(repeats, windows, strict=True) for window in some]
    if not free or not inside.size:
        return 0.0
    outside = np.concatenate(free)
    a, n, b, m = inside.sum(), inside.size, outside.sum(), outside.size
    if a / n <= b / m:
        return 0.0

    def likelihood(k: float, of: float, p: float) -> float:
        p = min(max(p, 0.5 / of), 1.0 - 0.5 / of)
        return float(k * math.log(p) + (of - k) * math.log(1.0 - p))

    both = (a + b) / (n + m)
    apart = likelihood(a, n, a / n) + likelihood(b, m, b / m)
    return max(0.0, apart - likelihood(a, n, both) - likelihood(b, m, both) - 0.5 * math.log(n))


def piled(forces: Sequence[Array], step: float, noise: float) -> float:
    """Log evidence that samples pile up at an end of a run's range, as where the sensor is at its own [nats].

    Noise spreads those of a force that turns there: few of the nearest share the last step with the last one,
    whose own place is where the range ends.

    Args:
        forces: by run [N]; step, noise: resolution, below the noise, and its standard deviation [N].
    """
    chance, total = step / (noise * math.sqrt(2.0 * math.pi)), 0.0
    for force in forces:
        for values in (force, -force):
            last = float(values.max())
            n = int(np.sum(values > last - _NEAR * noise)) - 1
            share = min((int(np.sum(values > last - 0.5 * step)) - 1) / max(n, 1), 1.0 - 0.5 / max(n, 1))
            if share > chance:
                divergence = share * math.log(share / chance) + (1.0 - share) * math.log(
                    (1.0 - share) / (1.0 - chance)
                )
                total += max(n * divergence - 0.5 * math.log(n), 0.0)
    return total if total > _PILED else 0.0


def in_turn(parts: Sequence[Array]) -> float:
    """Log likelihood that samples are lost periodically, as by a sensor with its own cycle [nats].

    Chance loses each whatever became of those before it; bursts of losses are none of it, and no turn.

    Args:
        parts: whether samples repeat the last one, by flight, shape (n,) each.
    """
    if not parts or not any(_even(parts, lost) for lost in (True, False)):
        return 0.0
    most = 0.0
    for order in range(1, _BEFORE + 1):
        counts = np.zeros((2**order, 2))
        for part in parts:
            if len(part) > order:
                before = sum(part[at : len(part) - order + at].astype(int) << at for at in range(order))
                np.add.at(counts, (before, part[order:].astype(int)), 1.0)
        total, own = counts.sum(axis=0), counts.sum(axis=1, keepdims=True)
        share = np.divide(counts, own, out=np.ones_like(counts), where=counts > 0.0)
        gain = float((counts * np.log(share)).sum() - (total * np.log(total / total.sum())).sum())
        most = max(most, gain - 0.5 * len(counts) * math.log(total.sum()))
    return most


def _even(parts: Sequence[Array], lost: bool) -> bool:
    """Whether distances between lost samples, or between others, vary less than chance has them."""
    distances = np.concatenate([np.diff(np.flatnonzero(part == lost)) for part in parts])
    share = float(np.mean(np.concatenate(parts) == lost))
    if len(distances) < _FEWEST or not 0.0 < share < 1.0:
        return False
    return float(np.var(distances)) < _REGULAR * (1.0 - share) / share**2


def lost_in_flight(parts: Sequence[Array], step: float) -> tuple[float, float]:
    """Probability of a lost sample and its log evidence, from how often a sample repeats the last one.

    Steps of one and two resolutions say how often it would by chance: they are normally distributed.
    """
    counts = np.zeros(3)
    total = 0
    for part in parts:
        change = np.abs(np.round(np.diff(part) / step))
        counts += [np.sum(change == 0), 0.5 * np.sum(change == 1), 0.5 * np.sum(change == 2)]
        total += len(change)
    if counts[1] < 20 or counts[2] < 20:
        return 0.0, 0.0
    chance = counts[1] ** (4.0 / 3.0) / counts[2] ** (1.0 / 3.0)
    rest = total - counts[0]
    # Lost samples are not among the steps that say about chance.
    share = counts[0] / total
    expected = chance / (chance + rest)
    lost = (share - expected) / (1.0 - expected)
    error = math.sqrt(expected * (1.0 - expected) / total) + 0.1 * expected
    if lost <= 0.0:
        return 0.0, 0.0
    return float(lost), float(0.5 * (lost / error) ** 2 - math.log(total) / 2.0)


def lost_in_contact(
    forces: Sequence[Array], contact: Sequence[Array], step: float, noise: float
) -> tuple[float, float]:
    """Probability of a lost sample and its log evidence, from samples that repeat while the force moves.

    The probability of a repetition by chance follows from the slope of the force. The slope is taken from two
    neighbours that a loss would not change: those except the last sample.

    Args:
        forces: by run [N]; contact: whether a replay touches, per tick, by run.
        step, noise: resolution and standard deviation of the force [N].
    """
    again, chances = [], []
    for force, touching in zip(forces, contact, strict=True):
        inside = np.convolve(~touching, np.ones(2 * _ENDS + 1), "same") < 0.5
        at = np.flatnonzero(inside[2:-1]) + 2
        slope = (force[at + 1] - force[at - 2]) / 3.0
        # Of a difference of two samples, and of a third of that of two others.
        spread = noise * math.sqrt(2.0 + 2.0 / 9.0)
        density = np.exp(-0.5 * (slope / spread) ** 2) / (spread * math.sqrt(2.0 * math.pi))
        again.append(force[at] == force[at - 1])
        chances.append(np.clip(step * density, _SELDOM, 0.5))
    repeated, chance = np.concatenate(again), np.concatenate(chances)
    if len(repeated) < 100:
        return 0.0, 0.0

    def gain(lost: float) -> float:
        over = np.log(lost / chance[repeated] + 1.0 - lost)
        return float(over.sum() + np.sum(~repeated) * math.log1p(-lost))

    best = minimize_scalar(lambda lost: -gain(lost), bounds=(1e-6, 0.9), method="bounded")
    return float(best.x), max(-float(best.fun) - 0.5 * math.log(len(repeated)), 0.0)
