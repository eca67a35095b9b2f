"""Clipped and frozen channels of logs; duplicate logs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from ...base.errors import Problem
from .study import Array

__all__ = ["Stuck", "clipped", "frozen", "logged_twice"]

# A value that stands still for so many rows, while the channel moves elsewhere, is frozen; number of places
# reported.
_FROZEN, _STRETCHES = 60, 3
# So many rows in succession at the highest or lowest value, and so many times as many as just below it.
_PILED, _PILE = 8, 4

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
