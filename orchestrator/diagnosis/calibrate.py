"""Learn what evidence is worth from simulated cases: `python -m orchestrator.diagnosis.calibrate`.

Cases are drawn by the challenge's rig, which is a program of its own; magnitudes go from strong to nearly
none, some hide two effects or none, of some the logs are deformed in ways that no catalogue holds, and some
hide the challenge's known kinds outside the catalogue; its fresh ones are kept for blind checks. First it is
learned how rough rigs are that hide nothing; then, from cases weighed so, what each effect leaves
unexplained since no rig has the catalogue's very form of it, and what log evidence is worth.
"""

from __future__ import annotations

import argparse
import json
import math
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice, product
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize
from threadpoolctl import threadpool_limits

from ..errors import OrchestratorError
from ..provenance import origin
from ..whole_file import write_text
from ..workers import Pool, Work, pool_of
from .answers import Answer, complete
from .calibration import FILE, LEAVES, SET, Calibration, Table, own_gains
from .challenge.draw import SHARES, Plan
from .challenge.hidden import HARDWARE, HIDDEN, SOFTWARE
from .challenge.outside import OUTSIDE
from .challenge.verdict import names
from .hardware import weigh_rig
from .practice import simulated_study
from .rough import learn_roughness, strayed_by_number
from .study import Array

__all__ = [
    "Practice",
    "learn",
    "learn_leaves",
    "learn_sure",
    "learn_unseen",
    "loss",
    "main",
    "practise",
    "simulated_study",
]

# How far the logarithm of each learned number may stray from where it begins: cases are few, and simulated.
# Slopes begin without a reason, and may be next to nothing.
_STRAY, _STEEPER, _FLATTEST = 0.7, 1.0, -4.0
_NUMBERS = tuple(
    name
    for name in Calibration.__dataclass_fields__
    if name not in ("slopes", "sure", "surely", "unseen", "leaves", "roughness")
)
# Where the learning of `Calibration.form` begins.
_FORM = 1.0
# Sets of answers hold no more of the probability.
_SUREST, _FOLDS = 0.995, 5
# Magnitude below which hardly any effect is seen.
_FAINT = 0.08
# See `learn_unseen`.
_USUAL = 3.0
# See `learn_leaves`: log evidence from which more of it does not make a case count more, and as how much of
# it what is usual counts [nats]; and the largest share that a form leaves: more is another failure.
_TELLING, _FEW, _LARGEST = 1e4, 300.0, 0.1
# Magnitudes at which each effect is practised on besides, so that what it leaves shows.
_FORMS = (1.0, 0.5)
# How often each known kind outside the catalogue is practised on, and the magnitudes that it has then.
_TIMES, _FROM, _TO = 3, 0.03, 1.2


@dataclass(frozen=True)
class Practice:
    """What weighing gave for a simulated case.

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
        """What it hides, as in `draw.Plan`."""
        if self.truth == ("outside",):
            return "outside"
        return ("none", "single", "pair")[len(self.truth)]

    def right(self, answer: Answer) -> bool:
        """Whether an answer names what is hidden, ties as declared."""
        return names(answer.effects, answer.ties, self.truth)


def practise(
    seed: int, roughness: Mapping[str, Sequence[float]], number: int, plan: Plan | None = None
) -> Practice:
    """Weigh one simulated case; plan as that of `practice.simulated_case`."""
    study, plan = simulated_study(seed, number, plan=plan)
    with threadpool_limits(limits=1, user_api="blas"):
        group = weigh_rig(study, rough=roughness)
    answers = tuple(
        replace(
            one,
            gain=float(one.gain),
            left=float(one.left),
            random=float(one.random),
            numerics=float(one.numerics),
            size=float(one.size),
            parts=tuple(map(float, one.parts)),
            fit=None,
            noises=(),
        )
        for one in group.answers
    )
    truth = ("outside",) if plan.kind == "outside" else tuple(sorted(one.id for one in plan.effects))
    return Practice(truth, plan.magnitude, answers, float(group.outside))


@dataclass(frozen=True)
class _Lesson:
    """Practised cases in arrays, each of shape (cases, answers): answers that differ by names only are one.

    Attributes:
        of: rarity is that of all answers that are one; outside is not among them.
        beside: see `Practice`, shape (cases,).
        alike: how many answers are one, outside the last.
        right: the right ones' share of the rarity's exponential; rights: how many they are, outside the last.
    """

    of: Table
    beside: Array
    alike: Array
    right: Array
    rights: Array
    weight: Array

    @staticmethod
    def of_cases(cases: Sequence[Practice], learned: Calibration) -> _Lesson:
        alike: list[dict[tuple[float, ...], list[float]]] = []
        for case in cases:
            outside, own = case.truth == ("outside",), {}
            of = learned.table(case.answers)
            columns = [
                one.tolist()
                for one in (
                    of.gain, of.formed, of.left, of.whole, of.odd, of.astray, of.usual, of.seen, of.unseen,
                    of.strength, *of.lacks.T,
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


def _weights(cases: Sequence[Practice]) -> Array:
    """As if of each kind as many had been drawn as are planned; one on average."""
    kinds = [one.kind for one in cases]
    weight = np.array([SHARES[kind] / kinds.count(kind) for kind in kinds])
    return weight / weight.mean()


def loss(learned: Calibration, cases: Sequence[Practice]) -> float:
    """Mean negative log probability of the truth; ties of an answer count as it."""
    return _Lesson.of_cases(cases, learned).loss(learned) / len(cases)


def learn_unseen(cases: Sequence[Practice], start: Calibration) -> dict[str, float]:
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


def learn_leaves(cases: Sequence[Practice]) -> dict[str, float]:
    """What effects leave unexplained where they are named rightly: see `Calibration.leaves`.

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


def learn(cases: Sequence[Practice], start: Calibration | None = None) -> Calibration:
    """The numbers under which the truth of simulated cases is most probable."""
    start = start or Calibration()
    return replace(_likeliest(cases, start), **learn_sure(cases, start))


def _likeliest(cases: Sequence[Practice], start: Calibration) -> Calibration:
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
    """What was learned of the hardware's effects, for diagnoses that know of the software's, too.

    An effect is as likely one of software as any other, and that shows at any size: by so much fewer stay
    unseen than on rigs that hide hardware's alone.
    """
    fewer = math.log(len(HIDDEN) / len(HARDWARE))
    return replace(learned, hidden=learned.hidden + fewer, beside=learned.beside + fewer)


def learn_sure(cases: Sequence[Practice], start: Calibration) -> dict[str, float]:
    """`Calibration.sure` and `surely`, by name; of each fifth of the cases by what the others teach."""
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


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw cases, weigh them, learn, and write the calibration that comes with the product."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=300)
    parser.add_argument("--bare", type=int, default=40, help="rigs that hide nothing, for the roughness")
    parser.add_argument("--forms", type=int, help="cases of one clear effect each; by default, two of each")
    parser.add_argument(
        "--kinds",
        metavar="N|all",
        help="of the known kinds outside the catalogue, the first N, or all; by default, those of the "
        "calibration that comes with the product",
    )
    parser.add_argument("--seed", type=int, default=20261)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--seen", type=Path, help="keep weighed cases here, and go on from those there")
    parser.add_argument("--scheduler", metavar="tcp://HOST:PORT", help="a Dask cluster that weighs")
    parser.add_argument("--out", type=Path, default=FILE, help="by default, what comes with the product")
    options = parser.parse_args(arguments)
    made_of = {"seed": options.seed, "bare": options.bare}
    seen: dict[str, Any] = {"made_of": made_of}
    if options.seen and options.seen.is_file():
        seen = json.loads(options.seen.read_text("utf-8"))
        if seen.get("made_of") != made_of:
            told = f"{options.seen} is of {seen.get('made_of')}, not of {made_of}"
            parser.error(f"--seen: {told}: name another file")
    try:
        kinds = _chosen_kinds(options.kinds)
    except OrchestratorError as error:
        parser.error(str(error))
    pool = pool_of(options.scheduler, options.jobs)
    if "roughness" not in seen:
        bare = _outcomes(pool, Work(strayed_by_number, payload=options.seed + 1), range(1, options.bare + 1))
        seen["roughness"] = dict(learn_roughness([one for _, one in sorted(bare, key=lambda one: one[0])]))
        print(seen["roughness"], flush=True)

    def weighed(kind: str, work: Work, tasks: Mapping[int, Any]) -> list[Practice]:
        """Cases of a kind by their numbers, with those kept before; each is kept as soon as it is weighed."""
        done = {int(number): _read(data) for number, data in seen.get(kind, {}).items()}
        numbers = {task: number for number, task in tasks.items() if number not in done}
        for task, one in _outcomes(pool, work, list(numbers)):
            done[numbers[task]] = one
            if options.seen:
                seen.setdefault(kind, {})[str(numbers[task])] = _written(one)
                write_text(options.seen, json.dumps(seen))
            print(f"{kind} {len(done)}/{len(tasks)}", flush=True)
        return [done[number] for number in sorted(done)]

    rough = seen["roughness"]
    numbers = {number: number for number in range(1, options.cases + 1)}
    cases = weighed("cases", Work(_practised, payload=(options.seed, rough)), numbers)
    every = product(sorted(one.id for one in HARDWARE), _FORMS)
    plans = {number: (number, *one) for number, one in enumerate(islice(every, options.forms), start=1)}
    formed = weighed("forms", Work(_hiding, payload=(options.seed + 2, rough)), plans)
    odd = weighed("odd", Work(_hiding, payload=(options.seed + 3, rough)), _of_kinds(kinds))
    leaves = learn_leaves([*cases, *formed])
    learned = learn([*cases, *odd], Calibration(form=_FORM, leaves=leaves, roughness=rough))
    learned.save(
        options.out,
        cases=len(cases),
        odd=len(odd),
        kinds=kinds,
        bare=options.bare,
        forms=len(plans),
        seed=options.seed,
        loss=round(loss(learned, cases), 4),
        **{name: value for name, value in origin().items() if name != "platform"},
    )
    print(learned)


def _practised(context: tuple[int, Mapping[str, Sequence[float]]], number: int) -> Practice:
    return practise(*context, number)


def _hiding(context: tuple[int, Mapping[str, Sequence[float]]], task: tuple[int, str, float]) -> Practice:
    number, name, magnitude = task
    kind = "outside" if name in OUTSIDE else "single"
    return practise(*context, number, Plan(kind, ((HIDDEN | OUTSIDE)[name],), magnitude))


def _chosen_kinds(asked: str | None) -> list[str]:
    """Kinds outside the catalogue to practise on, of those that are known, by id.

    Args:
        asked: "all", or how many; None for those of the calibration that comes with the product: it is then
            learned alike when more are known.
    Raises: OrchestratorError for anything else, and if one of those is not known.
    """
    known = sorted(name for name, kind in OUTSIDE.items() if kind.place not in SOFTWARE)
    if asked is None:
        learned = json.loads(FILE.read_text("utf-8"))["provenance"]["kinds"]
        if strange := sorted(set(learned) - set(known)):
            raise OrchestratorError(
                f"{FILE.name}: learned from {', '.join(strange)}, which the challenge does not know: "
                "--kinds all practises on those that it knows"
            )
        return list(learned)
    if asked == "all":
        return known
    if not asked.isdecimal():
        raise OrchestratorError(f"--kinds: {asked!r}; allowed: all, or 0 to {len(known)}")
    return known[: int(asked)]


def _of_kinds(kinds: Sequence[str]) -> dict[int, tuple[int, str, float]]:
    """Cases of kinds outside the catalogue, from strong to nearly none.

    What a kind's cases are does not depend on which others there are.
    """
    plans = {}
    for name in kinds:
        first = zlib.crc32(name.encode())
        rng = np.random.default_rng(first)
        for time in range(_TIMES):
            share = (time + rng.random()) / _TIMES
            plans[first + time] = (first + time, name, float(_FROM * (_TO / _FROM) ** share))
    return plans


def _outcomes(pool: Pool, work: Work, numbers: Sequence[Any]) -> Iterator[tuple[Any, Any]]:
    """Tasks and what became of them. Raises: OrchestratorError if one failed."""
    for outcome in pool.outcomes(work, numbers):
        if outcome.failure is not None:
            raise OrchestratorError(f"simulated case {outcome.task}: {outcome.failure.message}")
        yield outcome.task, outcome.value


def _written(one: Practice) -> list[Any]:
    """Without answers of two unseen effects, which `_read` adds again."""
    answers = [
        [a.effects, a.gain, a.left, a.ties, a.unseen, a.odd, a.random, a.numerics, a.size, a.parts]
        for a in one.answers
        if len(a.unseen) < 2
    ]
    return [one.truth, one.magnitude, answers, one.beside]


def _read(data: list[Any]) -> Practice:
    truth, magnitude, answers, beside = data
    made = [
        Answer(
            tuple(effects),
            gain,
            left,
            ties=tuple(ties),
            unseen=tuple(unseen),
            odd=odd,
            random=random,
            numerics=numerics,
            size=size,
            parts=tuple(parts),
        )
        for effects, gain, left, ties, unseen, odd, random, numerics, size, parts in answers
    ]
    ids = [one.effects[0] for one in made if len(one.effects) == 1]
    return Practice(tuple(truth), magnitude, tuple(complete(made, ids)), beside)


if __name__ == "__main__":
    # Workers find functions by the name of their module, which for this one is not __main__.
    from orchestrator.diagnosis import calibrate

    calibrate.main()
