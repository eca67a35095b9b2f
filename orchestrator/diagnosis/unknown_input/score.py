"""Score laws by their effect on the simulation, one simulation a law.

The calibrated model's residual is regressed on what a law changes in the outputs, beside what parameters and
start states change (a score test). Laws and pairs of laws that explain much of the residual are worth a fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from .law_fit import Candidate, readable, starts_of
from .model import Inserted, Kinds, Place
from .places import Runs
from .polish import Replays

__all__ = ["SAMPLES", "Scores", "scored"]

Array = NDArray[np.float64]
# Samples of a run that are looked at, and share of the signal at the place that a law's amplitude tries.
SAMPLES, _SMALL = 1500, 1e-3
# Share of the residual below which a law is not tried again.
_FAINT = 0.05
# Laws whose effects agree this well are one for the logs.
_SAME = 0.9999


@dataclass(frozen=True)
class Scores:
    """Laws by the share of the residual that each explains.

    Attributes:
        candidates: best first; their `share` is of the residual's power. twins: laws that act the same on
            these logs, of each. changes: what they change in the residual, of length 1, shape (laws, values).
        left: the residual beside parameters and start states.
    """

    candidates: list[Candidate]
    twins: list[list[Candidate]]
    changes: Array
    left: Array

    def pairs(self, most: int) -> list[tuple[Candidate, Candidate]]:
        """Pairs of laws that together explain most, best first; their amplitudes are those of the pair."""
        found = []
        inner = self.changes @ self.changes.T
        along = self.changes @ self.left
        for i, j in combinations(range(len(self.candidates)), 2):
            c = float(inner[i, j])
            if abs(c) > 0.98:
                continue
            a, b = along[i], along[j]
            first, second = (a - c * b) / (1.0 - c * c), (b - c * a) / (1.0 - c * c)
            gain = float(a * first + b * second)
            pair = [
                replace(one, numbers=(one.numbers[0] * part / whole, *one.numbers[1:]))
                if one.law.linear and whole else one
                for one, part, whole in ((self.candidates[i], first, a), (self.candidates[j], second, b))
            ]  # fmt: skip
            found.append((gain, i, j, pair))
        found.sort(key=lambda one: -one[0])
        return [(pair[0], pair[1]) for *_, pair in found[:most]]


def scored(
    runs: Runs, places: Sequence[Place], laws: Sequence[Inserted], constants: Array, starts: Sequence[Array],
    most: int = 40, late: bool = False,
) -> Scores:  # fmt: skip
    """The laws that explain most of what is left, best first.

    Args:
        laws: inserted already. constants: parameters, then their numbers, as fitted. starts: of each run.
        late: the laws that are tried late, and not the others.
    """
    replays = Replays(runs, laws, SAMPLES, starts)
    residual, own = replays.residual(constants), replays.sensitivity(constants)
    free = _basis(own)
    # Parameters and start states explain what they can within their tolerances, as in a fit.
    weight, prior, away = replays.bounds(residual, constants)
    basis = _basis(np.vstack([weight * own, prior]))
    left = np.r_[weight * residual, away]
    left -= basis @ (basis.T @ left)
    whole = float(left @ left)
    found: list[tuple[Candidate, Array]] = []
    for place in places:
        for one in readable(runs.model, place, late):
            law = one.law
            with_law = Replays(runs, [*laws, one.inserted], SAMPLES, starts)
            best: tuple[Candidate, Array] | None = None
            for start in starts_of(one, runs):
                numbers = np.array(start)
                if law.linear:
                    read = list(one.inserted.signals)
                    typical = law.typical(
                        0.5 * (runs.low + runs.high)[read], runs.spread[read], numbers,
                        runs.model.study.interval, runs.length,
                    )  # fmt: skip
                    if not typical > 0.0:
                        continue
                    numbers[0] *= _SMALL * runs.spread_at(place) / typical
                # A law that is tried late is tried again with the amplitude that this gives.
                for _ in range(1 + late):
                    change = with_law.residual(np.concatenate([constants, numbers])) - residual
                    before, beside = float(change @ change), change - free @ (free.T @ change)
                    # What parameters and start states change as well is no other law.
                    if not np.isfinite(before) or float(beside @ beside) <= 1e-6 * before:
                        break
                    change = np.r_[weight * change, np.zeros(len(away))]
                    change -= basis @ (basis.T @ change)
                    power = float(change @ change)
                    if power <= 1e-20 * whole:
                        break
                    factor = -float(change @ left) / power
                    if not law.linear and not 0.1 < factor < 10.0:
                        break
                    share = float(change @ left) ** 2 / power / whole
                    if law.linear:
                        numbers[0] *= factor
                    if best is None or share > best[0].share:
                        candidate = replace(one, numbers=tuple(numbers.tolist()), share=share)
                        best = candidate, -change / np.sqrt(power)
                    if not law.linear or share < _FAINT:
                        break
            if best is not None:
                found.append(best)
    found.sort(key=lambda each: each[0].share, reverse=True)
    kept: list[tuple[Candidate, Array]] = []
    twins: list[list[Candidate]] = []
    for each in found:
        same = next((k for k, two in enumerate(kept) if abs(float(each[1] @ two[1])) > _SAME), None)
        if same is not None and _rather(each[0], kept[same][0]):
            twins[same].append(kept[same][0])
            kept[same] = each
        elif same is not None:
            twins[same].append(each[0])
        elif len(kept) < most:
            kept.append(each)
            twins.append([])
    changes = np.array([one[1] for one in kept]).reshape(len(kept), len(left))
    return Scores([one[0] for one in kept], twins, changes, left)


def _basis(columns: Array) -> Array:
    """Orthonormal columns that span the same."""
    size = np.linalg.norm(columns, axis=0)
    return np.linalg.qr(columns[:, size > 0.0] / size[size > 0.0])[0]


def _rather(one: Candidate, other: Candidate) -> bool:
    """Whether a law that acts the same is likelier, or its place names it better.

    An input comes before an output, both before a derivative.
    """
    if one.law is not other.law:
        return one.law.odds > other.law.odds
    order = (Kinds.INPUT, Kinds.OUTPUT, Kinds.RATE)
    near = one.place.component == other.place.component
    return near and order.index(one.place.kind) < order.index(other.place.kind)
