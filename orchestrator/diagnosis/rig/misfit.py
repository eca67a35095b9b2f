"""Measures of the residual that an answer leaves."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.stats import t as student

from .study import Array

_BLOCKS = (1, 4, 16, 64, 256)
# Of noise's square over what is specified; and the largest gain that noise has in a channel by chance [nats].
LOUDER, _CHANCE = 1.5, 1.0
# The same within contacts, which go on for some ticks in the sensor's filter; shorter ones say nothing.
_WITHIN, _AFTER, _SHORTEST = (1, 2, 4, 8, 16), 12, 8
# Samples out of contact that say how large a noise is.
_TELLING = 100
# Degrees of freedom of Student's distribution, rounds in which its scale is found, and blocks needed.
_FREEDOMS, _ROUNDS, _FEWEST = (1.0, 2.0, 4.0, 8.0), 20, 20
# Turns that a line which keeps its phase makes in a window at least.
_TURNS = 2.0
# Of encoders' scales and interpolators [m]: as fine as ways of a centimetre distinguish.
_PITCHES = 3e-4 * 1.01 ** np.arange(300)


def stretches(where: Array) -> list[slice]:
    """Intervals in which a condition holds, from its value at each tick, shape (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], np.asarray(where, int), [0]])))
    return [slice(a, b) for a, b in edges.reshape(-1, 2).tolist()]


def near_contact(touching: Array) -> Array:
    """Whether the sensor responds to a contact, including some ticks after it; shapes (n,)."""
    return np.convolve(touching, np.ones(_AFTER + 1))[: len(touching)] > 0.5


def variance_gain(n: int, q: float) -> float:
    """Log likelihood gain of a free variance; the mean square of n normal numbers is q, not 1 [nats]."""
    return 0.5 * n * (q - 1.0 - math.log(q)) if q > 1.0 else 0.0


def _sums(r: Array, length: int) -> Array:
    """Sums over complete blocks."""
    return r[: len(r) // length * length].reshape(-1, length).sum(axis=1)


def unexplained(channels: Sequence[Array]) -> float:
    """Log likelihood of slow or local structure in normalised residuals [nats].

    Sums over blocks of a residual that is white noise have the variance of their length. Where their mean
    square is q times as large, a model with this variance gains n (q - 1 - ln q)/2 over n blocks. The largest
    gain over block lengths is taken, channel by channel, minus its value by chance. Block length 1 detects
    noise that is larger than specified. It counts only beyond a factor 1.5, which longer blocks are allowed,
    too.

    Args:
        channels: residuals over their noise.
    """
    total = 0.0
    for r in channels:
        gains, noise = [0.0], LOUDER
        for length in _BLOCKS:
            sums = _sums(r, length)
            if len(sums) < 4:
                break
            q = float(np.mean(sums**2)) / length
            if not math.isfinite(q):
                return math.inf
            gains.append(variance_gain(len(sums), q / noise))
            if length == 1:
                noise = min(max(q, 1.0), LOUDER)
        total += max(max(gains) - _CHANCE, 0.0)
    return total


def noises_beside(channels: Sequence[Array], touching: Sequence[Array]) -> list[float]:
    """Deviation of residuals out of contact, by run; 1, as specified, if it is less.

    Args:
        channels: residuals over their noise, by run; touching: whether the rod touches at each tick.
    """
    return [
        _noise_beside(r, near_contact(touched)[: len(r)])
        for r, touched in zip(channels, touching, strict=True)
    ]


def _noise_beside(r: Array, within: Array) -> float:
    out = r[~within]
    return math.sqrt(max(float(np.mean(out**2)), 1.0)) if len(out) > _TELLING else 1.0


def in_contact(channels: Sequence[Array], touching: Sequence[Array]) -> float:
    """The same for contacts only, common to all channels, over the noise out of contact [nats].

    What a contact law lacks lasts for a few dozen ticks, and drowns in a run of thousands.

    Args:
        channels: residuals over their noise, by run; touching: whether the rod touches at each tick.
    """
    parts = []
    for r, touched in zip(channels, touching, strict=True):
        within = near_contact(touched)[: len(r)]
        if not np.isfinite(r).all():
            return math.inf
        noise = _noise_beside(r, within)
        parts += [part / noise for part in (r[one] for one in stretches(within)) if len(part) >= _SHORTEST]
    gains = [0.0]
    for length in _WITHIN:
        sums = [_sums(part, length) for part in parts]
        n = sum(map(len, sums))
        if n < 4:
            break
        gains.append(variance_gain(n, float(sum(one @ one for one in sums)) / (n * length)))
    return max(gains)


def uneven(channels: Sequence[Array], lengths: Sequence[int]) -> float:
    """Log likelihood that a noise is intermittent, unlike normal noise [nats].

    Its sums over blocks are normal whatever its colour. Where they have tails, Student's distribution makes
    them likelier (Lange, Little, Taylor, J. Am. Stat. Assoc. 84, 1989), its two parameters accounted for.

    Args:
        channels: the noise, by stretch.
        lengths: of blocks; the one with the largest gain is taken.
    """
    return max(_tails(channels, length) for length in lengths)


def _tails(channels: Sequence[Array], length: int) -> float:
    x = np.concatenate([np.zeros(0), *(_sums(r, length) for r in channels)])
    n = len(x)
    if n < _FEWEST or not np.isfinite(x).all() or not x.any():
        return 0.0
    normal = -0.5 * n * (math.log(2.0 * math.pi * float(np.mean(x**2))) + 1.0)
    best = -math.inf
    for freedom in _FREEDOMS:
        square = float(np.median(x**2)) or float(np.mean(x**2))
        for _ in range(_ROUNDS):
            square = float(np.mean(x**2 * (freedom + 1.0) / (freedom + x**2 / square)))
        best = max(best, float(np.sum(student.logpdf(x, freedom, scale=math.sqrt(square)))))
    return max(best - normal - math.log(n), 0.0)


def narrow_band_line(channels: Sequence[Array], windows: Sequence[Sequence[slice]]) -> tuple[float, float]:
    """Find a narrow-band line that residuals have in common, in windows of them.

    Its phase is free in each window, or in each channel, the weaker line of the two then: over that of a
    line which keeps its phase less is known.

    Args:
        channels: residuals, by run, zero where they say nothing; windows: of each.
    Returns: its log likelihood over none, number of tried frequencies accounted for [nats], and its
        frequency in cycles per sample.
    """
    by_run = []
    for r, some in zip(channels, windows, strict=True):
        inside = np.zeros(len(r))
        for window in some:
            nonzero = r[window] != 0.0
            inside[window] = nonzero * (r[window] - r[window].sum() / max(np.count_nonzero(nonzero), 1))
        by_run.append(inside)
    by_window = [r[window] for r, some in zip(by_run, windows, strict=True) for window in some]
    by_window = [one for one in by_window if one.any()]
    if not by_window:
        return 0.0, 0.0
    # What is slower than a window may be anything that goes from one to the next.
    slowest = _TURNS / float(np.median([len(one) for one in by_window]))
    runs, one_by_one = _line([one for one in by_run if one.any()], slowest), _line(by_window, 0.0)
    gain, frequency = max(runs, one_by_one)
    return gain - math.log(2.0), frequency


def _line(parts: Sequence[Array], slowest: float) -> tuple[float, float]:
    """The likeliest line, of any amplitude and phase in each part; see `narrow_band_line`."""
    sizes = [int(np.count_nonzero(part)) for part in parts]
    size = sum(sizes)
    if size < 64 or min(sizes) == 0:
        return 0.0, 0.0
    length = 1 << (max(map(len, parts)) * 2 - 1).bit_length()
    power = sum(
        np.abs(np.fft.rfft(part, length)) ** 2 * (2.0 / own) for part, own in zip(parts, sizes, strict=True)
    )
    first = max(1, math.ceil(slowest * length))
    best = int(np.argmax(power[first:])) + first
    energy = sum(float(part @ part) for part in parts)
    rest = max(energy - float(power[best]), 1e-12 * energy)
    price = math.log(len(power)) + sum(math.log(own) for own in sizes)
    return 0.5 * size * math.log(energy / rest) - price, best / length


def wave(
    channels: Sequence[Array], positions: Sequence[Array], longest: float = math.inf
) -> tuple[float, float, float]:
    """Find a wave along the position that residuals of several runs have in common, as of an encoder's scale.

    Args:
        channels: residuals over their noise, by run; positions: of the same samples [m].
        longest: pitch that is tried [m].
    Returns: its log likelihood over none, number of tried pitches accounted for [nats], its pitch [m], and
        its amplitude in standard deviations of the noise.
    """
    r, x = np.concatenate(channels), np.concatenate(positions)
    best = (0.0, float(_PITCHES[0]), 0.0)
    pitches = _PITCHES[longest >= _PITCHES]
    for pitch in pitches:
        turned = (2.0 * math.pi / pitch) * x
        basis = np.stack([np.cos(turned), np.sin(turned)])
        along = basis @ r
        amplitudes = np.linalg.lstsq(basis @ basis.T, along, rcond=None)[0]
        gain = 0.5 * float(along @ amplitudes)
        if gain > best[0]:
            best = gain, float(pitch), float(np.hypot(*amplitudes))
    return max(best[0] - math.log(max(len(pitches), 1)), 0.0), best[1], best[2]
