"""Search for a value that runs tell only when one is very near it: a resolution, a sampling period."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

__all__ = ["Comb"]

# How many of the best values are looked at more closely, how often after the whole run was, and at how many
# points at most; and what they must save of the sum of squares for that.
_KEPT, _CLOSER, _POINTS, _WORTH = 3, 6, 100, 10.0
# Of resolutions so many are kept at first, and half as many each time; and by how many times as many are
# looked at where signals have few values.
_FEW_VALUES, _DENSER = 16, 3
# Values farther apart than so many times the comb's width have nothing in common; those that say what chance
# makes are smaller or larger than the one found by this factor at most; and points to count values by.
_ALIEN, _AS_LARGE, _FINE = 4.0, 2.0, 400


@dataclass(frozen=True)
class Comb:
    """Where to look for a value.

    Attributes:
        coarse: values to begin with, falling or rising.
        width: of a value and a time [s]: how far apart values may be for none between them to be missed by
            runs that long.
        reach: by what factor the right value may be larger than the best coarse one; above 1 where coarse
            ones are too far apart to meet it, and only tell whereabouts it is.
        chance: whether values far apart do nothing alike, so that one of many may imitate by chance what it
            has nothing to do with. Periods are not so: any about as long delays a signal as much. Then
            `width` is the same at all times.
    """

    coarse: tuple[float, ...]
    width: Callable[[float, float], float]
    reach: float = 1.0
    chance: bool = False

    def tried(self, value: float) -> float:
        """Among how many values apart one was sought: from the coarsest to the finest, or to it if finer."""
        return float(self._counted(min(value, *self.coarse), max(value, *self.coarse))[1][-1])

    def unrelated(self, value: float, count: int) -> list[float]:
        """Values about as large as one that have nothing in common with it, evenly among all there are.

        Args:
            count: how many at most; fewer where there are no more.
        """
        values, counted = self._counted(value / _AS_LARGE, value * _AS_LARGE)
        own = float(np.interp(value, values, counted))
        places = counted[-1] * (np.arange(count) + 0.5) / count
        found: list[float] = np.interp(places, counted, values)[np.abs(places - own) > _ALIEN].tolist()
        return found

    def _counted(self, low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
        """Values from one to another, and how many apart there are up to each."""
        values = np.geomspace(low, high, _FINE)
        density = 1.0 / np.array([self.width(value, math.inf) for value in values.tolist()])
        parts = 0.5 * (density[1:] + density[:-1]) * np.diff(values)
        return values, np.concatenate([[0.0], np.cumsum(parts)])

    def best(
        self, cost: Callable[[float, int], float], ends: Sequence[tuple[int, float]], share: float = 0.0
    ) -> list[float]:
        """The values of least cost, least first; none where no coarse one does better than zero.

        Values are tried on the begin of a run, and those that do best closer and closer on more of it: the
        longer a run is, the less a value may be astray for its samples to fall where they should.

        Args:
            cost: of a value, by so many samples of a run; of zero: without it.
            ends: numbers of samples and the times that they take [s], rising. Of resolutions all of a run
                alone, where only that has many values.
            share: of the cost of zero, that a coarse value must save to be looked at more closely.
        """
        values = np.array(self.coarse)
        if self.chance and len(ends) == 1:
            # Of a signal of few values one that falls on the wrong step costs as much as a wrong resolution.
            values = 1.0 / np.linspace(1.0 / values[0], 1.0 / values[-1], _DENSER * len(values))
        gap = np.abs(np.gradient(values)) if len(values) > 1 else values / 2.0
        samples, time = ends[0]
        costs = [cost(value, samples) for value in values.tolist()]
        nothing = cost(0.0, samples)
        if not min(costs) < nothing - max(_WORTH, share * nothing):
            return []
        kept = _FEW_VALUES if self.chance else _KEPT
        best = _least(values, gap, costs, kept)
        if self.reach > 1.0:
            value, apart = best[0]
            near = [value - apart]
            while near[-1] < self.reach * value + apart:
                near.append(near[-1] + self.width(near[-1], time))
            values = np.array(near)
            best = _least(values, np.gradient(values), [cost(value, samples) for value in near], kept)
        for samples, time in [*ends, *ends[-1:] * _CLOSER]:
            near, gaps = [], []
            for value, apart in best:
                step = min(self.width(value, time), 0.5 * apart)
                count = min(max(math.ceil(apart / step), 2), _POINTS // 2)
                near += (value + apart * np.arange(-count, count + 1) / count).tolist()
                gaps += [apart / count] * (2 * count + 1)
            inside = [place for place, value in enumerate(near) if value > 0.0]
            values, gap = np.array(near)[inside], np.array(gaps)[inside]
            kept = max(kept // 2, _KEPT)
            best = _least(values, gap, [cost(value, samples) for value in values.tolist()], kept)
        return [value for value, _ in best]


def _least(
    values: np.ndarray, gap: np.ndarray, costs: Sequence[float], kept: int
) -> list[tuple[float, float]]:
    """So many values of least cost, no two of them neighbours, each with the gap to its neighbours."""
    found: list[tuple[float, float]] = []
    for place in np.argsort(costs, kind="stable").tolist():
        if all(abs(values[place] - value) > apart for value, apart in found) and len(found) < kept:
            found.append((float(values[place]), float(gap[place])))
    return found
