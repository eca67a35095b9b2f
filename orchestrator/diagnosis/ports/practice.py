"""Practice on simulated cases of a study's own system: what its evidence is worth, and how far that is true.

The system, its feeding and its runs are the study's; what is hidden is drawn: nothing, one candidate or two,
from strong to nearly none, or a candidate that is struck from the list, which then is outside of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import minimize

from ...errors import ConfigError, Problem
from ...provenance import origin
from ...system import Port
from ..effect import Effect
from ..study import Array
from .candidates import PortEffect, candidates
from .replay import PortReplay, measure
from .study import PortRun, PortStudy, Role
from .tempering import FORMAT, Tempering
from .weigh import Weighed, weigh_ports

__all__ = ["Case", "coverage", "learn", "practise", "simulated"]

# Kinds of cases and their shares.
_KINDS = {"none": 0.25, "one": 0.45, "two": 0.15, "outside": 0.15}
# Sizes of effects are drawn from so many decades below their prior.
_DECADES = 2.5
# An effect whose whole trace in the logs is worth less is none [nats]; the smallest of two that count.
_SEEN = 3.0
# How far the logarithm of each learned number may stray from where it begins, one standard deviation: cases
# are few, and simulated.
_STRAY = 0.5
_LEARNED = ("temperature", "growth", "price", "left", "sharpness", "floor")
_FOLDS, _FEWEST = 5, 10
_SET = 0.95


@dataclass(frozen=True)
class _Answer:
    effects: tuple[str, ...]
    gain: float
    ties: tuple[str, ...]


@dataclass(frozen=True)
class Case:
    """What weighing gave for a simulated case.

    Attributes:
        truth: ids; ("outside",); or none.
        trace: of what is hidden in the logs [nats].
        answers: none first; candidates: how many there were; share: see `Weighed.share`.
    """

    truth: tuple[str, ...]
    trace: float
    answers: tuple[_Answer, ...]
    candidates: int
    share: float

    def right(self) -> list[bool]:
        """Whether each answer, and last outside, is right, ties as declared."""
        outside = self.truth == ("outside",)
        found = []
        for one in self.answers:
            same = len(one.effects) == len(self.truth) and set(self.truth) - set(one.effects) <= set(one.ties)
            found.append(not outside and same)
        return [*found, outside]


def simulated(
    study: PortStudy, effects: Sequence[Effect], rng: np.random.Generator
) -> tuple[PortStudy, tuple[str, ...], float]:
    """The study with logs of its own system, in which something is hidden.

    Calibrated numbers are drawn by their tolerances. Noise is what does not repeat, from a random place on,
    where runs have repeats, else white as specified.

    Args:
        effects: to draw from.
    Returns: the study, train and validation runs only; what is hidden; its trace in the logs [nats].
    """
    kind = str(rng.choice(list(_KINDS), p=list(_KINDS.values())))
    pool = [one for one in effects if isinstance(one, PortEffect)]
    hidden: list[PortEffect] = []
    for one in (pool[place] for place in rng.permutation(len(pool))):
        if len(hidden) == {"none": 0, "two": 2}.get(kind, 1):
            break
        if all(not one.family or one.family != other.family for other in hidden):
            hidden.append(one)
    theta = np.concatenate([_drawn(one, rng) for one in hidden]) if hidden else np.zeros(0)
    calibrated = {
        name: one.value + one.tolerance * float(np.clip(rng.standard_normal(), -2.5, 2.5))
        for name, one in study.nominal.items()
    }
    given = tuple(port for port in study.fed if port not in study.compared)
    open_study = replace(study, fed=given)
    runs, trace = [], 0.0
    for run in study.of(Role.TRAIN, Role.VALIDATION):
        replay = PortReplay(open_study, [run])
        signals = replay.signals(run, calibrated, tuple(hidden), theta)
        bare = replay.signals(run, calibrated, (), np.zeros(0))
        logs = dict(run.logs)
        for port in replay.compared(run):
            noise = float(study.columns[port].noise or 0.0)
            drawn = _noise(study, port, len(run), noise, rng)
            scale = max(float(drawn.std()), noise)
            trace += 0.5 * float(np.sum(((signals[port] - bare[port])[study.settled :] / scale) ** 2))
            logs[port] = signals[port] + drawn
        runs.append(replace(run, logs=logs))
    truth = tuple(sorted(one.id for one in hidden))
    without = study.without
    if not np.isfinite(trace):
        return simulated(study, effects, rng)
    if kind == "outside":
        # Its whole family is struck: another form of the same cause would be right.
        family = hidden[0].family
        gone = [one.id for one in pool if one.id == hidden[0].id or (family and one.family == family)]
        without, truth = (*without, *gone), ("outside",)
    if trace < _SEEN:
        truth = ()
    return replace(study, runs=tuple(runs), without=without), truth, trace


def _drawn(effect: Effect, rng: np.random.Generator) -> Array:
    """Parameters of an effect: its size log-uniform below the prior's, its shape from the prior."""
    values = []
    for place, one in enumerate(effect.parameters):
        if one.shape or place > 0:
            centre = one.starts[len(one.starts) // 2] if one.starts else one.scale
            value = centre * float(np.exp(0.7 * np.clip(rng.standard_normal(), -2.0, 2.0)))
        else:
            value = one.scale * float(10.0 ** -rng.uniform(0.0, _DECADES))
            value *= -1.0 if one.low < 0.0 and rng.random() < 0.5 else 1.0
        values.append(min(max(value, one.low), one.high))
    return np.array(values)


def _noise(study: PortStudy, port: Port, n: int, specified: float, rng: np.random.Generator) -> Array:
    """Noise of a port's log, shape (n,)."""
    apart = [
        _apart(run, other, port, study.settled)
        for other in study.of(Role.REPEAT)
        for run in study.runs
        if run.name == other.repeats and port in run.logs and port in other.logs
    ]
    if not apart:
        return specified * rng.standard_normal(n)
    one = apart[int(rng.integers(len(apart)))]
    begin = int(rng.integers(len(one)))
    return float(rng.choice([-1.0, 1.0])) * np.resize(np.roll(one, -begin), n)


def _apart(run: PortRun, other: PortRun, port: Port, settled: int) -> Array:
    """What differs between a run and its repeat, as noise of one of them."""
    n = min(len(run), len(other))
    return (run.logs[port][:n] - other.logs[port][:n])[settled:] / np.sqrt(2.0)


def practise(study: PortStudy, count: int, seed: int, progress: Callable[[int], None]) -> dict[str, Any]:
    """Weigh simulated cases of a study, and learn how evidence becomes probabilities.

    Returns: content of practice.json: `tempering`; `coverage` as shipped and as learned, the latter of cases
        that the learning did not see, five times over; `cases`; `seed`; `effects`, ids of the candidates.
    Raises: ConfigError for less than ten cases: they teach nothing.
    """
    if count < _FEWEST:
        raise ConfigError([Problem("practice", f"got {count} cases", f"at least {_FEWEST}")])
    effects = candidates(study, measure(study, study.of(Role.TRAIN)[0]))
    if len(effects) < 2:
        raise ConfigError([Problem("practice", f"got {len(effects)} candidates", "at least 2 to tell apart")])
    cases = []
    for number in range(count):
        rng = np.random.default_rng(np.random.SeedSequence([seed, number]))
        made, truth, trace = simulated(study, effects, rng)
        cases.append(_case(weigh_ports(made), truth, trace))
        progress(number + 1)
    start = Tempering()
    unseen: list[tuple[Case, Tempering]] = []
    for fold in range(_FOLDS):
        others = [one for place, one in enumerate(cases) if place % _FOLDS != fold]
        learned = learn(others, start)
        unseen += [(one, learned) for place, one in enumerate(cases) if place % _FOLDS == fold]
    return {
        "format": FORMAT,
        "tempering": learn(cases, start).data(),
        "coverage": {
            "as shipped": coverage([(one, start) for one in cases]),
            "as learned, on unseen cases": coverage(unseen),
        },
        "cases": [
            {"truth": list(one.truth), "trace": one.trace, "share": one.share,
             "answers": [[list(a.effects), a.gain, list(a.ties)] for a in one.answers]}
            for one in cases
        ],
        "seed": seed,
        "effects": [one.id for one in effects],
        "provenance": origin(),
    }  # fmt: skip


def _case(weighed: Weighed, truth: tuple[str, ...], trace: float) -> Case:
    answers = tuple(_Answer(one.effects, float(one.gain), one.ties) for one in weighed.answers)
    return Case(truth, trace, answers, len(weighed.effects), weighed.share)


def _loss(tempering: Tempering, cases: Sequence[Case]) -> float:
    """Sum of negative log probabilities of the truth."""
    total = 0.0
    for case in cases:
        p = tempering.probabilities(case.answers, case.candidates, case.share)
        right = float(p[np.array(case.right())].sum()) if any(case.right()) else 0.0
        # What no answer held is not the map's fault, and the same for all maps.
        total -= np.log(max(right, 1e-4))
    return total


def learn(cases: Sequence[Case], start: Tempering) -> Tempering:
    """The numbers under which the truth of simulated cases is most probable, near those that come along."""

    def learned(x: Array) -> Tempering:
        stray = {name: getattr(start, name) * float(np.exp(v)) for name, v in zip(_LEARNED, x, strict=True)}
        return replace(start, **stray)

    def cost(x: Array) -> float:
        return _loss(learned(x), cases) + 0.5 * float(np.sum((x / _STRAY) ** 2))

    size = len(_LEARNED)
    found = minimize(
        cost, np.zeros(size), method="Powell", bounds=[(-2.0, 2.0)] * size, options={"maxiter": 10}
    )
    return learned(np.atleast_1d(found.x))


def coverage(told: Sequence[tuple[Case, Tempering]]) -> dict[str, float]:
    """How true probabilities are.

    Returns: `cases`; `covered`, the share of them whose 95 % set of answers holds the truth; `right`, of
        those whose first answer is; `claimed`, the mean probability of the first answers; `false_alarms`,
        the share of cases without anything hidden whose first answer is something.
    """
    covered, right, claimed, alarms, empty = 0, 0, 0.0, 0, 0
    for case, tempering in told:
        p = tempering.probabilities(case.answers, case.candidates, case.share)
        order = np.argsort(-p, kind="stable")
        size = int(np.searchsorted(np.cumsum(p[order]), _SET)) + 1
        is_right = np.array(case.right())
        covered += bool(is_right[order[:size]].any())
        right += bool(is_right[order[0]])
        claimed += float(p[order[0]])
        if case.truth == ():
            empty += 1
            alarms += int(order[0]) != 0
    n = max(len(told), 1)
    return {
        "cases": float(len(told)),
        "covered": covered / n,
        "right": right / n,
        "claimed": claimed / n,
        "false_alarms": alarms / max(empty, 1),
    }
