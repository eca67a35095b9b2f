"""Detect commands that are late periodically: the encoder residual then has a period."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.ndimage import median_filter
from scipy.special import logsumexp

from .study import Array

# Periods that are looked for [ticks]: what deviates more slowly has other causes, and rounding of the encoder
# makes something of nearly two ticks on every rig.
_SHORTEST, _LONGEST = 2.25, 50.0
# Bins of the spectrum about each, whose median says what deviates there without a period.
_ABOUT = 129
# Power of a line over that of noise, all about as likely beforehand.
_POWERS = 2.0 ** np.arange(10)
# Log evidence that may be chance [nats].
_CHANCE = 5.0


def rhythm(channels: Sequence[Array], positions: Sequence[Array]) -> float:
    """Log evidence of a period in the encoder's residuals, in proportion to the robot's speed [nats].

    A command that is late periodically moves the robot in proportion to its speed. The period is common to
    all runs, the phase is fitted for each run. The background is the spectrum about the period. Little
    evidence counts as none.

    Args:
        channels: residuals over their noise, by run; positions: of the robot, of the same samples.
    """
    size = 1 << max(len(r) for r in channels).bit_length()
    bins = slice(math.ceil(size / _LONGEST), math.floor(size / _SHORTEST))
    gains = np.zeros((bins.stop - bins.start, len(_POWERS)))
    for r, x in zip(channels, positions, strict=True):
        speed = np.abs(np.gradient(x))
        if not np.isfinite(r).all() or not speed.max() > 0.0:
            continue
        power = np.abs(np.fft.rfft(speed * r, size)) ** 2
        # The median of an exponential distribution is ln 2 of its mean.
        about = median_filter(power, _ABOUT, mode="nearest") / math.log(2.0)
        gains += (power / about)[bins, None] * _POWERS / (1.0 + _POWERS) - np.log1p(_POWERS)
    evidence = float(logsumexp(gains)) - math.log(gains.size)
    return evidence if evidence > _CHANCE else 0.0
