"""The diagnosis by unknown inputs: calibrate, score laws, fit the best, judge on held-out runs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from ...base.errors import ConfigError
from ...base.parallel import in_parallel
from ..study.study import PortStudy, Role
from .judge import closed, likely, replayed
from .law_fit import Candidate, Fitted, fit, readable, screened, spread_out
from .laws import Number
from .model import StateModel
from .places import Ranked, Runs, rank, smoothed_at
from .played import PlayedModel
from .polish import Polished, Replays, polished
from .score import SAMPLES, Scores, odds_of, scored
from .separate import Experiment, Simulable, separating

__all__ = ["Answer", "answer"]

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
# Shares of what is left that a law must close, first or rare, or second. A second law must gain so many nats,
# and the first leave so many times the noise.
_THIRD, _HALF, _SECOND, _LEAST = 0.3, 0.5, 2.0, 10.0
# Families that are extended by a second law, and laws tried beside each.
_BEAM, _BESIDE = 3, 5
# Share of the logs' spread below which a residual without a name counts as none.
_SMALL = 0.05
# Share of the spread that a simulation misses which has lost the logs.
_LOST = 0.25
# Tolerances by which a parameter may change before an answer needs a reason for it.
_FAR = 3.0
_NEAR, _PLACES = 0.5, 8
# Share of a signal's range below which a threshold is none.
_EDGE = 0.05
# Learned on random systems (`orchestrator challenge --random 6000 --count 60`): nats that count as one, and
# how often answers were wrong that leave at most so many times the noise on held-out runs; or more than that.
_TEMPERATURE, _NEAR_NOISE, _WRONG_NEAR, _WRONG_FAR = 1.14, 1.5, 0.041, 0.53
# Largest probability of an answer that held-out runs contradict.
_OUTSIDE = 0.6
# Least share of the gap that the nearest laws close on held-out runs to be stated.
_HINT = 0.1
# Probability from which on a rival is worth an experiment.
_LIKELY = 0.02
# Samples that are enough for a search, and noises by which simulations with fewer may differ.
_ENOUGH, _SAME_SIMULATION = 3000, 0.1


@dataclass(frozen=True)
class Answer:
    """What is missing.

    Attributes:
        verdict: "none", "law", or "outside": something that no law of the library explains.
        fitted: the laws of the answer, or the nearest ones. probability: of them.
        rivals: others with their probabilities, best first. twins: laws that act the same on these logs.
        experiments: that separate the answer from these.
        parameters: calibrated, by name: value and standard deviation; those of the model alone, if no law.
        places: where an unknown input explains the logs, best first. estimate: w there and the signals.
        gap: root mean square of the held-out residual over the noise, as configured.
        calibrated, remains: the same with calibrated parameters alone, and with the answer.
        closed: share of the gap closed on held-out runs. share: residual over the spread of the logs.
        units: of ports, by name. remarks: what the reader should know. seconds: taken.
    """

    verdict: str
    fitted: Fitted | None
    probability: float
    rivals: list[tuple[Fitted, float]]
    twins: list[Candidate]
    parameters: dict[str, tuple[float, float]]
    places: list[Ranked]
    estimate: dict[str, Any] | None
    gap: float
    calibrated: float
    remains: float
    closed: float
    share: float
    traces: dict[str, Any] = field(default_factory=dict)
    experiments: list[Experiment] = field(default_factory=list)
    units: dict[str, str] = field(default_factory=dict)
    remarks: list[str] = field(default_factory=list)
    seconds: float = 0.0


class _Search:
    """One study's search."""

    def __init__(self, runs: Runs, progress: Callable[[str], None]) -> None:
        self.runs, self.model, self.progress = runs, runs.model, progress
        self.study = runs.model.study
        self.base = polished(runs, (), runs.model.nominal)
        constants = self.base.constants, self.base.covariance
        self.nothing = Fitted((), np.zeros(0), np.zeros(0), 0.0, constants)
        # Where laws are tried from. Parameters that leave their tolerances imitate a law: then also without.
        self.begins = [(self.nothing, self.base)]
        if self.far(self.base.constants):
            near = self.limited(self.base.constants, 1.0)
            self.begins.append((self.nothing, polished(runs, (), near, self.base.starts, fixed=True)))
        self.places = runs.model.places()
        self.twins: dict[str, list[Candidate]] = {}

    def scores(self, beside: tuple[Fitted, Polished], late: bool = False) -> Scores:
        """Laws beside some that are fitted."""
        laws = [one.inserted for one in beside[0].laws]
        made = scored(
            self.runs, self.places, laws, beside[1].constants, beside[1].starts, late=late
        )  # fmt: skip
        self.twins |= {one.name: twins for one, twins in zip(made.candidates, made.twins, strict=True)}
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
        """Whether some laws leave little more than the noise, or close nearly all of the gap."""
        if not found:
            return False
        least = min((one for _, one in found), key=lambda one: one.remains)
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
            return abs(value) <= number.most * spread[signal] and (inside or not number.within)

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
            if explained:
                break
        return sorted(found, key=lambda each: each[1].remains)

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
            for one, two in ranked[:kept] if two.remains < near
        ])  # fmt: skip
        # Exact derivatives see the corners of a law, but cost most.
        least = min((two.remains for _, two in ended), default=np.inf)
        exact = self._fits(
            (
                (one.laws, two.constants, two.starts)
                for one, two in ended if _EXPLAINED < two.remains < _CLOSE * least
            ),
            _EXACT, None, exact=True,
        )  # fmt: skip
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
                for one in readable(self.model, law.place)
                if one.law.linear and one.law is not law.law and one.signal == law.signal
                and len(one.law.numbers) == len(best.numbers)
                for constants in (begin, other)
            ),
            _MANY, None,
        )  # fmt: skip

    def to_the_end(
        self, laws: Sequence[Candidate], constants: Array, starts: Sequence[Array]
    ) -> tuple[Fitted, Polished]:
        """A fit carried on with all samples."""
        made = self.fitted(laws, constants, starts, _MANY, None)
        if made[1].remains > _EXPLAINED:
            # Calibration without the law may have led the fit astray, and to other start states.
            fresh = np.r_[self.model.nominal, [value for law in laws for value in law.numbers]]
            other = self.fitted(laws, fresh, [each[3] for each in self.runs.data])
            if other[1].remains < made[1].remains:
                return self.fitted(laws, other[1].constants, other[1].starts, _MANY, None)
        return made

    def filtered(self) -> list[tuple[Fitted, Polished]]:
        """Laws read off an unknown input and fitted in the filter, for systems that open simulations lose.

        The filter follows the logs where a simulation diverges, as of a pendulum that turns over.
        """
        found: list[tuple[Fitted, Polished]] = []
        best: Fitted | None = None
        values = sum(int((~np.isnan(one[2])).sum()) for one in self.runs.data)
        for _ in range(2):
            self.progress("unknown input")
            laws = [] if best is None else [one.inserted for one in best.laws]
            priors = [] if best is None else [(v, abs(v)) for v in best.numbers.tolist()]
            _, places = rank(self.runs, None, laws, priors)
            if not places or places[0].gain < _LEAST:
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
        if best is not None:
            relatives = [one for one in self._relatives(best) if np.isfinite(one.loglik)]
            found += in_parallel([partial(self._simulated, one) for one in relatives])
        return sorted(found, key=lambda each: each[1].remains)

    def _simulated(self, one: Fitted) -> tuple[Fitted, Polished]:
        """A fit of the simulation, which begins with a filter's numbers and start states."""
        starts = likely(self.runs, [law.inserted for law in one.laws], one.constants[0])
        return self.fitted(one.laws, one.constants[0], starts, 10, None)

    def _relatives(self, best: Fitted) -> Iterator[Fitted]:
        """The same laws, each in turn replaced by one of its family, as a lag by a delay."""
        for k, (law, values, _) in enumerate(best.by_law()):
            for other in _relatives(self.model, law, values):
                yield fit(self.runs, (*best.laws[:k], other, *best.laws[k + 1 :]), None, best.numbers)

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
             + sum(np.log(law.law.odds) for law in one.laws))
            for one, two in best if np.isfinite(two.remains)
        ]  # fmt: skip
        return sorted(weighed, key=lambda each: each[2], reverse=True)

    def searched(self) -> list[tuple[Fitted, Polished]]:
        """Fits of all stages: no law, single laws, rarer ones, pairs, and what a filter reads."""
        every = [(self.nothing, self.base)]
        if self.base.remains <= 1.0:
            return every
        self.progress("laws")
        scores = [self.scores(begin) for begin in self.begins]
        tried = [
            fit
            for begin, some in zip(self.begins, scores, strict=True)
            for fit in self.tried([[one] for one in spread_out(some.candidates, _TRIED, _EACH)], begin)
        ]
        singles = self.finished(tried, _KEPT)
        every += singles
        if not self.explained(every):
            self.progress("rarer laws")
            tried = [
                fit
                for begin in self.begins
                for fit in self.tried(
                    [[one] for one in spread_out(self.scores(begin, late=True).candidates, _LATE, 1)], begin
                )
            ]
            rare = self.finished(tried, _LATE_KEPT)
            every += rare
            singles = _unlike([*singles, *rare])
        if not self.explained(every) and (not singles or singles[0][1].remains > _SECOND):
            self.progress("pairs of laws")
            pairs = self.finished(self._pairs(scores, singles), _KEPT)
            if pairs and not self.explained(pairs):
                pairs = self.finished([*pairs, *self._alike(*pairs[0])], _KEPT)
            every += [*pairs, *self.finished(self.alone(pairs), _KEPT)]
        every += self.within_tolerance(every)
        lost = self.base.remains > _LOST * _spread(self.runs)
        if self.model.filters and lost and not self.explained(every):
            every += self.filtered()
        return every

    def _alike(self, best: Fitted, found: Polished) -> list[tuple[Fitted, Polished]]:
        """A pair with each law in turn replaced: by one that alone acts the same, or by one of its family."""
        return self._fits(
            ((*best.laws[:k], two, *best.laws[k + 1 :]), found.constants, found.starts)
            for k, (one, values, _) in enumerate(best.by_law())
            for two in [
                *[each for each in self.twins.get(one.name, ()) if each.law is one.law][:_BESIDE],
                *_relatives(self.model, one, values),
            ]
        )

    def _pairs(
        self, scores: Sequence[Scores], singles: Sequence[tuple[Fitted, Polished]]
    ) -> list[tuple[Fitted, Polished]]:
        """Fits of pairs: by their scores, beside the best single laws, rarer laws beside the best.

        Args:
            scores: of single laws, from each begin. singles: best first.
        """
        found = [
            fit
            for begin, some in zip(self.begins, scores, strict=True)
            for fit in self.tried(some.pairs(_BESIDE), begin)
        ]
        for one in _families(singles)[:_BEAM]:
            if not self.explained(found):
                more = self.scores(one).candidates
                found += self.tried([[two] for two in more if two.law.states == 0][:_BESIDE], one)
        for one in singles[:1]:
            if not self.explained(found):
                rare = self.scores(one, late=True).candidates
                found += self.tried([[two] for two in spread_out(rare, _BESIDE, 1)], one)
        return found


def answer(study: PortStudy, progress: Callable[[str], None] = lambda _: None) -> Answer:
    """Find what is missing.

    Args:
        progress: takes the name of each stage.
    """
    begin = perf_counter()
    # With many small matrices, threads of BLAS wait for one another.
    with threadpool_limits(1), _model(study) as model:
        progress("calibration")
        model.study = _thinned(model)
        search = _Search(Runs(model, model.study.of(Role.TRAIN, Role.VALIDATION)), progress)
        weighed = search.weighed(search.searched())
        chosen = _simplest(search, weighed)
        progress("judgement")
        return replace(_judged(study, model, search, weighed, chosen), seconds=perf_counter() - begin)


def _model(study: PortStudy) -> StateModel:
    """The system in state form, or as its master simulates it, where components give no access to states."""
    try:
        return StateModel(study)
    except ConfigError:
        return PlayedModel(study)


def _thinned(model: StateModel) -> PortStudy:
    """The study with as few samples as simulate the same, but no fewer than `_ENOUGH`.

    Logs are often sampled much faster than the system moves.
    """
    study = model.study
    if not model.filters:
        return study
    count = sum(map(len, study.of(Role.TRAIN, Role.VALIDATION)))
    whole = _simulated(model)
    missed = _size(
        [
            one - model.logged(run)
            for one, run in zip(whole, model.study.of(Role.TRAIN, Role.VALIDATION), strict=True)
        ],
        model,
    )
    for stride in (32, 16, 8, 4, 2):
        if count < stride * _ENOUGH:
            continue
        model.study = study.every(stride)
        differ = [one - two[::stride] for one, two in zip(_simulated(model), whole, strict=True)]
        if _size(differ, model) < max(_SAME_SIMULATION, 0.03 * missed):
            return model.study
    model.study = study
    return study


def _size(differ: Sequence[Array], model: StateModel) -> float:
    """Root mean square of differences of compared signals, over the noise."""
    return float(np.sqrt(np.nanmean(np.square(np.concatenate(differ) / model.noise))))


def _simulated(model: StateModel) -> list[Array]:
    """Compared signals of the runs as configured."""
    replays = Replays(Runs(model, model.study.of(Role.TRAIN, Role.VALIDATION)), ())
    return [replays.found(k, start, model.nominal) for k, start in enumerate(replays.starts)]


def _relatives(model: StateModel, law: Candidate, numbers: Array) -> list[Candidate]:
    """Laws of the same family that take these numbers, and read the same signal at the same place."""
    return [
        replace(one, numbers=tuple(numbers.tolist()))
        for one in readable(model, law.place)
        if one.law.family == law.law.family and one.law is not law.law and one.signal == law.signal
        and len(one.law.numbers) == len(law.law.numbers)
    ]  # fmt: skip


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


def _simplest(search: _Search, weighed: Sequence[tuple[Fitted, Polished, float]]) -> int:
    """Index of the answer.

    A second law must halve what the best single one leaves, if that is twice the noise or more. So must an
    answer that moves a parameter beyond its tolerance, against the best one that does not. A law that is
    tried late must close as much of what the others leave as any law in its place.
    """
    best: dict[int, int] = {}
    for count in {len(one.laws) for one, _, _ in weighed}:
        ranked = [
            k for k, (one, _, _) in enumerate(weighed)
            if len(one.laws) == count and _significant(one)
        ]  # fmt: skip
        if not ranked:
            continue
        usual = [k for k in ranked if not any(law.law.late for law in weighed[k][0].laws)]
        share = _HALF if count == 2 else _THIRD
        if usual and closed(weighed[usual[0]][1].remains, weighed[ranked[0]][1].remains, 0.0) <= share:
            ranked = usual
        near = [k for k in ranked if not search.far(weighed[k][1].constants)]
        best[count] = (near or ranked)[0]
        if near and closed(weighed[near[0]][1].remains, weighed[ranked[0]][1].remains, 0.0) > _HALF:
            best[count] = ranked[0]
    chosen = best[0]
    for count in (1, 2):
        if count in best:
            before, after = weighed[chosen], weighed[best[count]]
            gain = after[2] - before[2]
            share = _HALF if count == 2 else _THIRD
            if count == 2 and len(before[0].laws) == 1 and before[1].remains < _SECOND:
                continue
            if gain > _LEAST and closed(before[1].remains, after[1].remains, 0.0) >= share:
                chosen = best[count]
    return chosen


def _significant(one: Fitted) -> bool:
    """Whether the first number of each of two laws differs from 0 by more than three standard deviations."""
    return len(one.laws) < 2 or all(abs(values[0]) > 3.0 * sigmas[0] for _, values, sigmas in one.by_law())


def _judged(
    study: PortStudy, model: StateModel, search: _Search, weighed: Sequence[tuple[Fitted, Polished, float]],
    chosen: int,
) -> Answer:  # fmt: skip
    """The answer, judged on held-out runs with all their samples."""
    best, found, _ = weighed[chosen]
    model.study = study
    held = Runs(model, study.of(Role.HELDOUT) or study.of(Role.VALIDATION, Role.TRAIN))
    gap = replayed(held, (), model.nominal, as_configured=True)
    calibrated = replayed(held, (), search.base.constants)
    judged = (
        replayed(held, [one.inserted for one in best.laws], best.constants[0]) if best.laws else calibrated
    )
    traces = _traces(model, held, gap, calibrated, judged)
    share = found.remains / _spread(search.runs)
    before = calibrated.remains
    if best.laws and search.far(search.base.constants):
        before = replayed(held, (), search.limited(search.base.constants)).remains
    verdict, remarks = _verdict(search, best, closed(before, judged.remains), share)
    wrong = _WRONG_FAR if best.laws and judged.remains > _NEAR_NOISE else _WRONG_NEAR
    probability, rivals = _rivals(search, weighed, chosen, 1.0 - wrong)
    if verdict == "outside":
        probability = min(probability, _OUTSIDE)
    constants = best.constants if verdict == "law" else (search.base.constants, search.base.covariance)
    values, variances = constants[0], np.abs(np.diag(constants[1]))
    parameters = {
        str(port): (float(values[k]), float(np.sqrt(variances[k]))) for k, port in enumerate(model.parameters)
    }
    remarks += [
        f"{model.parameters[k]} leaves its tolerance: {values[k]:.4g} instead of {model.nominal[k]:.4g}."
        for k in search.far(values)
    ]
    named = best if best.laws else None
    if verdict == "outside" and named is None:
        named, hint = _nearest(held, weighed, calibrated.remains)
        remarks += hint
    twins = [two for one in best.laws for two in search.twins.get(one.name, [])]
    probability *= _among(best, search.twins)
    places, estimate = _estimate(search) if verdict == "outside" and model.filters else ([], None)
    remains = judged.remains if verdict == "law" else calibrated.remains
    units = {str(port): study.unit(port) for port in (*model.states, *model.inputs, *model.outputs)}
    return Answer(
        verdict, named, probability, rivals, twins, parameters, places, estimate,
        gap.remains, calibrated.remains, remains, closed(gap.remains, remains), share, traces,
        _experiments(search, weighed, chosen, rivals) if verdict == "law" else [], units, remarks,
    )  # fmt: skip


def _verdict(search: _Search, best: Fitted, shrunk: float, share: float) -> tuple[str, list[str]]:
    """Verdict and remarks.

    Args:
        shrunk: share of the gap, calibrated within the tolerances, that the answer closes on held-out runs.
        share: residual of the answer over the spread of the logs.
    """
    remains = search.base.remains
    if best.laws and shrunk < 0.5:
        return "outside", [
            "The held-out runs contradict the nearest law: it closes less than half of the gap there."
        ]
    if best.laws:
        return "law", []
    if remains > 2.0 and share > _SMALL:
        return "outside", []
    if remains > 2.0:
        return "none", [
            f"The calibrated model leaves {remains:.3g} times the noise, {100 * share:.2g} % of the signals' "
            "spread. No law of the library explains it."
        ]
    return "none", []


def _nearest(
    held: Runs, weighed: Sequence[tuple[Fitted, Polished, float]], calibrated: float
) -> tuple[Fitted | None, list[str]]:
    """The likeliest laws, although they explain too little, and a remark; none that held-out runs refuse."""
    found = next(((one, two) for one, two, _ in weighed if one.laws and _significant(one)), None)
    if found is None:
        return None, []
    one, fit = found
    share = closed(calibrated, replayed(held, [law.inserted for law in one.laws], fit.constants).remains)
    if share < _HINT:
        return None, []
    names = " + ".join(law.name for law in one.laws)
    return one, [f"The nearest laws close {100 * share:.0f} % of the calibrated gap there: {names}."]


def _among(best: Fitted, twins: Mapping[str, Sequence[Candidate]]) -> float:
    """Share of the answer among laws that act the same on these logs, each once at a component."""
    share = 1.0
    for one in best.laws:
        odds = odds_of([one, *twins.get(one.name, ())])
        share *= odds[one.law.name] / sum(odds.values())
    return share


def _rivals(
    search: _Search, weighed: Sequence[tuple[Fitted, Polished, float]], chosen: int, trust: float
) -> tuple[float, list[tuple[Fitted, float]]]:
    """Probability of the answer among those with as many laws, and the others with theirs.

    Args:
        trust: probability that one of them is right.
    """
    best, _, evidence = weighed[chosen]
    same = [one for one in weighed if len(one[0].laws) == len(best.laws)]
    # Rivals that need a parameter beyond its tolerance, where the answer does not, are no rivals.
    same = [one for one in same if one[2] <= evidence or not search.far(one[1].constants)]
    weights = np.exp(np.clip([(nats - evidence) / _TEMPERATURE for *_, nats in same], -700.0, 0.0))
    weights = (trust * weights / weights.sum()).tolist()
    # The same laws at other places of the same components are the same answer.
    merged: dict[tuple[tuple[str, int], ...], list[Any]] = {}
    for (one, *_), weight in sorted(zip(same, weights, strict=True), key=lambda each: each[0][0] is not best):
        merged.setdefault(_alias(one), [one, 0.0])[1] += weight
    probability = merged.pop(_alias(best))[1]
    others = [(one, weight) for one, weight in merged.values() if one.laws]
    return probability, sorted(others, key=lambda each: -each[1])


def _alias(one: Fitted) -> tuple[tuple[str, int], ...]:
    """Laws and the components where they act."""
    return tuple(sorted((law.law.name, law.place.component) for law in one.laws))


def _experiments(
    search: _Search, weighed: Sequence[tuple[Fitted, Polished, float]], chosen: int,
    rivals: Sequence[tuple[Fitted, float]],
) -> list[Experiment]:  # fmt: skip
    """What separates the answer from likely rivals, and from laws that act the same on these logs."""
    search.model.study = search.study
    best, found, _ = weighed[chosen]
    likely = {id(one) for one, chance in rivals[:_RIVALS] if chance > _LIKELY}
    others = [Simulable(one.laws, two.constants, two.starts) for one, two, _ in weighed if id(one) in likely]
    for k, law in enumerate(best.laws):
        for twin in search.twins.get(law.name, [])[:_RIVALS]:
            constants = found.constants
            if twin.law is not law.law:
                at = len(search.model.nominal) + sum(len(one.law.numbers) for one in best.laws[:k])
                constants = np.r_[constants[:at], twin.numbers, constants[at + len(law.law.numbers) :]]
            laws = (*best.laws[:k], twin, *best.laws[k + 1 :])
            others.append(Simulable(laws, constants, found.starts))
    return separating(search.runs, Simulable(best.laws, found.constants, found.starts), others)


def _estimate(search: _Search) -> tuple[list[Ranked], dict[str, Any] | None]:
    """Where an unknown input explains the logs, and w at the first of these places."""
    search.model.study = search.study
    _, places = rank(search.runs)
    made = smoothed_at(search.runs, places[0]) if places else []
    return places, {**made[0], "names": search.model.signals_of(places[0].place)} if made else None


def _spread(runs: Runs) -> float:
    """Spread of what is logged, over the noise."""
    parts = [np.nanstd(logged, axis=0) / runs.model.noise for _, _, logged, _ in runs.data]
    return float(np.sqrt(np.mean(np.square(parts))))


def _traces(model: StateModel, held: Runs, *judged: Any) -> dict[str, Any]:
    """The worst held-out run and signal: time, measured, as configured, calibrated, with the answer."""
    errors = [
        np.nanmean(np.nan_to_num(np.square((found - logged) / model.noise), nan=-1.0, posinf=1e300), axis=0)
        for found, (_, _, logged, _) in zip(judged[1].found, held.data, strict=True)
    ]  # fmt: skip
    run, signal = np.unravel_index(int(np.nanargmax(errors)), (len(held.data), len(model.compared)))
    time = np.arange(len(held.data[run][2])) * model.study.interval
    port = model.compared[signal]
    kinds = ("configured", "calibrated", "corrected")
    return {
        "run": held.runs[run].name, "signal": str(port), "unit": model.study.unit(port), "time": time,
        "measured": held.data[run][2][:, signal],
        **{name: one.found[run][:, signal] for name, one in zip(kinds, judged, strict=True)},
    }  # fmt: skip
