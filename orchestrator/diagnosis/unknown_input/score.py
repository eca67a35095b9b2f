"""Score laws by their effect on the simulation.

The calibrated model's residual is regressed on what a law changes in the outputs, beside what parameters and
start states change (a score test). Laws and pairs of laws that explain much of the residual are worth a fit.
A law in proportion to its amplitude is predicted from the derivatives along the runs, where these are known.
Others take a simulation each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ...base.parallel import in_parallel
from .evaluation import Inserted, Kinds, Place
from .law_fit import Candidate, readable, starts_of
from .places import Runs
from .polish import WORST, Replays
from .response import Responses

Array = NDArray[np.float64]
# Samples of a run that are looked at, and share of the signal at the place that a law's amplitude tries.
SAMPLES, _SMALL = 1500, 1e-3
# Share of the residual below which a law is not tried again.
_FAINT = 0.05
# Of a law that is not in proportion to its amplitude: begins that are simulated, and the predicted share of
# the residual from which on they are.
_STARTS, _UNSEEN = 3, 0.005
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

    def joined(self, other: Scores) -> Scores:
        """With scores of other laws from the same begin."""
        changes = np.vstack([self.changes, other.changes])
        return Scores([*self.candidates, *other.candidates], [*self.twins, *other.twins], changes, self.left)

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
    small = Responses(runs, laws, constants, starts, SAMPLES, places) if runs.model.filters else None
    followed = np.abs(residual) < WORST

    def promising(one: Candidate) -> list[Array]:
        """Numbers where a law is tried: of many, those that are predicted to leave least."""
        starts = [np.array(start) for start in starts_of(one, runs)]
        if small is None or one.law.linear:
            return starts
        found = []
        for numbers in starts:
            change = np.r_[weight * np.where(followed, small.of(one, numbers), 0.0), np.zeros(len(away))]
            change -= basis @ (basis.T @ change)
            along, power = float(change @ left), float(change @ change)
            if along**2 > _UNSEEN * whole * power:
                found.append((2.0 * along + power, numbers))
        return [numbers for _, numbers in sorted(found, key=lambda each: each[0])[:_STARTS]]

    def changed(place: Place, candidates: Sequence[Candidate]) -> list[tuple[Candidate, Array]]:
        """Laws at a place that change the residual, and what they change."""
        found = []
        for one in candidates:
            law = one.law
            with_law = Replays(runs, [*laws, one.inserted], SAMPLES, starts)
            best: tuple[Candidate, Array] | None = None
            most_gained = -np.inf
            for numbers in promising(one):
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
                for again in range(1 + late):
                    if small is not None and law.linear and not again:
                        change = np.where(followed, small.of(one, numbers), 0.0)
                    else:
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
                    # Where the first number is no factor, a fit begins where it is nearest, in small steps.
                    gained = share if law.linear else -(2.0 * float(change @ left) + power) / whole
                    if best is None or gained > most_gained:
                        candidate = replace(one, numbers=tuple(numbers.tolist()), share=share)
                        best, most_gained = (candidate, -change / np.sqrt(power)), gained
                    if not law.linear or share < _FAINT:
                        break
            if best is not None:
                found.append(best)
        return found

    # Laws are compiled here, so that no copy of the process has to.
    tasks = [partial(changed, place, readable(runs.model, place, late)) for place in places]
    found = [each for made in in_parallel(tasks) for each in made]
    order = {id(each): k for k, each in enumerate(found)}
    found.sort(key=lambda each: each[0].share, reverse=True)
    groups: list[list[tuple[Candidate, Array]]] = []
    for each in found:
        same = next((one for one in groups if abs(float(each[1] @ one[0][1])) > _SAME), None)
        if same is not None:
            same.append(each)
        elif len(groups) < most:
            groups.append([each])
    for group in groups:  # by places, since shares of laws that act the same differ by rounding
        group.sort(key=lambda each: order[id(each)])
    logged = {str(port) for port in (*runs.model.fed, *runs.model.compared)}
    kept = [_likeliest(one, logged) for one in groups]
    changes = np.array([one[1] for one in kept]).reshape(len(kept), len(left))
    twins = [
        [two for two, _ in group if two is not one] for (one, _), group in zip(kept, groups, strict=True)
    ]
    return Scores([one for one, _ in kept], twins, changes, left)


def _likeliest(group: Sequence[tuple[Candidate, Array]], logged: set[str]) -> tuple[Candidate, Array]:
    """Of laws that act the same the likeliest, where its place names it best.

    Laws of actuators and sensors act on commands and measured signals, which are logged, rather than between
    components. An input comes before an output, both before a derivative.
    """
    odds = odds_of([one for one, _ in group])
    name = max(odds, key=lambda one: odds[one])
    alike = [each for each in group if each[0].law.name == name]
    first = max(alike, key=lambda each: each[0].odds)[0]
    if first.law.kinds and first.law.reads == "own":
        first = next((one for one, _ in alike if one.place.name in logged), first)
    order = (Kinds.INPUT, Kinds.OUTPUT, Kinds.RATE)
    near = [each for each in alike if each[0].place.component == first.place.component]
    return min(near, key=lambda each: (-each[0].odds, order.index(each[0].place.kind)))


def odds_of(alike: Sequence[Candidate]) -> dict[str, float]:
    """How likely laws that act the same are, by name; each counts once at a component."""
    best: dict[tuple[str, int], float] = {}
    for one in alike:
        here = one.law.name, one.place.component
        best[here] = max(best.get(here, 0.0), one.odds)
    odds = {name: 0.0 for name, _ in best}
    for (name, _), most in best.items():
        odds[name] += most
    return odds


def _basis(columns: Array) -> Array:
    """Orthonormal columns that span the same."""
    size = np.linalg.norm(columns, axis=0)
    return np.linalg.qr(columns[:, size > 0.0] / size[size > 0.0])[0]
