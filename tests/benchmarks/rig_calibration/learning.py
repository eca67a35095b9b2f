"""Learn the map from evidence to probability, from cases whose truth is known."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize

from orchestrator.diagnosis.rig.answers import Answer
from orchestrator.diagnosis.rig.calibration import LEAVES, SET, Calibration, Table, own_gains
from orchestrator.diagnosis.rig.challenge.draw import SHARES
from orchestrator.diagnosis.rig.challenge.hidden import HARDWARE, HIDDEN
from orchestrator.diagnosis.rig.challenge.verdict import names
from orchestrator.diagnosis.rig.study import Array

__all__ = ["WeighedCase", "learn", "learn_leaves", "learn_sure", "learn_unseen", "loss"]

# Prior standard deviation of the logarithm of each learned number: cases are few, and simulated.
# Slopes begin without a reason, and may be next to nothing.
_STRAY, _STEEPER, _FLATTEST = 0.7, 1.0, -4.0
_NUMBERS = tuple(
    name
    for name in Calibration.__dataclass_fields__
    if name not in ("slopes", "sure", "surely", "unseen", "leaves", "roughness")
)
# Sets of answers hold no more of the probability.
_SUREST, _FOLDS = 0.995, 5
# Magnitude below which hardly any effect is seen.
_FAINT = 0.08
# See `learn_unseen`.
_USUAL = 3.0
# See `learn_leaves`: log evidence from which more of it does not make a case count more, and as how much of
# it what is usual counts [nats]; and the largest share that a form leaves: more is another failure.
_TELLING, _FEW, _LARGEST = 1e4, 300.0, 0.1


@dataclass(frozen=True)
class WeighedCase:
    """Result of weighing a simulated case.

    Attributes:
        truth: ids, ("outside",), or none; magnitude: of the effects.
        answers: none first; without their fits.
        beside: see `Group.outside`.
    """

    truth: tuple[str, ...]
    magnitude: float
    answers: tuple[Answer, ...]
    beside: float

    @property
    def kind(self) -> str:
        """Kind of the hidden effects, as in `draw.Plan`."""
        if self.truth == ("outside",):
            return "outside"
        return ("none", "single", "pair")[len(self.truth)]

    def right(self, answer: Answer) -> bool:
        """Whether an answer names what is hidden, ties as declared."""
        return names(answer.effects, answer.ties, self.truth)


@dataclass(frozen=True)
class _Lesson:
    """Practised cases in arrays, each of shape (cases, answers): answers that differ by names only are one.

    Attributes:
        of: rarity is that of all answers that are one; outside is not among them.
        beside: see `WeighedCase`, shape (cases,).
        alike: how many equal answers each stands for; outside is the last.
        right: the right ones' share of the rarity's exponential; rights: how many they are, outside the last.
    """

    of: Table
    beside: Array
    alike: Array
    right: Array
    rights: Array
    weight: Array

    @staticmethod
    def of_cases(cases: Sequence[WeighedCase], learned: Calibration) -> _Lesson:
        alike: list[dict[tuple[float, ...], list[float]]] = []
        for case in cases:
            outside, own = case.truth == ("outside",), {}
            of = learned.table(case.answers)
            columns = [
                one.tolist()
                for one in (
                    of.gain, of.formed, of.left, of.whole, of.nonrandom, of.replay_error, of.usual, of.seen,
                    of.unseen, of.strength, *of.excess.T,
                )
            ]  # fmt: skip
            spread = np.exp(-of.rarity).tolist()
            for *key, weight, answer in zip(*columns, spread, case.answers, strict=True):
                found = own.setdefault(tuple(key), [0.0, 0.0, 0.0, 0.0])
                right = not outside and case.right(answer)
                found[0] += weight
                found[1] += 1.0
                found[2] += weight * right
                found[3] += right
            alike.append(own)
        shape = len(cases), max(map(len, alike))
        # What there is no answer for is not probable, and not to be divided by.
        lacking = (0.0,) * len(learned.slopes)
        absent = (-1e290, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, *lacking)
        columns = [np.full(shape, value) for value in absent]
        common, right = np.ones(shape), np.zeros((shape[0], shape[1] + 1))
        count, rights = np.zeros_like(right), np.zeros_like(right)
        for place, own in enumerate(alike):
            size = len(own)
            for target, values in zip(columns, zip(*own, strict=True), strict=True):
                target[place, :size] = values
            weights, counts, right_weights, right_counts = (
                np.array(one) for one in zip(*own.values(), strict=True)
            )
            common[place, :size], count[place, :size] = weights, counts
            right[place, :size], rights[place, :size] = right_weights / weights, right_counts
            count[place, -1] = 1.0
            right[place, -1] = rights[place, -1] = cases[place].truth == ("outside",)
        known = len(columns) - len(lacking)
        table = Table(*columns[:known], -np.log(common), np.stack(columns[known:], axis=-1))
        beside = np.array([one.beside for one in cases])
        return _Lesson(table, beside, count, right, rights, _weights(cases))

    def loss(self, learned: Calibration) -> float:
        """Negative log probability of the truths."""
        scores = np.subtract(*learned.scores(self.of, self.beside))
        even = replace(learned, floor=1.0).spread(scores, self.alike)
        p = replace(learned, floor=0.0).spread(scores)
        # Of answers that are one, right ones have their share; evenly spread, as many as they are.
        found = (1.0 - learned.floor) * p * self.right + learned.floor * even * self.rights / np.maximum(
            self.alike, 1.0
        )
        return -float(self.weight @ np.log(np.maximum(found.sum(-1), 1e-6)))


def _weights(cases: Sequence[WeighedCase]) -> Array:
    """As if of each kind as many had been drawn as are planned; one on average."""
    kinds = [one.kind for one in cases]
    weight = np.array([SHARES[kind] / kinds.count(kind) for kind in kinds])
    return weight / weight.mean()


def loss(learned: Calibration, cases: Sequence[WeighedCase]) -> float:
    """Mean negative log probability of the truth; ties of an answer count as it."""
    return _Lesson.of_cases(cases, learned).loss(learned) / len(cases)


def learn_unseen(cases: Sequence[WeighedCase], start: Calibration) -> dict[str, float]:
    """Of the effects that stay unseen, how many are which: one whose likes calibration explains are many.

    Each effect's share of unseen ones is drawn to that of all by `_USUAL` cases: of each, there are few.
    """
    hidden: dict[str, int] = {}
    missed: dict[str, int] = {}
    for case in cases:
        if case.truth == ("outside",):
            continue
        seen = case.answers[int(np.argmax(np.subtract(*start.scores(case.answers, 0.0))[:-1]))].seen
        for name in case.truth:
            hidden[name] = hidden.get(name, 0) + 1
            missed[name] = missed.get(name, 0) + (name not in seen)
    names = {name for case in cases for one in case.answers for name in one.effects}
    usual = (sum(missed.values()) + 1.0) / (sum(hidden.values()) + 2.0)
    chance = {
        name: (missed.get(name, 0) + _USUAL * usual) / (hidden.get(name, 0) + _USUAL)
        for name in sorted(names)
    }
    whole = sum(chance.values())
    return {name: round(value / whole, 5) for name, value in chance.items()}


def learn_leaves(cases: Sequence[WeighedCase]) -> dict[str, float]:
    """Usual residual evidence of correctly named effects; see `Calibration.leaves`.

    Beyond what rigs leave that hide nothing, and what the replay's own error may make; the shares of all
    cases of an effect, weighted by the log evidence of it beside others, and drawn to what is usual of all
    effects.
    """
    bare = [one.answers[0].left for one in cases if not one.truth]
    ordinary = float(np.quantile(bare, SET)) if bare else 0.0
    found: dict[str, list[tuple[float, float]]] = {}
    for case in cases:
        named = [one for one in case.answers if case.right(one) and not one.unseen and one.gain > 0.0]
        if not named or case.truth in ((), ("outside",)):
            continue
        best = max(named, key=lambda one: one.gain)
        share = min(max(best.left - best.numerics - ordinary, 0.0) / best.gain, _LARGEST)
        own = own_gains(case.answers)[case.answers.index(best)]
        for name in case.truth:
            found.setdefault(name, []).append((min(own.get(name, best.gain), _TELLING), share))
    return {
        name: round(
            (sum(weight * share for weight, share in some) + _FEW * LEAVES)
            / (sum(weight for weight, _ in some) + _FEW),
            6,
        )
        for name, some in sorted(found.items())
    }


def learn(cases: Sequence[WeighedCase], start: Calibration | None = None) -> Calibration:
    """The numbers under which the truth of simulated cases is most probable."""
    start = start or Calibration()
    return replace(_likeliest(cases, start), **learn_sure(cases, start))


def _likeliest(cases: Sequence[WeighedCase], start: Calibration) -> Calibration:
    start = replace(start, unseen=learn_unseen(cases, start))
    lesson = _Lesson.of_cases(cases, start)

    size = len(_NUMBERS)
    deviation = np.array([_STRAY] * size + [_STEEPER] * len(start.slopes))
    bounds = [(-2.5, 2.5)] * size + [(_FLATTEST, 2.5)] * len(start.slopes)

    def learned(x: Array) -> Calibration:
        numbers = {name: getattr(start, name) * math.exp(v) for name, v in zip(_NUMBERS, x, strict=False)}
        return replace(start, **numbers, slopes=tuple(np.multiply(start.slopes, np.exp(x[size:])).tolist()))

    def cost(x: Array) -> float:
        return lesson.loss(learned(x)) + 0.5 * float(np.sum((x / deviation) ** 2))

    none = np.zeros(len(deviation))
    found = minimize(cost, none, method="L-BFGS-B", bounds=bounds, options={"maxiter": 40})
    return _of_all(learned(found.x))


def _of_all(learned: Calibration) -> Calibration:
    """Numbers learned from hardware effects, for diagnoses that include software effects.

    An effect is as likely one of software as any other, and that shows at any size: by so much fewer stay
    unseen than on rigs that hide hardware's alone.
    """
    fewer = math.log(len(HIDDEN) / len(HARDWARE))
    return replace(learned, hidden=learned.hidden + fewer, beside=learned.beside + fewer)


def learn_sure(cases: Sequence[WeighedCase], start: Calibration) -> dict[str, float]:
    """`Calibration.sure` and `surely`, by name; from five-fold cross-validation."""
    needed: dict[str, list[tuple[float, float]]] = {"sure": [], "surely": []}
    weights = _weights(cases)
    for fold in range(_FOLDS):
        learned = _likeliest([one for at, one in enumerate(cases) if at % _FOLDS != fold], start)
        for case, weight in zip(cases[fold::_FOLDS], weights[fold::_FOLDS], strict=True):
            p = learned.probabilities(case.answers, case.beside)
            if not case.truth or case.magnitude >= _FAINT:
                continue
            name = "surely" if case.answers[int(np.argmax(p[:-1]))].seen else "sure"
            outside = case.truth == ("outside",)
            right = np.array([*(not outside and case.right(one) for one in case.answers), outside])
            own = p[right].max(initial=0.0)
            # Of those that are as probable as the truth, half come before it.
            needed[name].append((float(p[p > own].sum() + 0.5 * p[p == own].sum()), float(weight)))

    def enough(some: list[tuple[float, float]]) -> float:
        values, own = np.array(some).T if some else (np.array([SET]), np.ones(1))
        return float(np.quantile(values, SET, weights=own, method="inverted_cdf"))

    return {name: round(min(max(enough(some), SET), _SUREST), 4) for name, some in needed.items()}
