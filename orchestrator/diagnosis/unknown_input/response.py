"""Predict what a small law changes in the compared signals, without a simulation of its own.

A law that is small enough changes nothing that it reads. What it adds at its place then follows from the
signals of the run without it, and what that changes from the derivatives along this run.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...base.compiled_functions import njit
from .calls import call_law
from .evaluation import Inserted, Place
from .law_fit import Candidate
from .open_run import Tangent, tangent
from .places import Runs

Array = NDArray[np.float64]


@njit()
def _values(address, signals, ends, interval, parts, numbers, states, settled):
    """What a law adds at each sample, and just before it; its states take steps of RK4."""
    count, width = signals.shape
    begin, end = np.zeros(count), np.zeros(count)
    s, z, base, out, k = np.zeros(3), np.zeros(max(1, states)), np.zeros(max(1, states)), np.zeros(8), 0
    slopes = np.zeros((4, max(1, states)))
    s[2] = interval
    for j in settled:
        z[j] = signals[0, 0]
    a, b, c, d = s.ctypes.data, numbers.ctypes.data, z.ctypes.data, out.ctypes.data
    for k in range(count):
        for part in range(parts if k > 0 and states > 0 else 0):
            base[:] = z
            for i in range(4):
                at = (part + (0.0, 0.5, 0.5, 1.0)[i]) / parts
                for j in range(width):
                    s[j] = signals[k - 1, j] + (ends[k, j] - signals[k - 1, j]) * at
                if i > 0:
                    for j in range(states):
                        z[j] = base[j] + interval / parts * (0.0, 0.5, 0.5, 1.0)[i] * slopes[i - 1, j]
                call_law(address, (k - 1 + at) * interval, a, b, c, d)
                for j in range(states):
                    slopes[i, j] = out[1 + j]
            for j in range(states):
                step = slopes[0, j] + 2.0 * slopes[1, j] + 2.0 * slopes[2, j] + slopes[3, j]
                z[j] = base[j] + interval / parts / 6.0 * step
        s[:width] = ends[k]
        call_law(address, k * interval, a, b, c, d)
        end[k] = out[0]
        s[:width] = signals[k]
        call_law(address, k * interval, a, b, c, d)
        begin[k] = out[0]
    return begin, end


@njit()
def _driven(onward, first, last, rates, direct, seen, begin, end):
    """What inputs at one place change in the compared signals, shape (samples, compared)."""
    count, m = rates.shape
    found = np.zeros(direct.shape)
    x, moved = np.zeros(m), np.zeros(m)
    for k in range(count):
        if k > 0:
            for i in range(m):
                moved[i] = 0.0
                for j in range(m):
                    moved[i] += onward[k, i, j] * x[j]
                    moved[i] += first[k, i, j] * rates[k - 1, j] * begin[k - 1]
                    moved[i] += last[k, i, j] * rates[k, j] * end[k]
            x[:] = moved
        for i in range(direct.shape[1]):
            found[k, i] = direct[k, i] * begin[k]
            for j in range(m):
                found[k, i] += seen[k, i, j] * x[j]
    return found


class Responses:
    """Runs with laws as fitted, and what small laws more would change in them.

    Args:
        places: where they act. samples: of each run, from its begin.
    """

    def __init__(
        self, runs: Runs, laws: Sequence[Inserted], constants: Array, starts: Sequence[Array], samples: int,
        places: Sequence[Place],
    ) -> None:  # fmt: skip
        self.runs, self.model, self.places = runs, runs.model, list(places)
        self.settled = runs.model.study.settled
        numbers = np.abs(constants[len(self.model.nominal) :])
        sizes = np.concatenate([
            runs.scale[: len(self.model.states)], runs.hidden_scale(laws),
            np.maximum(self.model.tolerance, 1e-12), np.where(numbers > 0.0, numbers, 1e-9),
        ])  # fmt: skip
        inputs = [(place, runs.spread_at(place)) for place in places]
        self.along: list[tuple[Tangent, Array]] = []
        for index, ((ext, held, logged, _), start) in enumerate(zip(runs.data, starts, strict=True)):
            z = np.concatenate([start, runs.hidden(index, laws, start, constants), constants])
            made = tangent(
                self.model, ext[: self.settled + samples], held, z, sizes, runs.sub_of(laws), list(laws),
                inputs,
            )  # fmt: skip
            self.along.append((made, ~np.isnan(logged[self.settled : self.settled + samples])))

    def of(self, one: Candidate, numbers: Array) -> Array:
        """What a law changes in the residuals of all runs, one after the other, shape (compared values,)."""
        at, put = self.places.index(one.place), one.inserted
        read, settled = np.array(put.signals), np.array(put.settled, np.int64)
        found = []
        for made, mask in self.along:
            begin, end = _values(
                put.address, np.ascontiguousarray(made.signals[:, read]),
                np.ascontiguousarray(made.ends[:, read]), self.model.study.interval, 4 * self.runs.sub,
                numbers, put.states, settled,
            )  # fmt: skip
            change = _driven(
                made.onward, made.first, made.last, made.rates[:, at], made.direct[:, at], made.seen,
                begin, end,
            )  # fmt: skip
            found.append((change / self.model.noise)[self.settled :][mask])
        return np.concatenate(found)
