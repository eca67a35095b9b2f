"""What an answer leaves unexplained."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from .study import Array

__all__ = ["hum", "unexplained", "wave"]

_BLOCKS = (1, 4, 16, 64, 256)
# Of encoders' scales and interpolators [m]: as fine as ways of a centimetre tell apart.
_PITCHES = 3e-4 * 1.01 ** np.arange(300)


def unexplained(channels: Sequence[Array]) -> float:
    """Log likelihood that slow or local structure of normalised residuals still holds [nats].

    Sums over blocks of a residual that is white noise have the variance of their length. Where their mean
    square is q times as large, a model that knew it would gain n (q - 1 - ln q)/2 over n blocks; the largest
    gain over block lengths is taken, channel by channel. Block length 1 tells a noise larger than specified,
    and only counts as far as it is more than half as large again.

    Args:
        channels: residuals over their noise.
    """
    total = 0.0
    for r in channels:
        gains = [0.0]
        for length in _BLOCKS:
            n = len(r) // length
            if n < 4:
                break
            sums = r[: n * length].reshape(n, length).sum(axis=1)
            q = float(np.mean(sums**2)) / length
            if not math.isfinite(q):
                return math.inf
            q /= 1.5 if length == 1 else 1.0
            if q > 1.0:
                gains.append(0.5 * n * (q - 1.0 - math.log(q)))
        total += max(gains)
    return total


def hum(r: Array, windows: Sequence[slice]) -> tuple[float, float]:
    """Find a narrow-band line common to windows of a residual.

    Returns: its log likelihood over none, number of tried frequencies accounted for [nats], and its
    frequency in cycles per sample.
    """
    parts = [r[window] - r[window].mean() for window in windows]
    size = sum(map(len, parts))
    if size < 64:
        return 0.0, 0.0
    length = 1 << (max(map(len, parts)) * 2 - 1).bit_length()
    power = sum(np.abs(np.fft.rfft(part, length)) ** 2 * (2.0 / len(part)) for part in parts)
    best = int(np.argmax(power[1:])) + 1
    energy = sum(float(part @ part) for part in parts)
    rest = max(energy - float(power[best]), 1e-12 * energy)
    # Amplitude and phase of the line are free in each window.
    price = math.log(len(power)) + sum(math.log(len(part)) for part in parts)
    return 0.5 * size * math.log(energy / rest) - price, best / length


def wave(channels: Sequence[Array], positions: Sequence[Array]) -> tuple[float, float, float]:
    """Find a wave along the position that residuals of several runs have in common, as of an encoder's scale.

    Args:
        channels: residuals over their noise, by run; positions: of the same samples [m].
    Returns: its log likelihood over none, number of tried pitches accounted for [nats], its pitch [m], and
        its amplitude in standard deviations of the noise.
    """
    r, x = np.concatenate(channels), np.concatenate(positions)
    best = (0.0, float(_PITCHES[0]), 0.0)
    for pitch in _PITCHES:
        turned = (2.0 * math.pi / pitch) * x
        basis = np.stack([np.cos(turned), np.sin(turned)])
        along = basis @ r
        amplitudes = np.linalg.lstsq(basis @ basis.T, along, rcond=None)[0]
        gain = 0.5 * float(along @ amplitudes)
        if gain > best[0]:
            best = gain, float(pitch), float(np.hypot(*amplitudes))
    return max(best[0] - math.log(len(_PITCHES)), 0.0), best[1], best[2]
