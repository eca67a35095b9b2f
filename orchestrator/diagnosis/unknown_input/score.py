"""Score laws by their effect on the simulation.

The calibrated model's residual is regressed on what a law changes in the outputs, beside what parameters and
start states change (a score test). Laws and pairs of laws that explain much of the residual are worth a fit.
A law in proportion to its amplitude is predicted from the derivatives along the runs, where these are known.
Others take simulations: where nothing is predicted, of one run, and of all if the law explains some of that.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations, pairwise

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
# the residual above which they are.
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


class _Left:
    """Residuals beside parameters and start states, and what a law explains of them.

    These explain what they can within their tolerances, as in a fit.
    """

    def __init__(self, weight: float, residual: Array, own: Array, prior: Array, away: Array) -> None:
        self.weight, self.more = weight, np.zeros(len(away))
        self.basis = _basis(np.vstack([weight * own, prior]))
        self.left = self._beside(np.r_[weight * residual, away])
        self.whole = float(self.left @ self.left)

    def change(self, changed: Array) -> Array:
        """What a law changes, by what it changes in the residuals."""
        return self._beside(np.r_[self.weight * changed, self.more])

    def shown(self, change: Array, least: float = _UNSEEN) -> bool:
        """Whether a change explains more than a share of these residuals, by default nearly none."""
        return float(change @ self.left) ** 2 > least * self.whole * float(change @ change)

    def _beside(self, values: Array) -> Array:
        return values - self.basis @ (self.basis.T @ values)


class _Begin(_Left):
    """Residuals at fitted numbers, of all runs and of one, by default the one with the largest.

    Attributes:
        small: predicted responses to laws in proportion to their amplitude; None if nothing is predicted.
    """

    def __init__(
        self, runs: Runs, laws: Sequence[Inserted], places: Sequence[Place], constants: Array,
        starts: Sequence[Array], worst: int | None = None,
    ) -> None:  # fmt: skip
        self.runs, self.laws, self.constants = runs, laws, constants
        self.replays = replays = Replays(runs, laws, SAMPLES, starts)
        self.residual = replays.residual(constants)
        own = replays.sensitivity(constants)
        self.free = _basis(own)
        weight, prior, away = replays.bounds(self.residual, constants)
        self._columns, self._away = np.vstack([weight * own, prior]), away
        super().__init__(weight, self.residual, own, prior, away)
        self.followed = np.abs(self.residual) < WORST
        ends = np.cumsum([0, *(int(mask.sum()) for mask in replays.masks)])
        powers = [float((self.left[i:j] ** 2).sum()) for i, j in pairwise(ends)]
        self.worst = int(np.argmax(powers)) if worst is None else worst
        self.part = slice(ends[self.worst], ends[self.worst + 1])
        self.there = _Left(weight, self.residual[self.part], own[self.part], prior, away)
        self.small = (
            Responses(runs, laws, constants, replays.starts, SAMPLES, places) if runs.model.filters else None
        )

    def promising(self, one: Candidate) -> list[Array]:
        """Numbers where a law is tried: of many, those that are predicted to leave least."""
        starts = [np.array(start) for start in starts_of(one, self.runs)]
        if self.small is None or one.law.linear:
            return starts
        found = []
        for numbers in starts:
            change = self.change(self._predicted(self.small, one, numbers))
            if self.shown(change):
                found.append((float(change @ (2.0 * self.left + change)), numbers))
        return [numbers for _, numbers in sorted(found, key=lambda each: each[0])[:_STARTS]]

    def best_of(
        self, one: Candidate, rare: bool, simulated: Callable[[Array, _Begin], Array | None]
    ) -> tuple[Candidate, Array] | None:
        """A law with the numbers that explain most, and what it changes; None if it explains nothing.

        Args:
            simulated: what a law with numbers changes in the residuals; None if too little.
        """
        best, most = None, -np.inf
        for numbers in self.promising(one):
            if one.law.linear:
                typical = self._typical(one, numbers)
                if not typical > 0.0:
                    continue
                numbers[0] *= _SMALL * self.runs.spread_at(one.place) / typical
            # A rare law is tried again with the amplitude that this gives.
            for again in range(1 + rare):
                if self.small is not None and one.law.linear and not again:
                    made: Array | None = self._predicted(self.small, one, numbers)
                else:
                    made = simulated(numbers, self)
                if made is None:
                    break
                beside = self._beside_parameters(made)
                if beside is None:
                    break
                change = beside
                power = float(change @ change)
                if power <= 1e-20 * self.whole:
                    break
                factor = -float(change @ self.left) / power
                if not one.law.linear and not 0.1 < factor < 10.0:
                    break
                share = float(change @ self.left) ** 2 / power / self.whole
                if one.law.linear:
                    numbers[0] *= factor
                # Where the first number is no factor, a fit begins where it is nearest, in small steps.
                gained = share if one.law.linear else -(2.0 * float(change @ self.left) + power) / self.whole
                if best is None or gained > most:
                    beside_it = self._suited(made * factor if one.law.linear else made)
                    candidate = replace(one, numbers=tuple(numbers.tolist()), share=share, beside=beside_it)
                    best, most = (candidate, -change / np.sqrt(power)), gained
                if not one.law.linear or share < _FAINT:
                    break
        return best

    def _suited(self, change: Array) -> tuple[Array, list[Array]]:
        """Constants and start states that suit a law, by what it changes in the residuals."""
        left = np.r_[self.weight * (self.residual + change), self._away]
        moved = -np.linalg.lstsq(self._columns, left, rcond=None)[0]
        count, scale, begun = len(self.constants), self.replays.scale, self.replays.starts
        parts = moved[count:].reshape(len(begun), len(scale))
        starts = [own + part * scale for own, part in zip(begun, parts, strict=True)]
        return self.constants + moved[:count] * self.replays.sizes(self.constants), starts

    def _predicted(self, small: Responses, one: Candidate, numbers: Array) -> Array:
        return np.where(self.followed, small.of(one, numbers), 0.0)

    def _typical(self, one: Candidate, numbers: Array) -> float:
        runs, read = self.runs, list(one.inserted.signals)
        middles = 0.5 * (runs.low + runs.high)[read]
        return one.law.typical(middles, runs.spread[read], numbers, runs.model.study.interval, runs.length)

    def _beside_parameters(self, change: Array) -> Array | None:
        """A law's change beside what parameters and start states change; None if these change it as well."""
        before, beside = float(change @ change), change - self.free @ (self.free.T @ change)
        if not np.isfinite(before) or float(beside @ beside) <= 1e-6 * before:
            return None
        return self.change(change)


class _Simulations:
    """Simulations of one law from several begins.

    Where the master simulates the system, every law takes simulations. So the worst run comes first, alone,
    and the first begin decides whether a law is worth simulations at another one.
    """

    def __init__(self, begins: Sequence[_Begin], one: Candidate) -> None:
        self._begins = begins
        self._with_law = {
            id(each): Replays(each.runs, [*each.laws, one.inserted], SAMPLES, each.replays.starts)
            for each in begins
        }
        self._known: dict[tuple[float, ...], Array] = {}

    def __call__(self, numbers: Array, at: _Begin) -> Array | None:
        """What the law changes in the residuals at a begin; None if it is not worth a simulation there."""
        first = self._begins[0]
        if at.runs.model.filters:
            return self._everywhere(numbers, at)
        key = tuple(numbers.tolist())
        if key not in self._known:
            constants = np.concatenate([first.constants, numbers])
            start = first.replays.starts[first.worst]
            run = self._with_law[id(first)].left(first.worst, start, constants)
            self._known[key] = run - first.residual[first.part]
        if len(self._known[key]) < len(first.residual):
            if not any(begin.there.shown(begin.there.change(self._known[key])) for begin in self._begins):
                return None
            self._known[key] = self._everywhere(numbers, first)
        other = at is not first and at.shown(at.change(self._known[key]), _FAINT)
        return self._everywhere(numbers, at) if other else self._known[key]

    def _everywhere(self, numbers: Array, at: _Begin) -> Array:
        constants = np.concatenate([at.constants, numbers])
        return self._with_law[id(at)].residual(constants) - at.residual


def scored(
    runs: Runs, places: Sequence[Place], laws: Sequence[Inserted],
    begins: Sequence[tuple[Array, Sequence[Array]]], most: int = 40, rare: bool = False,
) -> list[Scores]:  # fmt: skip
    """The laws that explain most of the residuals at each begin, best first.

    Args:
        laws: inserted already. begins: parameters, then their numbers, as fitted, and start states.
        rare: rare laws, and not the others.
    """
    begun: list[_Begin] = []
    for constants, starts in begins:
        worst = begun[0].worst if begun else None
        begun.append(_Begin(runs, laws, places, constants, starts, worst))

    def changed(candidates: Sequence[Candidate]) -> list[list[tuple[Candidate, Array]]]:
        """Laws that change the residual, and what they change, of each begin."""
        found: list[list[tuple[Candidate, Array]]] = [[] for _ in begun]
        for one in candidates:
            simulated = _Simulations(begun, one)
            for at, some in zip(begun, found, strict=True):
                if (best := at.best_of(one, rare, simulated)) is not None:
                    some.append(best)
        return found

    # Laws are compiled here, so that no copy of the process has to.
    made = in_parallel([partial(changed, readable(runs.model, place, rare)) for place in places])
    logged = {str(port) for port in (*runs.model.fed, *runs.model.compared)}
    return [
        _ranked([each for some in made for each in some[k]], one.left, most, logged)
        for k, one in enumerate(begun)
    ]


def _ranked(found: list[tuple[Candidate, Array]], left: Array, most: int, logged: set[str]) -> Scores:
    """Laws best first, of those that act the same the likeliest."""
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
    order = (Kinds.INPUT, Kinds.OUTPUT, Kinds.RATE, Kinds.EXCHANGE)
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
