"""The search for what is missing: score laws, fit the best, stage after stage."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ...base.parallel import in_parallel
from .evaluation import Place
from .fits import MANY, Fit, Fits, best_of_each
from .held_out_replay import likely
from .law_fit import Candidate, Fitted, fit_by_filter, readable, screened, spread_out, starts_of
from .model import StateModel
from .places import Runs, rank
from .polish import Replays, correlation_length, polished
from .score import Scores, scored

Array = NDArray[np.float64]
# Laws that are fitted by a few steps, how often the same one, and of these those that are fitted to the end.
_TRIED, _EACH, _KEPT = 12, 2, 3
# Rare laws that are tried, and fitted to the end.
_RARE_TRIED, _RARE_KEPT = 8, 1
# A part of a system is explained where this much of the noise is left, and it forgets itself within so many
# samples.
_EXPLAINED, _WHITE = 1.1, 2.0
# A second law is tried where the first leaves so many times the noise; a law must gain so many nats.
SECOND, LEAST = 2.0, 10.0
# Families that are extended by a second law, those that are extended by a rarer one, and laws beside each.
_BEAM, _RARE, _BESIDE = 3, 2, 5
# Most rounds in which the best laws are replaced, and what a round may leave of the misfit for another one.
_ROUNDS, _BETTER = 3, 0.95
# Points of a signal's range at which laws are compared, and the share of a law's square that another may miss
# which stands in for it.
_RANGE, _IMITATED = 100, 0.1
# Begins of a scan around a number.
_SCAN = 41
# Share of the spread that a simulation misses which has lost the logs.
_LOST = 0.25
# Nats a sample by which places in the filter may be behind the best, and how many are looked at.
_NEAR, _PLACES = 0.5, 8
# Fits of the filter that are simulated, and steps of these fits.
_FILTERED, _SIMULATED = 3, 10


class Search(Fits):
    """One study's search.

    Attributes:
        begins: fits beside which laws are tried first. places: where laws are tried, by default everywhere.
        twins: of each law, by name, others that act the same on these logs.
    """

    def __init__(
        self, runs: Runs, progress: Callable[[str], None], places: Sequence[Place] | None = None
    ) -> None:
        super().__init__(runs)
        self.progress = progress
        # Parameters that leave their tolerances imitate a law: then laws are tried also without.
        self.begins = [Fit(self.nothing, self.base)]
        if self.far(self.base.constants):
            near = self.limited(self.base.constants, 1.0)
            within = polished(runs, (), near, self.base.starts, fixed=True, samples=self.samples)
            self.begins.append(Fit(self.nothing, within))
        every = runs.model.places() if places is None else places
        self.places = [one for one in every if self._unexplained(runs.model.seen_at(one))]
        self.twins: dict[str, list[Candidate]] = {}
        # Scores of laws from each begin, rarer ones among them once they are tried; best fits of single laws.
        self._scores: list[Scores] = []
        self._singles: list[Fit] = []

    def _unexplained(self, columns: Sequence[int]) -> bool:
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

    def begun(self, promising: float = 0.0) -> list[Fit]:
        """Fits of the first stages: no law, and single laws.

        Args:
            promising: share of the residual that one of these must explain by its score, else none is fitted.
        """
        found = [Fit(self.nothing, self.base)]
        if self.places:
            self.progress("laws")
            self._scores = self.scores(*self.begins)
            most = max((law.share for scores in self._scores for law in scores.candidates), default=0.0)
            found += self._single_laws() if most >= promising else []
        return found

    def further(self, found: Sequence[Fit]) -> list[Fit]:
        """Fits of all stages: those of the first ones, rarer laws, pairs, and what a filter reads."""
        every = list(found)
        if self.places:
            for stage in (
                self._rarer_laws, self._pairs_of_laws, self.rivals,
                self.likelier, self._within_tolerance, self._unknown_inputs,
            ):  # fmt: skip
                every += stage(every)
        return every

    def scores(self, *beside: Fit, rare: bool = False) -> list[Scores]:
        """Laws beside the same ones that are fitted, from each begin."""
        laws = [one.inserted for one in beside[0].laws]
        begins = [(one.polished.constants, one.polished.starts) for one in beside]
        found = scored(self.runs, self.places, laws, begins, rare=rare)
        for made in found:
            # What acts the same beside no law counts first: beside others, other signals are read.
            for one, twins in zip(made.candidates, made.twins, strict=True):
                for each in (one, *twins) if twins else ():
                    self.twins.setdefault(each.name, [two for two in (one, *twins) if two is not each])
        return found

    def _single_laws(self) -> list[Fit]:
        """Laws alone, each beside others of its family."""
        tried = self._from_begins(self._scores, partial(_singly, most=_TRIED, each=_EACH))
        if tried and not self.explained(tried) and self.allowed("laws of the same family"):
            for one in _best_of_families(best_of_each(tried))[:_BEAM]:
                tried += self._kin(one, operator.gt)
        singles = self.finish(tried, _KEPT)
        if singles and self.allowed("laws of the same family"):
            # Where the first laws explain the logs, others of their family may not have been tried.
            # A resonance without overshoot is a lag.
            singles = best_of_each([*singles, *self.finish(self._kin(singles[0], operator.le), 1)])
        self._singles = singles
        return singles

    def _rarer_laws(self, found: Sequence[Fit]) -> list[Fit]:
        """Laws that are tried where the common ones do not explain the logs."""
        if self.explained(found) or not self.allowed("rarer laws"):
            return []
        self.progress("rarer laws")
        scores = self.scores(*self.begins, rare=True)
        self._scores = [one.joined(two) for one, two in zip(self._scores, scores, strict=True)]
        rare = self.finish(self._from_begins(scores, partial(_singly, most=_RARE_TRIED, each=1)), _RARE_KEPT)
        rare = best_of_each([*rare, *self.finish(self.fit_each(_scanned(rare[:_RARE_KEPT])), _RARE_KEPT)])
        self._singles = best_of_each([*self._singles, *rare])
        return rare

    def _pairs_of_laws(self, found: Sequence[Fit]) -> list[Fit]:
        """Two laws, where none alone explains the logs or needs what the tolerances do not allow."""
        best = self._singles[0] if self._singles else None
        enough = best is not None and best.remains <= SECOND and not self.far(best.polished.constants)
        if self.explained(found) or enough or not self.allowed("pairs of laws"):
            return []
        self.progress("pairs of laws")
        pairs = self.finish(self._pairs(), _KEPT)
        # The first round may find a law that explains still more, or as much with fewer numbers.
        for _ in range(_ROUNDS if pairs else 0):
            if not self.allowed("other laws in pairs"):
                break
            before = pairs[0].laws
            pairs = self.finish([*pairs, *self._replaced_in(pairs[0])], _KEPT)
            if pairs[0].laws == before or self.explained(pairs):
                break
        return [*pairs, *self.finish(self._alone(pairs), _KEPT)]

    def _pairs(self) -> list[Fit]:
        """Pairs by their scores, beside the best single laws, and rarer laws beside the best two."""
        found = self._from_begins(self._scores, partial(Scores.pairs, most=_BESIDE))
        best = _best_of_families(self._singles)
        for one in best[:_BEAM]:
            if not self.explained(found) and self.allowed("pairs with the best laws"):
                more = self.scores(one)[0].candidates
                found += self.fit_beside([[two] for two in more if two.law.states == 0][:_BESIDE], one)
        for one in best[:_RARE]:
            if not self.explained(found) and self.allowed("pairs with rarer laws"):
                rare = self.scores(one, rare=True)[0].candidates
                found += self.fit_beside([[two] for two in spread_out(rare, _BESIDE, 1)], one)
        return found

    def _replaced_in(self, pair: Fit) -> list[Fit]:
        """A pair with each law in turn replaced.

        By one that alone acts the same, by one of its family, or by the best ones at its component, which
        begin with the numbers that they have alone.
        """

        def others(law: Candidate, values: Array) -> list[Candidate]:
            twins = [one for one in self.twins.get(law.name, ()) if one.law is law.law][:_BESIDE]
            near = [
                replace(one.laws[0], numbers=tuple(one.numbers.tolist()))
                for one, _ in self._singles
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

        return self.fit_each(self._replaced(pair, others))

    def _alone(self, pairs: Sequence[Fit]) -> list[Fit]:
        """Each law of the best pair without the other, from the numbers that it has in the pair.

        A fit of one law that began elsewhere may have missed them.
        """
        pairs = [one for one in pairs if len(one.laws) == 2]
        if not pairs:
            return []
        fitted, pair = min(pairs, key=lambda one: one.remains)
        count = len(self.model.nominal)
        return self.fit_each(
            ((law,), np.r_[pair.constants[:count], values], pair.starts) for law, values, _ in fitted.by_law()
        )

    def rivals(self, found: Sequence[Fit]) -> list[Fit]:
        """The best fits, each law in turn at other places, or replaced by others at its place.

        The first fits take few places of a law, and few steps.
        """
        if not self.allowed("rivals of the best laws"):
            return []
        ranked = best_of_each(found)
        fitted = {one.laws[0].name: one.fitted.numbers for one in ranked if len(one.laws) == 1}
        scored = sorted(
            {one.name: one for scores in self._scores for one in scores.candidates}.values(),
            key=lambda one: -one.share,
        )

        def others(law: Candidate, values: Array) -> list[Candidate]:
            elsewhere = [one for one in scored if one.law is law.law and one.name != law.name]
            here = [
                replace(one, numbers=tuple(fitted[one.name].tolist())) if one.name in fitted else one
                for one in scored
                if one.law is not law.law and (one.place, one.signal) == (law.place, law.signal)
            ]
            nearest = [one for each in here for one in imitating(self.runs, law, values, each)]
            # The usual law of a rare one's family may be no candidate, since it acts like another law.
            usual = kin_of(self.runs, law, values, operator.le) if law.law.rare else ()
            return [*elsewhere[:_BESIDE], *here[:_BESIDE], *nearest, *usual]

        best = {len(one.laws): one for one in reversed(ranked) if one.laws}
        made: list[Fit] = []
        for one in best.values():
            for _ in range(_ROUNDS):
                fits = self.finish(self.fit_each(self._replaced(one, others)), _KEPT)
                better = bool(fits) and fits[0].remains < one.remains
                if better:
                    fits += self.finish(self._kin(fits[0], operator.le), 1)
                made += fits
                # Beside a law that is now at another place, another one may explain the rest.
                if not better or min(each.remains for each in fits) > _BETTER * one.remains:
                    break
                one = min(fits, key=lambda each: each.remains)
                if not self.allowed("rivals of better laws"):
                    break
        return made

    def likelier(self, found: Sequence[Fit]) -> list[Fit]:
        """The best fits, each law replaced by the likeliest that acts the same, where that is another.

        A fit may have reached a law by way of a pair, without regard to what acts the same.
        """
        best = {len(one.laws): one for one in reversed(best_of_each(found))}
        begins = []
        for fitted, simulated in best.values():
            laws = tuple(
                max([law, *self.twins.get(law.name, ())], key=lambda each: each.odds) for law in fitted.laws
            )
            sizes = [len(law.law.numbers) for law in fitted.laws]
            if laws != fitted.laws and [len(law.law.numbers) for law in laws] == sizes:
                count = len(self.model.nominal)
                numbers = [
                    law.numbers if law is not old else values
                    for law, (old, values, _) in zip(laws, fitted.by_law(), strict=True)
                ]
                begins.append((laws, np.r_[simulated.constants[:count], *numbers], simulated.starts))
        return self.fit_each(begins, MANY, self.samples)

    def _within_tolerance(self, found: Sequence[Fit]) -> list[Fit]:
        """Other laws in place of the best single one, if that needs a parameter beyond its tolerance.

        They begin with its numbers, and with such parameters as configured. A stop without a spring is a dead
        band.
        """
        singles = [one for one in found if len(one.laws) == 1]
        if not singles or not self.allowed("other laws within tolerances"):
            return []
        best, single = min(singles, key=lambda one: one.remains)
        far, (law,) = self.far(single.constants), best.laws
        if not far:
            return []
        begin = single.constants.copy()
        begin[far] = self.model.nominal[far]
        other = begin.copy()
        other[len(self.model.nominal)] *= -1.0
        return self.fit_each(
            (
                ((one,), constants, single.starts)
                for one in _others(self.model, law)
                if one.law.linear and len(one.law.numbers) == len(best.numbers)
                for constants in (begin, other)
            ),
            MANY, self.samples,
        )  # fmt: skip

    def _unknown_inputs(self, found: Sequence[Fit]) -> list[Fit]:
        """Laws read off an unknown input and fitted in the filter, for systems that open simulations lose.

        The filter follows the logs where a simulation diverges, as of a pendulum that turns over.
        """
        lost = self.base.remains > _LOST * self.runs.logged_spread()
        if not self.model.filters or not lost or self.explained(found):
            return []
        simulated: list[Fit] = []
        best: Fitted | None = None
        values = sum(int((~np.isnan(one[2])).sum()) for one in self.runs.data)
        for _ in range(2):
            # Places take a dozen passes each, fits of laws a hundred together.
            passes = 12 * len(self.places) + 100
            if not self.allowed("unknown input", passes * self.runs.pass_effort()):
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
                    fit_by_filter, self.runs, (*before, one), places[0],
                    None if start is None else np.r_[start, one.numbers],
                )
                for one in screened(self.runs, near, best)
            ])  # fmt: skip
            made = [one for one in made if np.isfinite(one.loglik)]
            made.sort(key=lambda one: (one.beside == 0.0, one.loglik), reverse=True)
            simulated += in_parallel([partial(self._simulate, one) for one in made[:_FILTERED]])
            if not made:
                break
            best = made[0]
        if best is not None and self.allowed("relatives of the unknown input's laws"):
            relatives = [one for one in self._relatives(best) if np.isfinite(one.loglik)]
            simulated += in_parallel([partial(self._simulate, one) for one in relatives])
        return sorted(simulated, key=lambda one: one.remains)

    def _simulate(self, one: Fitted) -> Fit:
        """A fit of the simulation, which begins with a filter's numbers and start states."""
        starts = likely(self.runs, [law.inserted for law in one.laws], one.constants[0])
        return self.fit(one.laws, one.constants[0], starts, _SIMULATED, self.samples)

    def _relatives(self, best: Fitted) -> Iterator[Fitted]:
        """The same laws, each in turn replaced by one of its family, as a lag by a delay."""
        for k, (law, values, _) in enumerate(best.by_law()):
            for other in kin_of(self.runs, law, values):
                laws = (*best.laws[:k], other, *best.laws[k + 1 :])
                numbers = [other.numbers if j == k else one[1] for j, one in enumerate(best.by_law())]
                yield fit_by_filter(self.runs, laws, None, np.concatenate(numbers))

    def _from_begins(
        self, scores: Sequence[Scores], sets: Callable[[Scores], Sequence[Sequence[Candidate]]]
    ) -> list[Fit]:
        """Fits of sets of laws, which are taken from the scores of each begin."""
        return [
            one
            for begin, scored in zip(self.begins, scores, strict=True)
            for one in self.fit_beside(sets(scored), begin)
        ]

    def _kin(self, best: Fit, compare: Callable[[int, int], bool]) -> list[Fit]:
        """Each law in turn replaced by those of its family; see `kin_of`."""
        return self.fit_each(self._replaced(best, partial(kin_of, self.runs, compare=compare)))

    def _replaced(
        self, best: Fit, others: Callable[[Candidate, Array], Iterable[Candidate]]
    ) -> Iterator[tuple[tuple[Candidate, ...], Array, Sequence[Array]]]:
        """Begins of fits: each law in turn replaced by others, which begin with their own numbers."""
        count, parts = len(self.model.nominal), list(best.fitted.by_law())
        for k, (law, values, _) in enumerate(parts):
            for two in others(law, values):
                numbers = [two.numbers if j == k else one[1] for j, one in enumerate(parts)]
                laws = (*best.laws[:k], two, *best.laws[k + 1 :])
                yield laws, np.r_[best.polished.constants[:count], *numbers], best.polished.starts


def _scanned(fits: Sequence[Fit]) -> Iterator[tuple[tuple[Candidate, ...], Array, Sequence[Array]]]:
    """Begins around numbers of single laws that fits may miss; see `Number.scanned`."""
    for one in fits:
        law, end = one.laws[0].law, len(one.polished.constants)
        for k, number in enumerate(law.numbers, end - len(law.numbers)):
            for share in np.linspace(-number.scanned, number.scanned, _SCAN if number.scanned else 0):
                constants = one.polished.constants.copy()
                constants[k] *= 1.0 + share
                yield one.laws, constants, one.polished.starts


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
    """Laws of the same family at the same place that read the same signal, but no rare ones.

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


def imitating(runs: Runs, law: Candidate, values: Array, other: Candidate) -> list[Candidate]:
    """Another law of the same signal, with the numbers by which it comes nearest to a law.

    They are found along the signal's range, which takes laws without states. Returns: one, or none.
    """
    if law.law.states or other.law.states or law.second or other.second or not other.law.linear:
        return []
    (index,) = other.inserted.signals
    signal = np.linspace(runs.low[index], runs.high[index], _RANGE)
    time = np.linspace(0.0, runs.length, _RANGE)
    wanted = law.law.values(time, signal, values)
    shared = {one.name: value for one, value in zip(law.law.numbers, values.tolist(), strict=True)}
    best, least = other, _IMITATED * float(wanted @ wanted)
    for start in starts_of(other, runs):
        named = [shared.get(one.name, value) for one, value in zip(other.law.numbers, start, strict=True)]
        for numbers in (start, [1.0, *named[1:]]):
            shape = other.law.values(time, signal, numbers)
            size = float(shape @ shape)
            if not 0.0 < size < np.inf:
                continue
            factor = float(shape @ wanted) / size
            misfit = float(np.sum((wanted - factor * shape) ** 2))
            if misfit < least:
                best, least = replace(other, numbers=(factor, *numbers[1:])), misfit
    return [] if best is other else [best]


def _best_of_families(singles: Sequence[Fit]) -> list[Fit]:
    """The best fit of each family at each component."""
    found: dict[tuple[str, int], Fit] = {}
    for one in singles:
        law = one.laws[0]
        found.setdefault((law.law.family, law.place.component), one)
    return list(found.values())
