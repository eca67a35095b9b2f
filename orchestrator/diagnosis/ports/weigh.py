"""Which candidates explain the logs of a system: fitted on train runs, chosen with validation runs, too."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from ...system.connection import Port
from ..answers import Answer, simplest, tied
from ..calibration import SET
from ..effect import Effect, by_effect
from ..finding import Augmented, Candidate, Finding, most_probable
from ..fit import Fit, Fitter
from ..search import Search
from ..study import Array
from ..verdict import Warned
from .apart import components
from .effect import PortEffect
from .noise import structured, understated
from .replay import PortReplay, Weighted, candidates_of
from .seek import sought
from .study import PortStudy, Role
from .tempering import Tempering
from .ties import alike

__all__ = ["Weighed", "foremost", "weigh_ports"]

# Answers that are reported.
_KEPT = 12
# Excess counts where it is this part of the noise at least.
_EXCESS = 0.5
# What is left of a port's excess is of something else where it is this many times the noise's mean square.
_OTHER = 16.0
# Answers of a larger probability say which of their effects counts most.
_WORTH = 0.01
# What a model that runs away leaves of the validation runs beyond others, in squares of the noise.
_RUNAWAY = 1e6
# Tolerances by which a calibrated number may deviate.
_STRAYED = 3.0


@dataclass(frozen=True)
class Weighed:
    """What weighing found.

    Attributes:
        finding: the answers.
        effects: all candidates that were weighed.
        left: share of the excess over noise that the answer leaves, by port; on train and validation.
        share: of the excess of all ports, each as it counts; 0 where there is none.
        weights: of the compared ports' residuals in the fits.
        answers: none first; what they were made probabilities with.
        top: fit of the best of them.
        warned: of noise that is larger than specified.
    """

    finding: Finding
    effects: tuple[Effect, ...]
    left: dict[str, float]
    weights: Mapping[Port, float]
    answers: tuple[Answer, ...]
    tempering: Tempering
    top: Fit
    share: float = 0.0
    warned: tuple[Warned, ...] = ()


def weigh_ports(study: PortStudy, tempering: Tempering | None = None, workers: int = 2) -> Weighed:
    """Find which candidates make a system differ from its logs.

    Effects are fitted on the train runs. An answer's evidence is that of its fit, with each channel weighed
    by what its residuals carry (see `sought`), and what it gains on the validation runs as fitted.

    Args:
        tempering: how evidence becomes probabilities.
        workers: threads, where the system allows more than one.
    """
    effects = candidates_of(study)
    replay, checked = (PortReplay(study, study.of(role)) for role in (Role.TRAIN, Role.VALIDATION))
    with threadpool_limits(limits=1, user_api="blas"):
        workers = workers if replay.player.parallel else 1
        fitter, found = sought(replay, effects, workers)
        assert isinstance(fitter.replay, Weighted)
        by_port = fitter.replay.by_port
        answers = _answers(fitter, found, lambda fit: _squares(checked, by_port, fit), effects, workers)
    made = _Made(study, replay, checked, effects, by_port)
    return _conclude(made, found, answers, tempering or Tempering())


def _squares(replay: PortReplay, weights: Mapping[Port, float], model: Fit | Augmented) -> float:
    """Sum of squares of the weighed residuals; infinite where the model runs away."""
    found = zip(replay.channels, replay.of(model), strict=True)
    total = sum(weights.get(port, 0.0) ** 2 * float(r @ r) for (_, port), r in found)
    return total if math.isfinite(total) else math.inf


def _answers(
    fitter: Fitter, found: Search, check: Callable[[Fit], float], effects: Sequence[Effect], workers: int
) -> list[Answer]:
    """None first, then by falling evidence.

    Args:
        check: sum of squares that a fit leaves of the validation runs.
    """
    before = check(found.none)
    if not math.isfinite(before):
        # Whatever does not run away is better by so much that it does not matter how much.
        before = _RUNAWAY + max(filter(math.isfinite, map(check, found.fits[:_KEPT])), default=0.0)

    def answer(fit: Fit) -> Answer:
        gain = found.gain(fit) + 0.5 * (before - check(fit))
        return Answer(tuple(one.id for one in fit.effects), gain, 0.0, fit)

    made = [one for one in map(answer, found.fits[:_KEPT]) if math.isfinite(one.gain)]
    nothing = Answer((), 0.0, 0.0, found.none)
    kept = tied(fitter, simplest(made))
    if kept and kept[0].gain > 0.0:
        more = alike(fitter, kept[0], effects, workers)
        names = [name for one in more for name in one.alien]
        kept[0] = replace(kept[0], ties=tuple(dict.fromkeys([*kept[0].ties, *names])))
        known = {frozenset(one.effects) for one in kept}
        others = [answer(one.fit) for one in more]
        kept += [one for one in others if frozenset(one.effects) not in known and math.isfinite(one.gain)]
        kept[1:] = sorted(kept[1:], key=lambda one: -one.gain)
    return [nothing, *kept]


def _left(replays: Sequence[PortReplay], fit: Fit, none: Fit) -> tuple[dict[str, float], float]:
    """Share of the excess over noise of the model without effects that one with them leaves.

    Returns: by port; and of all ports. There a port counts by the logarithm of its excess: one that is hardly
        beyond its noise tells little, one that is far beyond does not tell all. At least that of any port at
        which four times the noise is left: what is explained elsewhere does not explain it.
    """
    excess: dict[str, list[tuple[float, float, int]]] = {}
    for replay in replays:
        for (_, port), r, r0 in zip(replay.channels, replay.of(fit), replay.of(none), strict=True):
            excess.setdefault(str(port), []).append((structured(r), structured(r0), len(r)))
    found, counts, worst = {}, {}, 0.0
    for name, parts in excess.items():
        n = sum(part[2] for part in parts)
        left, whole = (sum(part[place] * part[2] for part in parts) / n for place in (0, 1))
        if whole > _EXCESS:
            found[name], counts[name] = left / whole, math.log1p(whole)
            if left > _OTHER:
                worst = max(worst, found[name])
    total = sum(counts.values())
    pooled = sum(found[name] * count for name, count in counts.items()) / total if total else 0.0
    return found, max(pooled, worst)


@dataclass(frozen=True)
class _Made:
    """What answers were found with; `checked` are the validation runs."""

    study: PortStudy
    replay: PortReplay
    checked: PortReplay
    effects: tuple[Effect, ...]
    weights: Mapping[Port, float]


def _conclude(by: _Made, found: Search, answers: list[Answer], tempering: Tempering) -> Weighed:
    replay, effects = by.replay, by.effects
    top = answers[int(np.argmax(tempering.scores(answers, len(effects))))]
    assert top.fit is not None
    left, share = _left((replay, by.checked), top.fit, found.none)
    probabilities = tempering.probabilities(answers, len(effects), share)
    recalibrated = Augmented(found.none.calibrated, (), np.zeros(0))
    made = [_candidate(one, float(p)) for one, p in zip(answers, probabilities[:-1], strict=True)]
    made.append(Candidate(("outside",), float(probabilities[-1]), {}, (), 0.0))
    made.sort(key=lambda one: -one.probability)
    made = [foremost(replay, by.weights, one) if one.probability > _WORTH else one for one in _folded(made)]
    first = made[0]
    # Where least is explained; what stands unlogged before that port may be it as well.
    worst = max(left, key=lambda port: left[port]).partition(".")[0] if left else ""
    chain = next((one for one in components(by.study) if one.places[0] == worst), None)
    places = {one.partition(".")[0] for one in first.effects}
    if first.effects == ("outside",):
        places = set(chain.places) if chain else set()
    # Of an answer with effects its own calibration counts: what they explain needs no other tolerances.
    believed = found.none if first.effects in ((), ("outside",)) else top.fit
    strayed = any(abs(value) > _STRAYED for value in believed.deviation.values())
    residuals: dict[str, list[Array]] = {}
    for (_, port), r in zip(replay.channels, replay.of(top.fit), strict=True):
        residuals.setdefault(str(port), []).append(r)
    squares = {port: float(np.mean(np.concatenate(some) ** 2)) for port, some in residuals.items()}
    misfit = {port: square for port, square in squares.items() if math.isfinite(square)}
    finding = Finding(
        tuple(made),
        first.effects,
        tuple(sorted(places)),
        chain.name if chain and first.effects == ("outside",) else "",
        most_probable(made, SET),
        recalibrated,
        strayed,
        misfit,
        kin={one.id: one.kin for one in effects if isinstance(one, PortEffect) and one.kin is not None},
    )
    warned = tuple(understated(residuals))
    return Weighed(finding, effects, left, by.weights, tuple(answers), tempering, top.fit, share, warned)


def _folded(made: list[Candidate]) -> list[Candidate]:
    """Answers with those that are tied to the first folded into it: apart, each would seem improbable."""
    first, rest = made[0], made[1:]

    def same(one: Candidate) -> bool:
        alien = [name for name in one.effects if name not in first.effects]
        return len(one.effects) == len(first.effects) and all(name in first.ties for name in alien)

    together = first.probability + sum(one.probability for one in rest if same(one))
    return [replace(first, probability=together), *(one for one in rest if not same(one))]


def foremost(replay: PortReplay, weights: Mapping[Port, float], one: Candidate) -> Candidate:
    """An answer whose effects stand in order: without the first of them, runs would fit worst.

    Args:
        weights: of the compared ports' residuals.
    """
    model = one.model
    if model is None or len(one.effects) < 2:
        return one
    parts = dict(by_effect(model.effects, model.theta))

    def square(gone: Effect) -> float:
        kept = [effect for effect in parts if effect is not gone]
        theta = np.concatenate([parts[effect] for effect in kept])
        return _squares(replay, weights, Augmented(model.calibrated, tuple(kept), theta))

    order = sorted(parts, key=square, reverse=True)
    return replace(one, effects=tuple(effect.id for effect in order))


def _candidate(answer: Answer, probability: float) -> Candidate:
    fit = answer.fit
    assert fit is not None
    parameters = {
        f"{effect.id}.{one.name}": value
        for effect, own in by_effect(fit.effects, fit.theta)
        for one, value in zip(effect.parameters, own.tolist(), strict=True)
    }
    model = Augmented(fit.calibrated, fit.effects, fit.theta)
    return Candidate(answer.effects, probability, parameters, answer.ties, answer.gain, model)
