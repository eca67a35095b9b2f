"""Structure of residuals within a few ticks, or repeated at each contact."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from .misfit import noises_beside, stretches, variance_gain
from .study import Array

_WINDOWS = (2, 4, 8, 16, 32, 64, 128, 256)
# Ticks of a contact that are looked at, before and after it begins, or before and after it ends; and the
# shortest contact, and how many of them, that count.
_BEGINS, _ENDS, _SHORTEST, _FEWEST = (8, 24), (20, 12), 4, 4


def loudest(channels: Sequence[Array]) -> float:
    """Log likelihood that residuals are larger in one window than in their complete run [nats].

    The mean square of all samples hides what happens once. The number of windows is accounted for, those of a
    length by how many lie apart at half steps.

    Args:
        channels: residuals over their noise, by run.
    """
    found = 0.0
    for length in _WINDOWS:
        apart = 2 * sum(max(len(r) // length, 1) for r in channels)
        for r in channels:
            if len(r) < 2 * length or not np.isfinite(r).all():
                continue
            noise = max(float(np.mean(r**2)), 1.0)
            sums = np.concatenate([[0.0], np.cumsum(r**2)])
            most = float(np.max(sums[length:] - sums[:-length])) / (length * noise)
            found = max(found, variance_gain(length, most) - math.log(apart * len(_WINDOWS)))
    return found


def repeated(channels: Sequence[Array], touching: Sequence[Array]) -> float:
    """Log likelihood that contacts have the same residual, tick by tick from their start, or end [nats].

    Over the noise out of contact. Either their mean is larger than that of noise, or their first singular
    vector is: it may have another size and sign in each.

    Args:
        channels: residuals over their noise, by run; touching: whether the rod touches at each tick, by run.
    """
    found = 0.0
    noises = noises_beside(channels, touching)
    for (before, after), end in ((_BEGINS, False), (_ENDS, True)):
        parts = []
        for r, touched, noise in zip(channels, touching, noises, strict=True):
            for one in stretches(touched[: len(r)]):
                at = one.stop if end else one.start
                if one.stop - one.start >= _SHORTEST and before <= at <= len(r) - after:
                    parts.append(r[at - before : at + after] / noise)
        if len(parts) < _FEWEST or not np.isfinite(parts).all():
            continue
        together = np.array(parts)
        count, ticks = together.shape
        mean = together.sum(axis=0) / math.sqrt(count)
        first = float(np.linalg.norm(together, 2)) ** 2
        # The largest singular value of noise is about the sum of the roots of the sides.
        usual = (math.sqrt(count) + math.sqrt(ticks)) ** 2
        found = max(found, variance_gain(ticks, float(np.mean(mean**2))), 0.5 * (first - usual))
    return found
