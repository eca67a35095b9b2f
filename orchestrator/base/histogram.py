"""Times counted in classes of equal ratio: memory does not grow with their number."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

# From 100 ns to 1000 s; a class is 2.3 % wide.
_LOWEST, _PER_DECADE, _DECADES = 2.0, 100, 10


class Histogram:
    """Counts of times, which are given in whole nanoseconds."""

    def __init__(self) -> None:
        self.counts = np.zeros(_PER_DECADE * _DECADES, np.int64)
        self.largest = 0
        self._total = 0

    def add(self, nanoseconds: int) -> None:
        """Count a time; what is negative counts as zero."""
        place = int((math.log10(nanoseconds) - _LOWEST) * _PER_DECADE) if nanoseconds > 100 else 0
        self.counts[min(place, len(self.counts) - 1)] += 1
        self.largest = max(self.largest, nanoseconds)
        self._total += 1

    def quantile(self, share: float) -> float:
        """The time [s] that a share of all stays below, to 2.3 %; 0 for those below 0.1 us, and of none."""
        if not self._total:
            return 0.0
        place = int(np.searchsorted(np.cumsum(self.counts), max(share * self._total, 1.0)))
        above = 10.0 ** (_LOWEST + (place + 1) / _PER_DECADE) * 1e-9
        return 0.0 if place == 0 else min(above, self.largest * 1e-9)

    def summary(self) -> dict[str, Any]:
        """Number, median, 99 %, 99.9 % and largest [s]."""
        return {
            "count": self._total,
            "median": self.quantile(0.5),
            "p99": self.quantile(0.99),
            "p999": self.quantile(0.999),
            "max": self.largest * 1e-9,
        }

    def classes(self) -> dict[str, list[float] | list[int]]:
        """Edges of ten classes per decade [s], and counts, from the first class that holds any."""
        coarse = self.counts.reshape(-1, 10).sum(axis=1)
        held = np.flatnonzero(coarse)
        if not held.size:
            return {"edges": [], "counts": []}
        first, end = int(held[0]), int(held[-1]) + 1
        edges = 10.0 ** (_LOWEST + np.arange(first, end + 1) / 10.0) * 1e-9
        return {"edges": edges.tolist(), "counts": coarse[first:end].tolist()}
