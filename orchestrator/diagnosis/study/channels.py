"""Clipped and frozen channels of logs, outliers; duplicate logs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.errors import Problem
from .study import Array

# A value that stands still for so many rows, while the channel moves elsewhere, is frozen; number of places
# reported.
_FROZEN, _STRETCHES = 60, 3
# So many rows in succession at the highest or lowest value, and so many times as many as just below it.
_PILED, _PILE = 8, 4

# Rows on each side that an outlier is held against, how many of both sides may be outliers too, and the
# largest share of outliers. One lies so many times the noise away from the others, which differ by a share of
# that. So do nine of ten rows of so many on each side: tips of an oscillation do not lie alone.
_SIDE, _OTHERS, _FEW, _FAR, _BACK, _WIDE, _TIPS = 5, 4, 0.05, 10.0, 0.35, 25, 0.1

# Rows that a signal that is held rests between most jumps, and share of its range that jumps take.
_RESTS, _JUMP = 3, 0.1

_CLIPPED = "Raise the range of the channel; if this is the sensor's own, the verdict counts it as an effect."
_STOPPED = "The channel stopped; leave the run out, or log it again."


class Stuck(NamedTuple):
    """A problem of a channel, and its longest interval: first row, and the row after the last."""

    what: str
    remedy: str
    first: int
    end: int


def clipped(values: Array) -> list[Stuck]:
    """Values that accumulate at an end of the range of the sensor or the logger."""
    found = []
    firsts, lengths = _runs(values)
    levels, counts = np.unique(values, return_counts=True)
    for end, near in ((0, slice(1, 4)), (len(levels) - 1, slice(-4, -1))):
        at = (values[firsts] == levels[end]) & ~_left_by_jump(values, firsts, lengths)
        longest = int(lengths[at].max(initial=0))
        if longest >= _PILED and counts[end] > _PILE * counts[near].max(initial=1):
            row = int(firsts[at][lengths[at] >= _PILED][0])
            name = "lowest" if end == 0 else "highest"
            what = f"row {row} ({values[row]:.9g}): clipped: {counts[end]} rows stand at exactly this value, "
            first = int(firsts[at][np.argmax(lengths[at])])
            found.append(Stuck(f"{what}the {name}", _CLIPPED, first, first + longest))
    return found


def frozen(values: Array) -> list[Stuck]:
    """Intervals in which the channel is constant much longer than elsewhere."""
    firsts, lengths = _runs(values)
    order = np.argsort(lengths)[::-1]
    ends, left = (values.min(), values.max()), _left_by_jump(values, firsts, lengths)
    clipped_values = {values[one.first] for one in clipped(values)}
    found = []
    for number, place in enumerate(order[:_STRETCHES].tolist()):
        row, length, others = (
            int(firsts[place]),
            int(lengths[place]),
            lengths[order[number + 1 : number + 11]],
        )
        at_end = values[row] in clipped_values or (values[row] in ends and not left[place])
        if length >= _FROZEN and length > 5 * np.median(others) and not at_end:
            what = f"row {row} ({values[row]:.9g}): frozen for {length} rows"
            found.append(Stuck(what, _STOPPED, row, row + length))
    return found


def is_stairs(values: Array) -> bool:
    """Whether a channel jumps and rests in between; a coarse one goes up and down by small steps."""
    firsts, lengths = _runs(values)
    jumps = np.abs(np.diff(values[firsts]))
    large = len(jumps) > 0 and float(np.median(jumps)) > _JUMP * float(np.ptp(values))
    return large and float(np.quantile(lengths, 0.2)) >= _RESTS


def outliers(values: Array, noise: float) -> NDArray[np.bool_]:
    """Rows that jump away from the rows around them and back at once, as no machine does, shape (n,).

    Args:
        noise: standard deviation.
    """
    found = np.zeros(len(values), np.bool_)
    if len(values) <= 2 * (_SIDE + _WIDE):
        return found
    rows = np.lib.stride_tricks.sliding_window_view(values, 2 * _SIDE + 1)
    around = np.delete(rows, _SIDE, axis=1)
    sides = np.median(around.reshape(-1, 2, _SIDE), axis=2)
    away = np.maximum(rows[:, _SIDE] - sides.max(1), sides.min(1) - rows[:, _SIDE])
    distance = np.abs(around - np.median(around, axis=1)[:, None])
    spread = np.ptp(sides, axis=1) + np.sort(distance, axis=1)[:, -_OTHERS - 1]
    wide = np.lib.stride_tricks.sliding_window_view(np.pad(away, _WIDE, mode="reflect"), 2 * _WIDE + 1)
    alone = np.quantile(wide, 0.9, axis=1) < _TIPS * away
    found[_SIDE:-_SIDE] = (away > _FAR * noise) & (spread < _BACK * away) & alone
    # More of them are the signal's own, as of a machine that knocks.
    return found if np.mean(found) <= _FEW else np.zeros_like(found)


def _runs(values: Array) -> tuple[Array, Array]:
    """First row and length of each stretch of equal values."""
    firsts = np.flatnonzero(np.concatenate([[True], np.diff(values) != 0.0]))
    return firsts, np.diff(np.concatenate([firsts, [len(values)]]))


def _left_by_jump(values: Array, firsts: Array, lengths: Array) -> Array:
    """Whether the first value after each stretch is far away, as it is when a channel comes back to life."""
    ends = firsts + lengths
    after = values[np.minimum(ends, len(values) - 1)]
    return np.abs(after - values[firsts]) > 10.0 * np.median(np.abs(np.diff(values)))


def logged_twice(runs: Sequence[tuple[str, Mapping[Any, Array]]], place: str) -> Iterator[Problem]:
    """Runs with the same log; a held-out run would not be independent of the fit.

    Args:
        runs: by name, their channels, each of shape (n,).
        place: of the runs.
    """
    for (one, channels), (other, others) in combinations(runs, 2):
        same = channels.keys() == others.keys()
        if same and all(np.array_equal(values, others[name]) for name, values in channels.items()):
            what = f"{one} and {other} hold the same log, to the last digit"
            remedy = "Leave one out, or name the file that was meant."
            yield Problem(place, what, "each run once", remedy)
