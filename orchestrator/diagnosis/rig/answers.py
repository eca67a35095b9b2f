"""Answers for a group of logs: which effects act there. Includes those of the rig's software."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

from .catalogue import SOFTWARE, catalogue
from .effect import by_effect
from .fit import Fit, Fitter
from .search import search, separation
from .software import ControllerReplay, DynamicsReplay
from .stochastic import Noise
from .study import Role, Study

REPLAYS = dict(zip(SOFTWARE, (DynamicsReplay, ControllerReplay), strict=True))
# Effects whose log evidence differs by less [nats], and whose fitted replays data like these would hardly
# separate, cannot be distinguished.
_TIED, _APART = 5.0, 8.0
# Software is exact: residuals beyond this mean square, in last digits, are a gap.
_EXACT = 3.0
# Distance to the best log evidence up to which an answer is reported with unseen effects [nats].
_NEAR = 12.0


@dataclass(frozen=True)
class Answer:
    """One answer of a group of logs.

    Attributes:
        effects: ids, or ("outside",), or none.
        gain: log evidence over none [nats]; of none, that of wider tolerances. random: what of it says about
            effects that draw; their form is not that of an equation, which others could correct.
        left: unexplained by it [nats]; parts: what that is made of, of the runs that were searched in, then
            of all, see `held_out.UnexplainedEvidence`, if any.
        nonrandom: log likelihood that what it holds to be random is not [nats].
        fit: the model; None for outside, and for what was not fitted itself.
        noises: stochastic effects among the effects.
        unseen: effects among them without evidence in the logs; they are too small to be seen.
        numerics: part of `left` that the replay's own error may cause [nats]; see
            `residual_evidence.own_error`.
        size: of the strongest effect with evidence, see `Effect.size`; 0 where none has one.
        doubtful: whether it holds tolerances to be wider than stated, by whose log evidence it gains.
    """

    effects: tuple[str, ...]
    gain: float
    left: float
    fit: Fit | None = None
    ties: tuple[str, ...] = ()
    noises: tuple[Noise, ...] = ()
    unseen: tuple[str, ...] = ()
    nonrandom: float = 0.0
    random: float = 0.0
    numerics: float = 0.0
    size: float = 0.0
    doubtful: bool = False
    parts: tuple[float, ...] = ()

    @property
    def seen(self) -> tuple[str, ...]:
        """Effects with evidence in the logs."""
        return tuple(one for one in self.effects if one not in self.unseen)


@dataclass(frozen=True)
class Group:
    """Answers of one group of logs, before they are made probabilities.

    Attributes:
        answers: none first, then by falling evidence.
        outside: log evidence that something is there that no answer explains [nats], beside what the answers
            leave; place: where.
        none: the fit of the calibration alone.
        misfit: mean square of what the best answer leaves, by place.
        unjudged: why it is not judged on further runs what answers leave; "" if it is, or there are none.
    """

    answers: tuple[Answer, ...]
    outside: float
    place: str
    none: Fit | None = None
    misfit: Mapping[str, float] | None = None
    unjudged: str = ""


def weigh_software(study: Study, place: str) -> Group:
    """Weigh the effects of a software component, which replays exactly where nothing is hidden."""
    replay = REPLAYS[place](study, study.of(Role.TRAIN))
    own = [one for one in catalogue().values() if one.place == place and not one.statistic]
    fitter = Fitter(replay)
    none = fitter.fit(())
    size = sum(map(len, none.residuals))
    square = none.chi2 / size
    nothing = Answer((), 0.0, 0.0, none)
    # No effect makes a satellite move at another speed than its own.
    drift = replay.position_drift() if isinstance(replay, DynamicsReplay) else 0.0
    if max(square, drift) < _EXACT:
        return Group((nothing,), 0.0, place, none, {place: square})
    found = search(fitter, own, longest=3, thorough=True)
    answers = []
    for fit in found.fits[:8]:
        left = max(0.0, 0.5 * (fit.chi2 - size))
        names = tuple(one.id for one in fit.effects)
        answers.append(Answer(names, found.gain(fit), left, fit, size=strongest(fit)))
    answers = tied(fitter, answers)
    best = answers[0] if answers else nothing
    square = max((best.fit or none).chi2 / size, drift)
    # A few last digits of rounding are no effect; a larger residual is not in the catalogue.
    over = 0.5 * size * max(0.0, square / _EXACT - 1.0)
    return Group((nothing, *answers), over, place, none, {place: square})


def strongest(fit: Fit, noises: Sequence[Noise] = ()) -> float:
    """Size of the strongest effect of a fit, or of its noises; see `Answer.size`."""
    sizes = [effect.size(theta) for effect, theta in by_effect(fit.effects, fit.theta)]
    return max([*sizes, *(catalogue()[one.id].size(one.theta) for one in noises)], default=0.0)


def simplest(answers: Sequence[Answer]) -> list[Answer]:
    """Answers without those that only add effects to a better one."""
    kept: list[Answer] = []
    for answer in sorted(answers, key=lambda one: -one.gain):
        if not any(set(other.effects) < set(answer.effects) for other in kept):
            kept.append(answer)
    return kept


def complete(answers: Sequence[Answer], ids: Collection[str]) -> list[Answer]:
    """Add answers with further effects that are too small to be seen.

    An effect may be as small as it likes: no answer has less evidence than it has without some of its
    effects, and one that was not worth a fit has the same. To no effect one or two are added, to near
    answers of one effect one.

    Args:
        answers: none first, then by falling evidence.
        ids: of all effects of the group.
    Returns: none first, then by falling evidence.
    """
    found: dict[frozenset[str], Answer] = {}
    for answer in sorted(answers, key=lambda one: len(one.effects)):
        within = [one for key, one in found.items() if key < set(answer.effects)]
        better = max(within, key=lambda one: one.gain, default=answer)
        if better.gain > answer.gain:
            added = tuple(one for one in answer.effects if one not in better.seen)
            like = {"gain": better.gain, "random": better.random, "size": better.size}
            answer = replace(answer, unseen=added, doubtful=better.doubtful, **like)
        found[frozenset(answer.effects)] = answer
    best = max(one.gain for one in found.values())
    bases = [
        one
        for one in found.values()
        if not one.effects or (len(one.effects) == 1 and not one.unseen and one.gain > best - _NEAR)
    ]
    for base in bases:
        for name in ids:
            key = frozenset((*base.effects, name))
            if key not in found:
                found[key] = replace(base, effects=tuple(sorted(key)), unseen=(name,))
    if best - found[frozenset()].gain < _NEAR:
        for pair in combinations(sorted(ids), 2):
            if frozenset(pair) not in found:
                found[frozenset(pair)] = replace(found[frozenset()], effects=pair, unseen=pair)
    none, *others = found.values()
    return [none, *sorted(others, key=lambda one: -one.gain)]


def tied(fitter: Fitter, answers: Sequence[Answer]) -> list[Answer]:
    """Answers with their ties: other effects that explain as much, with nearly equal replays.

    What explains less than no effect does is tied with none.
    """
    found = list(answers)
    if not found:
        return found
    near = [one for one in found if one.fit and one.gain > max(found[0].gain - _TIED, 0.0)][:6]
    for place, answer in enumerate(answers):
        if all(answer is not one for one in near):
            continue
        ties: list[str] = []
        for other in near:
            if other is answer or len(other.effects) != len(answer.effects):
                continue
            if answer.fit and other.fit and separation(fitter, answer.fit, other.fit) < _APART:
                ties += [one for one in other.effects if one not in answer.effects]
        found[place] = replace(answer, ties=tuple(dict.fromkeys(ties)))
    return found
