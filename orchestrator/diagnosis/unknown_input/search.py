"""The search for what is missing: calibrate, score laws, fit the best."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.parallel import in_parallel
from .judge import closed, likely
from .law_fit import Candidate, Fitted, fit, readable, screened, spread_out, starts_of
from .laws import Number
from .model import StateModel
from .places import Runs, rank
from .polish import Polished, Replays, correlation_length, polished
from .score import SAMPLES, Scores, scored

__all__ = ["LEAST", "SECOND", "Search", "kin_of"]

Array = NDArray[np.float64]
# Laws that are fitted by a few steps, how often the same one, and of these those that are fitted to the end.
_TRIED, _EACH, _KEPT, _STEPS, _RIVALS = 12, 2, 3, 5, 4
# Steps of a fit to the end, and of one by exact derivatives for all that leave so many times the least.
_MANY, _EXACT, _CLOSE = 12, 6, 1.15
# Laws that are tried late, and fitted to the end.
_LATE, _LATE_KEPT = 8, 1
# Fits that leave more than this many times the best are not carried on.
_BEHIND = 1.6
# The logs are explained where this much of the noise is left, and it forgets itself within so many samples,
# or where this share of the gap is closed.
_EXPLAINED, _WHITE, _MOST = 1.1, 2.0, 0.995
# A second law is tried where the first leaves so many times the noise; a law must gain so many nats.
SECOND, LEAST = 2.0, 10.0
# Families that are extended by a second law, those that are extended by a rarer one, and laws beside each.
_BEAM, _RARE, _BESIDE = 3, 2, 5
# Most rounds in which laws of the best pair are replaced.
_ROUNDS = 3
# Share of the spread that a simulation misses which has lost the logs.
_LOST = 0.25
# Tolerances by which a parameter may change before an answer needs a reason for it.
_FAR = 3.0
# Nats a sample by which places in the filter may be behind the best, and how many are looked at.
_NEAR, _PLACES = 0.5, 8
# Share of a signal's range below which a threshold is none.
_EDGE = 0.05


class Search:
    """One study's search."""

    def __init__(self, runs: Runs, progress: Callable[[str], None]) -> None:
        self.runs, self.model, self.progress = runs, runs.model, progress
        self.study = runs.model.study
        self.samples = runs.affordable(SAMPLES)
        self.base = polished(runs, (), runs.model.nominal, samples=self.samples)
        constants = self.base.constants, self.base.covariance
        self.nothing = Fitted((), np.zeros(0), np.zeros(0), 0.0, constants)
        # Where laws are tried from. Parameters that leave their tolerances imitate a law: then also without.
        self.begins = [(self.nothing, self.base)]
        if self.far(self.base.constants):
            near = self.limited(self.base.constants, 1.0)
            self.begins.append(
                (self.nothing, polished(runs, (), near, self.base.starts, fixed=True, samples=self.samples))
            )
        self.places = [one for one in runs.model.places() if self._leaves(runs.model.seen_at(one))]
        self.twins: dict[str, list[Candidate]] = {}
        # Fits that were carried on to the end, and are not again.
        self.ended: list[Fitted] = []
        # Stages that the limit of effort left out.
        self.left_out: list[str] = []

    def _leaves(self, columns: Sequence[int]) -> bool:
        """Whether calibration leaves more than noise in a part of the system, by its compared signals."""
        if len(columns) == len(self.model.compared):
            return self.base.remains > 1.0
        replays = Replays(self.runs, (), starts=self.base.starts)
        found = [replays.found(k, one, self.base.constants) for k, one in enumerate(self.base.starts)]
        for column in columns:
            left = np.concatenate([
                (each - logged)[replays.settled :, column] / self.model.noise[column]
                for each, (_, _, logged) in zip(found, replays.data, strict=True)
            ])  # fmt: skip
            left = left[~np.isnan(left)]
            if float(np.mean(left**2)) > _EXPLAINED**2 or correlation_length(left) > _WHITE:
                return True
        return False

    def scores(self, beside: tuple[Fitted, Polished], late: bool = False) -> Scores:
        """Laws beside some that are fitted."""
        laws = [one.inserted for one in beside[0].laws]
        made = scored(
            self.runs, self.places, laws, beside[1].constants, beside[1].starts, late=late
        )  # fmt: skip
        # What acts the same beside no law counts first: beside others, other signals are read.
        for one, twins in zip(made.candidates, made.twins, strict=True):
            for each in (one, *twins) if twins else ():
                self.twins.setdefault(each.name, [two for two in (one, *twins) if two is not each])
        return made

    def fitted(
        self,
        laws: Sequence[Candidate],
        constants: Array,
        starts: Sequence[Array],
        steps: int = _STEPS,
        samples: int | None = SAMPLES,
        exact: bool = False,
    ) -> tuple[Fitted, Polished]:
        """Laws with numbers that simulate the runs best."""
        found = polished(
            self.runs, [one.inserted for one in laws], constants, starts, trials=steps, samples=samples,
            exact=exact,
        )  # fmt: skip
        count = len(self.model.nominal)
        positive = [number.positive for one in laws for number in one.law.numbers]
        numbers = found.constants[count:]
        numbers[np.array(positive, bool)] = np.abs(numbers[np.array(positive, bool)])
        sigmas = np.sqrt(np.abs(np.diag(found.covariance)[count:]))
        made = Fitted(tuple(laws), numbers, sigmas, -np.inf, (found.constants, found.covariance))
        if not self._sound(made):
            found = replace(found, remains=np.inf)
        return made, found

    def explained(self, found: Sequence[tuple[Fitted, Polished]]) -> bool:
        """Whether some laws leave little more than the noise, or close nearly all of the gap.

        Those that need a parameter beyond its tolerance may lack a second law.
        """
        near = [one for _, one in found if not self.far(one.constants)]
        if not near:
            return False
        least = min(near, key=lambda one: one.remains)
        if least.remains < _EXPLAINED:
            return least.length < _WHITE
        return closed(self.base.remains, least.remains) > _MOST

    def _sound(self, one: Fitted) -> bool:
        """Whether numbers stay within what makes a law this law."""
        low, high, spread = self.runs.low, self.runs.high, self.runs.spread

        def sound(number: Number, value: float, signal: int) -> bool:
            edge = 0.0 if number.positive else _EDGE * (high[signal] - low[signal])
            ends = (value, -value) if number.positive else (value,)
            inside = any(low[signal] + edge < one < high[signal] for one in ends)
            least, most = number.limits
            size = abs(value) <= number.most * spread[signal] and least <= value <= most
            return size and (inside or not number.within)

        return all(
            sound(number, value, law.inserted.signals[0])
            for law, values, _ in one.by_law()
            for number, value in zip(law.law.numbers, values, strict=True)
        )

    def tried(
        self, sets: Sequence[Sequence[Candidate]], beside: tuple[Fitted, Polished]
    ) -> list[tuple[Fitted, Polished]]:
        """Fit each set of laws beside those that are fitted, by a few steps; best first."""
        first, before = beside[0].laws, beside[1]
        found: list[tuple[Fitted, Polished]] = []
        for begin in range(0, len(sets), _RIVALS):
            explained = self.explained(found)
            found += self._fits(
                (
                    (*first, *one),
                    np.r_[before.constants, [value for law in one for value in law.numbers]],
                    before.starts,
                )
                for one in sets[begin : begin + _RIVALS]
            )
            # The sets come in the order of their scores. Where one explains the logs, a few rivals suffice.
            if explained or not self.model.effort.allows():
                break
        return sorted(found, key=lambda each: each[1].remains)

    def _allowed(self, stage: str, evaluations: float = 0.0) -> bool:
        """Whether the limit of effort allows a stage; notes it if not."""
        allowed = self.model.effort.allows(evaluations)
        if not allowed and stage not in self.left_out:
            self.left_out.append(stage)
        return allowed

    def _fits(
        self, begins: Iterable[tuple[Sequence[Candidate], Array, Sequence[Array]]], *options: Any, **more: Any
    ) -> list[tuple[Fitted, Polished]]:
        """Independent fits, each from laws, constants and start states; see `fitted`."""
        return in_parallel([partial(self.fitted, *one, *options, **more) for one in begins])

    def finished(self, found: Sequence[tuple[Fitted, Polished]], kept: int) -> list[tuple[Fitted, Polished]]:
        """Fits by a few steps, and the best of them carried on to the end; the best of each set of laws."""
        if not found:
            return []
        ranked = _unlike(found)
        near = _BEHIND * ranked[0][1].remains
        ended = in_parallel([
            partial(self.to_the_end, one.laws, two.constants, two.starts)
            for one, two in ranked[:kept]
            if two.remains < near and not any(one is each for each in self.ended)
        ])  # fmt: skip
        if not self._allowed("exact derivatives"):
            return _unlike([*found, *ended])
        # Exact derivatives see the corners of a law, but cost most.
        least = min((two.remains for _, two in (*found, *ended)), default=np.inf)
        exact = self._fits(
            (
                (one.laws, two.constants, two.starts)
                for one, two in ended if _EXPLAINED < two.remains < _CLOSE * least
            ),
            _EXACT, self.samples, exact=True,
        )  # fmt: skip
        self.ended += [one for one, _ in (*ended, *exact)]
        return _unlike([*found, *ended, *exact])

    def alone(self, found: Sequence[tuple[Fitted, Polished]]) -> list[tuple[Fitted, Polished]]:
        """Each law of the best pair without the other, from the numbers that it has in the pair.

        A fit of one law that began elsewhere may have missed them.
        """
        pairs = [one for one in found if len(one[0].laws) == 2]
        if not pairs:
            return []
        best, pair = min(pairs, key=lambda each: each[1].remains)
        count = len(self.model.nominal)
        return self._fits(
            ((law,), np.r_[pair.constants[:count], values], pair.starts) for law, values, _ in best.by_law()
        )

    def likelier(self, found: Sequence[tuple[Fitted, Polished]]) -> list[tuple[Fitted, Polished]]:
        """The best fits, each law replaced by the likeliest that acts the same, where that is another.

        A fit may have reached a law by way of a pair, without regard to what acts the same.
        """
        best = {len(one.laws): (one, two) for one, two in reversed(_unlike(found))}
        begins = []
        for one, two in best.values():
            laws = tuple(
                max([law, *self.twins.get(law.name, ())], key=lambda each: each.odds) for law in one.laws
            )
            sizes = [len(law.law.numbers) for law in one.laws]
            if laws != one.laws and [len(law.law.numbers) for law in laws] == sizes:
                count = len(self.model.nominal)
                numbers = [
                    law.numbers if law is not old else values
                    for law, (old, values, _) in zip(laws, one.by_law(), strict=True)
                ]
                begins.append((laws, np.r_[two.constants[:count], *numbers], two.starts))
        return self._fits(begins, _MANY, self.samples)

    def within_tolerance(self, found: Sequence[tuple[Fitted, Polished]]) -> list[tuple[Fitted, Polished]]:
        """Other laws in place of the best single one, if that needs a parameter beyond its tolerance.

        They begin with its numbers, and with such parameters as configured. A stop without a spring is a dead
        band.
        """
        singles = [one for one in found if len(one[0].laws) == 1]
        if not singles:
            return []
        best, single = min(singles, key=lambda each: each[1].remains)
        far, (law,) = self.far(single.constants), best.laws
        if not far:
            return []
        begin = single.constants.copy()
        begin[far] = self.model.nominal[far]
        other = begin.copy()
        other[len(self.model.nominal)] *= -1.0
        return self._fits(
            (
                ((one,), constants, single.starts)
                for one in _others(self.model, law)
                if one.law.linear and len(one.law.numbers) == len(best.numbers)
                for constants in (begin, other)
            ),
            _MANY, self.samples,
        )  # fmt: skip

    def to_the_end(
        self, laws: Sequence[Candidate], constants: Array, starts: Sequence[Array]
    ) -> tuple[Fitted, Polished]:
        """A fit carried on with all samples."""
        made = self.fitted(laws, constants, starts, _MANY, self.samples)
        if made[1].remains > _EXPLAINED:
            # Calibration without the law may have led the fit astray, and to other start states.
            fresh = np.r_[self.model.nominal, [value for law in laws for value in law.numbers]]
            other = self.fitted(laws, fresh, [each[3] for each in self.runs.data])
            if other[1].remains < made[1].remains:
                return self.fitted(laws, other[1].constants, other[1].starts, _MANY, self.samples)
        return made

    def filtered(self) -> list[tuple[Fitted, Polished]]:
        """Laws read off an unknown input and fitted in the filter, for systems that open simulations lose.

        The filter follows the logs where a simulation diverges, as of a pendulum that turns over.
        """
        found: list[tuple[Fitted, Polished]] = []
        best: Fitted | None = None
        values = sum(int((~np.isnan(one[2])).sum()) for one in self.runs.data)
        for _ in range(2):
            # Places take a dozen passes each, fits of laws a hundred together.
            passes = 12 * len(self.places) + 100
            if not self._allowed("unknown input", passes * self.runs.pass_effort()):
                break
            self.progress("unknown input")
            laws = [] if best is None else [one.inserted for one in best.laws]
            priors = [] if best is None else [(v, abs(v)) for v in best.numbers.tolist()]
            _, places = rank(self.runs, None, laws, priors)
            if not places or places[0].gain < LEAST:
                break
            near = [one for one in places if one.gain > places[0].gain - _NEAR * values][:_PLACES]
            before = best.laws if best else ()
            start = None if best is None else best.numbers
            made = in_parallel([
                partial(
                    fit, self.runs, (*before, one), places[0],
                    None if start is None else np.r_[start, one.numbers],
                )
                for one in screened(self.runs, near, best)
            ])  # fmt: skip
            made = [one for one in made if np.isfinite(one.loglik)]
            made.sort(key=lambda one: (one.beside == 0.0, one.loglik), reverse=True)
            found += in_parallel([partial(self._simulated, one) for one in made[:3]])
            if not made:
                break
            best = made[0]
        if best is not None and self._allowed("relatives of the unknown input's laws"):
            relatives = [one for one in self._relatives(best) if np.isfinite(one.loglik)]
            found += in_parallel([partial(self._simulated, one) for one in relatives])
        return sorted(found, key=lambda each: each[1].remains)

    def _simulated(self, one: Fitted) -> tuple[Fitted, Polished]:
        """A fit of the simulation, which begins with a filter's numbers and start states."""
        starts = likely(self.runs, [law.inserted for law in one.laws], one.constants[0])
        return self.fitted(one.laws, one.constants[0], starts, 10, self.samples)

    def _relatives(self, best: Fitted) -> Iterator[Fitted]:
        """The same laws, each in turn replaced by one of its family, as a lag by a delay."""
        for k, (law, values, _) in enumerate(best.by_law()):
            for other in kin_of(self.runs, law, values):
                laws = (*best.laws[:k], other, *best.laws[k + 1 :])
                numbers = [other.numbers if j == k else one[1] for j, one in enumerate(best.by_law())]
                yield fit(self.runs, laws, None, np.concatenate(numbers))

    def far(self, constants: Array) -> list[int]:
        """Parameters that leave their tolerance."""
        change = np.abs(constants[: len(self.model.nominal)] - self.model.nominal)
        return np.flatnonzero(change > _FAR * self.model.tolerance).tolist()

    def limited(self, constants: Array, tolerances: float = _FAR) -> Array:
        """Parameters, each no more tolerances from its nominal value; by default what needs a reason."""
        most = tolerances * self.model.tolerance
        return np.clip(constants[: len(most)], self.model.nominal - most, self.model.nominal + most)

    def weighed(self, found: Sequence[tuple[Fitted, Polished]]) -> list[tuple[Fitted, Polished, float]]:
        """The best fit of each set of laws with its evidence [nats], best first.

        A residual that remembers `length` samples holds 1 / length of them as evidence.
        """
        best = _unlike(found)
        least = best[0][1]
        effective = least.samples / least.length
        weighed = [
            (one, two, -effective * np.log(max(two.remains, 1e-6)) - 0.5 * min(two.strain, 1e6)
             - 0.5 * len(two.constants) * np.log(max(effective, 2.0))
             + sum(np.log(law.odds) for law in one.laws))
            for one, two in best if np.isfinite(two.remains)
        ]  # fmt: skip
        return sorted(weighed, key=lambda each: each[2], reverse=True)

    def searched(self) -> list[tuple[Fitted, Polished]]:
        """Fits of all stages: no law, single laws, rarer ones, pairs, and what a filter reads."""
        every = [(self.nothing, self.base)]
        if not self.places:
            return every
        self.progress("laws")
        scores = [self.scores(begin) for begin in self.begins]
        tried = self._from_begins(scores, partial(_singly, most=_TRIED, each=_EACH))
        if tried and not self.explained(tried) and self._allowed("laws of the same family"):
            for one in _families(_unlike(tried))[:_BEAM]:
                tried += self._kin(*one, operator.gt)
        singles = self.finished(tried, _KEPT)
        if singles and self._allowed("laws of the same family"):
            # Where the first laws explain the logs, others of their family may not have been tried.
            # A resonance without overshoot is a lag.
            singles = _unlike([*singles, *self.finished(self._kin(*singles[0], operator.le), 1)])
        every += singles
        if not self.explained(every) and self._allowed("rarer laws"):
            self.progress("rarer laws")
            late = [self.scores(begin, late=True) for begin in self.begins]
            scores = [one.joined(two) for one, two in zip(scores, late, strict=True)]
            tried = self._from_begins(late, partial(_singly, most=_LATE, each=1))
            rare = self.finished(tried, _LATE_KEPT)
            every += rare
            singles = _unlike([*singles, *rare])
        lacking = not singles or singles[0][1].remains > SECOND or bool(self.far(singles[0][1].constants))
        if not self.explained(every) and lacking and self._allowed("pairs of laws"):
            self.progress("pairs of laws")
            pairs = self.finished(self._pairs(scores, singles), _KEPT)
            # The first round may find a law that explains still more, or as much with fewer numbers.
            for _ in range(_ROUNDS if pairs else 0):
                if not self._allowed("other laws in pairs"):
                    break
                before = pairs[0][0].laws
                pairs = self.finished([*pairs, *self._alike(*pairs[0], singles)], _KEPT)
                if pairs[0][0].laws == before or self.explained(pairs):
                    break
            every += [*pairs, *self.finished(self.alone(pairs), _KEPT)]
        every += self.likelier(every)
        if self._allowed("other laws within tolerances"):
            every += self.within_tolerance(every)
        lost = self.base.remains > _LOST * self.runs.logged_spread()
        if self.model.filters and lost and not self.explained(every):
            every += self.filtered()
        return every

    def _from_begins(
        self, scores: Sequence[Scores], sets: Callable[[Scores], Sequence[Sequence[Candidate]]]
    ) -> list[tuple[Fitted, Polished]]:
        """Fits of sets of laws, which are taken from the scores of each begin."""
        return [
            one
            for begin, scored in zip(self.begins, scores, strict=True)
            for one in self.tried(sets(scored), begin)
        ]

    def _kin(
        self, best: Fitted, found: Polished, compare: Callable[[int, int], bool]
    ) -> list[tuple[Fitted, Polished]]:
        """Each law in turn replaced by those of its family; see `kin_of`."""
        kin = partial(kin_of, self.runs, compare=compare)
        return self._fits(self._replaced(best, found, kin))

    def _replaced(
        self, best: Fitted, found: Polished, others: Callable[[Candidate, Array], Iterable[Candidate]]
    ) -> Iterator[tuple[tuple[Candidate, ...], Array, Sequence[Array]]]:
        """Begins of fits: each law in turn replaced by others, which begin with their own numbers."""
        count, parts = len(self.model.nominal), list(best.by_law())
        for k, (law, values, _) in enumerate(parts):
            for two in others(law, values):
                numbers = [two.numbers if j == k else one[1] for j, one in enumerate(parts)]
                laws = (*best.laws[:k], two, *best.laws[k + 1 :])
                yield laws, np.r_[found.constants[:count], *numbers], found.starts

    def _alike(
        self, best: Fitted, found: Polished, singles: Sequence[tuple[Fitted, Polished]]
    ) -> list[tuple[Fitted, Polished]]:
        """A pair with each law in turn replaced.

        By one that alone acts the same, by one of its family, or by the best ones at its component.

        Args:
            singles: best first. They begin with the numbers that they have alone.
        """

        def others(law: Candidate, values: Array) -> list[Candidate]:
            twins = [one for one in self.twins.get(law.name, ()) if one.law is law.law][:_BESIDE]
            near = [
                replace(one.laws[0], numbers=tuple(one.numbers.tolist()))
                for one, _ in singles
                if one.laws[0].place.component == law.place.component and one.laws[0].name != law.name
            ]
            simpler = [
                one for one in near[_BESIDE:]
                if one.law.family == law.law.family and len(one.numbers) < len(values)
            ]  # fmt: skip
            return [
                *[replace(one, numbers=tuple(values.tolist())) for one in twins],
                *kin_of(self.runs, law, values, operator.le),
                *near[:_BESIDE],
                *simpler,
            ]

        return self._fits(self._replaced(best, found, others))

    def _pairs(
        self, scores: Sequence[Scores], singles: Sequence[tuple[Fitted, Polished]]
    ) -> list[tuple[Fitted, Polished]]:
        """Fits of pairs: by their scores, beside the best single laws, rarer laws beside the best two.

        Args:
            scores: of single laws, rarer ones among them, from each begin. singles: best first.
        """
        found = self._from_begins(scores, partial(Scores.pairs, most=_BESIDE))
        for one in _families(singles)[:_BEAM]:
            if not self.explained(found) and self._allowed("pairs with the best laws"):
                more = self.scores(one).candidates
                found += self.tried([[two] for two in more if two.law.states == 0][:_BESIDE], one)
        for one in _families(singles)[:_RARE]:
            if not self.explained(found) and self._allowed("pairs with rarer laws"):
                rare = self.scores(one, late=True).candidates
                found += self.tried([[two] for two in spread_out(rare, _BESIDE, 1)], one)
        return found


def _singly(scores: Scores, most: int, each: int) -> list[list[Candidate]]:
    """Laws to be tried alone; see `spread_out`."""
    return [[law] for law in spread_out(scores.candidates, most, each)]


def _others(model: StateModel, law: Candidate) -> list[Candidate]:
    """Other laws at the same place that read the same signal."""
    every = readable(model, law.place)
    return [one for one in every if one.law is not law.law and one.signal == law.signal]


def kin_of(
    runs: Runs, law: Candidate, numbers: Array, compare: Callable[[int, int], bool] = operator.eq
) -> list[Candidate]:
    """Laws of the same family at the same place that read the same signal.

    They begin with the numbers that they share with the law: by name, or by place and unit.

    Args:
        compare: of how many numbers they and the law have; by default they have as many.
    """
    own = law.law.numbers
    by_name = {one.name: value for one, value in zip(own, numbers.tolist(), strict=True)}
    by_unit = {(k, one.unit): value for k, (one, value) in enumerate(zip(own, by_name.values(), strict=True))}
    return [
        replace(one, numbers=start)
        for one in _others(runs.model, law)
        if one.law.family == law.law.family and compare(len(one.law.numbers), len(own))
        for start in {
            tuple(
                by_name.get(each.name, by_unit.get((k, each.unit), value))
                for k, (each, value) in enumerate(zip(one.law.numbers, start, strict=True))
            )
            for start in starts_of(one, runs)
        }
    ]


def _unlike(found: Sequence[tuple[Fitted, Polished]]) -> list[tuple[Fitted, Polished]]:
    """The best fit of each set of laws, best first."""
    ranked: dict[tuple[str, ...], tuple[Fitted, Polished]] = {}
    for one in sorted(found, key=lambda each: each[1].remains):
        ranked.setdefault(tuple(sorted(law.name for law in one[0].laws)), one)
    return list(ranked.values())


def _families(singles: Sequence[tuple[Fitted, Polished]]) -> list[tuple[Fitted, Polished]]:
    """The best fit of each family at each component."""
    found: dict[tuple[str, int], tuple[Fitted, Polished]] = {}
    for one in singles:
        found.setdefault((one[0].laws[0].law.family, one[0].laws[0].place.component), one)
    return list(found.values())
