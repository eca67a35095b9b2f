"""Noise in residuals, told from what has a form: no effect explains noise, however large it is."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.ndimage import binary_dilation, median_filter

from ..study import Array
from ..verdict import Warned

__all__ = ["structured", "understated", "white"]

# Residuals are noise where white noise makes this share of their mean square at least: what comes back
# through a loop is not quite white. It is worth a word from so much on.
_MOSTLY, _WORTH = 0.5, 1.5
# A line in a spectrum stands out of the frequencies about it by so much, and they are so many on each side; a
# lightly damped mode that noise drives is lower, or wider.
_STANDS_OUT, _ABOUT = 200.0, 32


def white(r: Array) -> float:
    """Variance of the white noise in a residual, by its second differences: what is smooth has next to none.

    Args:
        r: shape (n,), n at least 3.
    Returns: at most the mean square of r.
    """
    return min(float(np.mean(np.diff(r, 2) ** 2)) / 6.0, float(np.mean(r**2)))


def structured(r: Array) -> float:
    """Mean square of a normalised residual beyond noise, as specified or larger; not below zero.

    A log's noise is rarely known well, and noise of a sensor comes back through the loop. That makes no line:
    what a periodic disturbance leaves counts in full.

    Args:
        r: shape (n,).
    """
    return max(float(np.mean(r**2)) - max(white(r) / _MOSTLY, 1.0), lines(r), 0.0)


def lines(r: Array) -> float:
    """Mean square of the lines in a residual's spectrum.

    Args:
        r: shape (n,).
    """
    n = len(r)
    if n <= 4 * _ABOUT or not np.isfinite(r).all():
        return 0.0
    # Windowed, or a line between two frequencies of the transform would leak into all.
    window = np.hanning(n)
    power = np.abs(np.fft.rfft(window * (r - np.mean(r)))) ** 2 / float(window @ window)
    # The median of an exponential distribution is ln 2 of its mean.
    about = median_filter(power, 2 * _ABOUT + 1, mode="nearest") / math.log(2.0)
    stands = power > _STANDS_OUT * np.maximum(about, np.finfo(float).tiny)
    # What turns so few times in a run is a trend, not a line.
    stands[:_ABOUT] = False
    return 2.0 * float(np.sum((power - about)[binary_dilation(stands, iterations=2)])) / n


def understated(residuals: Mapping[str, Sequence[Array]]) -> list[Warned]:
    """Ports whose logs are noisier than specified, for the reader.

    Args:
        residuals: normalised, of the answer, by port.
    """
    found = []
    for port, parts in residuals.items():
        square = float(np.mean(np.concatenate([r**2 for r in parts])))
        noise = float(np.mean([white(r) for r in parts]))
        if noise > _WORTH and noise > _MOSTLY * square:
            what = f"what the answer leaves is noise, {noise**0.5:.2g} times that specified"
            remedy = "State the noise of the log; that of signals fed back through the loop counts to it."
            found.append(Warned(place=port, what=what, remedy=remedy))
    return found
