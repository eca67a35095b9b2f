"""Fit laws by simulations, and judge the fits."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.parallel import in_parallel
from .held_out_replay import closed
from .law_fit import Candidate, Fitted
from .laws import Number
from .places import STEP_ERROR, Runs
from .polish import Polished, Replays, polished
from .score import SAMPLES

Array = NDArray[np.float64]
# Steps of a fit that is tried. Sets of laws that are fitted before one that explains the logs ends the trial.
_STEPS, _RIVALS = 5, 4
# Fits between two looks at the limit of work.
_TOGETHER = 8
# Steps of a fit to the end, and of one by exact derivatives for all that leave so many times the least.
MANY, _EXACT, _CLOSE = 12, 6, 1.15
# By how much steps are divided at most.
_FINEST = 8
# Fits that leave more than this many times the best are not carried on.
_BEHIND = 1.6
# The logs are explained where this much of the noise is left, and it forgets itself within so many samples,
# or where this share of the gap is closed.
_EXPLAINED, _WHITE, _MOST = 1.1, 2.0, 0.995
# Tolerances by which a parameter may change before an answer needs a reason for it.
_FAR = 3.0
# Share of a signal's range below which a threshold is none.
_EDGE = 0.05


class Fit(NamedTuple):
    """Laws, and the simulation with the numbers that suit them best."""

    fitted: Fitted
    polished: Polished

    @property
    def laws(self) -> tuple[Candidate, ...]:
        """The laws."""
        return self.fitted.laws

    @property
    def remains(self) -> float:
        """Root mean square of the residual over the noise."""
        return self.polished.remains


class Weighed(NamedTuple):
    """A fit and its evidence [nats]."""

    fitted: Fitted
    polished: Polished
    evidence: float


class Fits:
    """Fits of laws to the runs of one study.

    Attributes:
        base: calibration without a law. nothing: that as an answer.
        left_out: stages that the limit of work left out.
    """

    def __init__(self, runs: Runs) -> None:
        self.runs, self.model, self.study = runs, runs.model, runs.model.study
        self.samples = runs.affordable(SAMPLES)
        self.base = polished(runs, (), runs.model.nominal, samples=self.samples)
        runs.tone = Replays(runs, (), starts=self.base.starts).tone(self.base.constants)
        constants = self.base.constants, self.base.covariance
        self.nothing = Fitted((), np.zeros(0), np.zeros(0), 0.0, constants)
        self.left_out: list[str] = []
        # Fits that were carried on to the end, and are not again.
        self._ended: list[Fitted] = []
        # What the best fit leaves, by the number of laws.
        self._least: dict[int, float] = {}

    def fit(
        self,
        laws: Sequence[Candidate],
        constants: Array,
        starts: Sequence[Array],
        steps: int = _STEPS,
        samples: int | None = SAMPLES,
        exact: bool = False,
    ) -> Fit:
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
        fitted = Fitted(tuple(laws), numbers, sigmas, -np.inf, (found.constants, found.covariance))
        return Fit(fitted, found if self._sound(fitted) else replace(found, remains=np.inf))

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

    def _fit_beside(self, laws: Sequence[Candidate], beside: Fit) -> Fit:
        """Laws beside those that are fitted, from what suits these, or what suits the law by its score."""
        before = beside.polished
        numbers = [value for law in laws for value in law.numbers]
        begins = [(before.constants, before.starts)]
        if len(laws) == 1 and laws[0].beside is not None:
            begins.append(laws[0].beside)
        every = (*beside.laws, *laws)
        inserted = [one.inserted for one in every]

        def left(begin: tuple[Array, list[Array]]) -> float:
            residual = Replays(self.runs, inserted, SAMPLES, begin[1]).residual(np.r_[begin[0], numbers])
            return float(residual @ residual)

        constants, starts = min(begins, key=left) if len(begins) > 1 else begins[0]
        return self.fit(every, np.r_[constants, numbers], starts)

    def fit_each(
        self, begins: Iterable[tuple[Sequence[Candidate], Array, Sequence[Array]]], *options: Any, **more: Any
    ) -> list[Fit]:
        """Fits, each from laws, constants and start states, up to the limit of work; see `fit`."""
        return self._each([partial(self.fit, *one, *options, **more) for one in begins])

    def _each(self, tasks: list[Callable[[], Fit]]) -> list[Fit]:
        """Fits side by side, up to the limit of work."""
        found: list[Fit] = []
        while tasks:
            found += in_parallel(tasks[:_TOGETHER])
            tasks = tasks[_TOGETHER:]
            if tasks and not self.allowed("further fits"):
                break
        return found

    def fit_beside(self, sets: Sequence[Sequence[Candidate]], beside: Fit) -> list[Fit]:
        """Fit each set of laws beside those that are fitted, by a few steps; best first."""
        found: list[Fit] = []
        for begin in range(0, len(sets), _RIVALS):
            explained = self.explained(found)
            found += self._each([
                partial(self._fit_beside, laws, beside) for laws in sets[begin : begin + _RIVALS]
            ])  # fmt: skip
            # The sets come in the order of their scores. Where one explains the logs, a few rivals suffice.
            if explained or not self.model.effort.allows():
                break
        return sorted(found, key=lambda fit: fit.remains)

    def finish(self, found: Sequence[Fit], kept: int) -> list[Fit]:
        """Fits by a few steps, and the best of them carried on to the end; the best of each set of laws."""
        if not found:
            return []
        ranked = best_of_each(found)
        near = _BEHIND * ranked[0].remains
        ended = in_parallel([
            partial(self._fit_to_the_end, fitted.laws, polished.constants, polished.starts)
            for fitted, polished in ranked[:kept]
            if polished.remains < near and not any(fitted is each for each in self._ended)
        ])  # fmt: skip
        if not self.allowed("finer steps and exact derivatives"):
            return best_of_each([*found, *ended])
        stepped = in_parallel([
            partial(self.fit, fit.laws, fit.polished.constants, fit.polished.starts, MANY, self.samples)
            for fit in self._close(ended, found) if self._divide_steps(fit)
        ])  # fmt: skip
        # Exact derivatives see the corners of a law, but cost most.
        ended = best_of_each([*ended, *stepped])
        exact = self.fit_each(
            ((fit.laws, fit.polished.constants, fit.polished.starts) for fit in self._close(ended)),
            _EXACT, self.samples, exact=True,
        )  # fmt: skip
        self._ended += [fit.fitted for fit in (*ended, *exact)]
        return best_of_each([*found, *ended, *exact])

    def _close(self, fits: Sequence[Fit], others: Sequence[Fit] = ()) -> list[Fit]:
        """Those that leave nearly as little as the best so far of as many laws, but more than noise."""
        for fit in (*fits, *others):
            count = len(fit.laws)
            self._least[count] = min(fit.remains, self._least.get(count, np.inf))
        return [one for one in fits if _EXPLAINED < one.remains < _CLOSE * self._least[len(one.laws)]]

    def _divide_steps(self, fit: Fit) -> bool:
        """Divide the steps of simulations with laws where half the step changes them; whether it did.

        The model alone sets the step. A corner as of dry friction is faster.
        """
        laws, finer = [one.inserted for one in fit.laws], self.model.finer
        if not self.model.filters or not laws:
            return False
        replays, key = Replays(self.runs, laws, SAMPLES, fit.polished.starts), frozenset(laws)
        begin = most = self.runs.sub_of(laws) // self.runs.sub
        now = replays.residual(fit.polished.constants)
        while most < _FINEST:
            finer[key] = 2 * most
            before, now = now, replays.residual(fit.polished.constants)
            if np.sqrt(np.mean((now - before) ** 2)) < STEP_ERROR:
                break
            most *= 2
        finer[key] = most
        return most > begin

    def _fit_to_the_end(self, laws: Sequence[Candidate], constants: Array, starts: Sequence[Array]) -> Fit:
        """A fit carried on with all samples."""
        fit = self.fit(laws, constants, starts, MANY, self.samples)
        if fit.remains > _EXPLAINED:
            # Calibration without the law may have led the fit astray, and to other start states.
            fresh = np.r_[self.model.nominal, [value for law in laws for value in law.numbers]]
            other = self.fit(laws, fresh, [run[3] for run in self.runs.data])
            if other.remains < fit.remains:
                return self.fit(laws, other.polished.constants, other.polished.starts, MANY, self.samples)
        return fit

    def explained(self, found: Sequence[Fit]) -> bool:
        """Whether some laws leave little more than the noise, or close nearly all of the gap.

        Those that need a parameter beyond its tolerance may lack a second law.
        """
        near = [fit.polished for fit in found if not self.far(fit.polished.constants)]
        if not near:
            return False
        least = min(near, key=lambda polished: polished.remains)
        if least.remains < _EXPLAINED:
            return least.length < _WHITE
        return closed(self.base.remains, least.remains) > _MOST

    def far(self, constants: Array) -> list[int]:
        """Parameters that leave their tolerance."""
        change = np.abs(constants[: len(self.model.nominal)] - self.model.nominal)
        return np.flatnonzero(change > _FAR * self.model.tolerance).tolist()

    def limited(self, constants: Array, tolerances: float = _FAR) -> Array:
        """Parameters, each no more tolerances from its nominal value; by default what needs a reason."""
        most = tolerances * self.model.tolerance
        return np.clip(constants[: len(most)], self.model.nominal - most, self.model.nominal + most)

    def allowed(self, stage: str, evaluations: float = 0.0) -> bool:
        """Whether the limit of effort allows a stage; notes it if not."""
        allowed = self.model.effort.allows(evaluations)
        if not allowed and stage not in self.left_out:
            self.left_out.append(stage)
        return allowed

    def weighed(self, found: Sequence[Fit]) -> list[Weighed]:
        """The best fit of each set of laws with its evidence [nats], best first.

        A residual that remembers `length` samples holds 1 / length of them as evidence.
        """
        best = best_of_each(found)
        least = best[0].polished
        effective = least.samples / least.length

        def evidence(fit: Fit) -> float:
            simulated = fit.polished
            misfit = effective * np.log(max(simulated.remains, 1e-6)) + 0.5 * min(simulated.strain, 1e6)
            size = 0.5 * len(simulated.constants) * np.log(max(effective, 2.0))
            return float(sum(np.log(law.odds) for law in fit.laws) - misfit - size)

        weighed = [Weighed(*fit, evidence(fit)) for fit in best if np.isfinite(fit.remains)]
        return sorted(weighed, key=lambda one: one.evidence, reverse=True)


def best_of_each(found: Sequence[Fit]) -> list[Fit]:
    """The best fit of each set of laws, best first."""
    ranked: dict[tuple[str, ...], Fit] = {}
    for fit in sorted(found, key=lambda fit: fit.remains):
        ranked.setdefault(tuple(sorted(law.name for law in fit.laws)), fit)
    return list(ranked.values())
