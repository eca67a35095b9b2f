"""Weigh all effects of the catalogue against the runs of a study."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from itertools import product

import numpy as np
from threadpoolctl import threadpool_limits

from .answers import Answer, Group, weigh_software
from .calibration import Calibration, calibration, strength
from .catalogue import SOFTWARE, catalogue
from .effect import Effect, by_effect
from .finding import Augmented, Candidate, Finding, most_probable
from .hardware import weigh_rig
from .study import Study

Choice = tuple[tuple[Group, Answer], ...]
_OUTSIDE = Answer(("outside",), 0.0, 0.0)
# Answers of a group whose scores lie farther below its best are not worth a word, and not combined with
# those of other groups; of software, so many are.
_LEAST, _TOLD_OF_SOFTWARE = 16.0, 8
# See `_chosen`: a nat for the first effect, less for one beside it, which fewer look like.
_NAMED, _NAMED_BESIDE = math.e, 1.5


def weigh(study: Study) -> Finding:
    """Find which effects cause the gap.

    Numbers are fitted to train runs, and effects weighed by them, alone; what answers leave unexplained is
    looked at in all runs. The groups of logs, satellite software, controller software, and the chain from
    link to sensor, are weighed apart; the probability of an answer is the product of theirs.
    """
    with threadpool_limits(limits=1, user_api="blas"):
        groups = [weigh_software(study, place) for place in SOFTWARE]
        rig = weigh_rig(study)
    return conclude([*groups, rig], calibration())


def conclude(groups: Sequence[Group], learned: Calibration) -> Finding:
    """Combine the answers of all groups to a finding; the last group is that of the rig.

    Log evidences of groups add up; the price of effects is that of all of them together.
    """
    ranked = [_ranked(group, group is groups[-1], learned) for group in groups]
    joint = _joint(ranked, learned)
    p = learned.spread(np.array([score for score, _ in joint]))
    order = np.argsort(-p, kind="stable")
    candidates = tuple(_candidate(float(p[place]), joint[place][1]) for place in order)
    first, choice = _chosen([(one, joint[place][1]) for one, place in zip(candidates, order, strict=True)])
    outside = next((group.place for group, answer in choice if answer is _OUTSIDE), "")
    places = {one.partition(".")[0] for one in first.effects if one != "outside"} | {outside} - {""}
    known = (joint[place][1] for place in order if all(one[1] is not _OUTSIDE for one in joint[place][1]))
    # If nothing but an unknown effect is probable enough, it is the answer.
    speaks = any(answer.seen for _, answer in next(known, choice))
    rig = groups[-1]
    assert rig.none is not None
    misfit = {place: value for group in groups for place, value in (group.misfit or {}).items()}
    doubtful = any(answer.doubtful for _, answer in choice)
    return Finding(
        candidates,
        first.effects,
        tuple(sorted(places)),
        outside,
        most_probable(candidates, learned.enough(speaks)),
        Augmented(rig.none.calibrated, (), np.zeros(0)),
        doubtful,
        misfit,
        rig.unjudged,
    )


def _ranked(group: Group, last: bool, learned: Calibration) -> list[tuple[float, Group, Answer]]:
    """Answers of a group that are worth a word, and something outside, with their scores, best first."""
    if not last and len(group.answers) == 1 and group.outside == 0.0:
        return [(0.0, group, group.answers[0])]  # software that replays to the last digit
    options = [*group.answers, _OUTSIDE]
    scores, prices = learned.scores(group.answers, group.outside)
    own = scores - prices
    order = np.argsort(-own, kind="stable")
    order = order[own[order] > own[order[0]] - _LEAST]
    return [
        (float(scores[place]), group, options[place])
        for place in (order if last else order[:_TOLD_OF_SOFTWARE])
    ]


def _joint(
    ranked: Sequence[Sequence[tuple[float, Group, Answer]]], learned: Calibration
) -> list[tuple[float, Choice]]:
    """All combinations of one answer from each group, with their scores.

    Something outside may act in one group or another: it is one answer, like others that name the same.
    """
    scored: dict[tuple[str, ...], list[tuple[float, Choice]]] = {}
    for choice in product(*ranked):
        named = {name for _, _, answer in choice for name in answer.effects}
        score = sum(one[0] for one in choice) - _price([one[2] for one in choice], named, learned)
        scored.setdefault(tuple(sorted(named)), []).append((score, tuple(one[1:] for one in choice)))
    return [
        (float(np.logaddexp.reduce([one[0] for one in same])), max(same, key=lambda one: one[0])[1])
        for same in scored.values()
    ]


def _price(answers: Sequence[Answer], named: Collection[str], learned: Calibration) -> float:
    """Price of the effects of all groups' answers together."""
    known = len(set(named) - {"outside"})
    standing = [one for one in answers if one is not _OUTSIDE]
    seen = {name for one in standing for name in one.seen}
    unseen = [name for one in standing for name in one.unseen]
    strong = strength(max((one.size for one in standing), default=0.0))
    price = float(learned.price(len(seen), len(unseen), learned.rarity(unseen), strong))
    # Chance shows in the logs of one group as often, whatever is seen in those of another.
    afresh = sum(bool(one.seen) for one in standing) - 1
    price += max(afresh, 0) * max(learned.first - learned.second, 0.0)
    beside = sum(one is _OUTSIDE for one in answers) - 1 + (known > 0)
    return price + (max(beside, 0) * learned.second if "outside" in named else 0.0)


def _chosen(candidates: Sequence[tuple[Candidate, Choice]]) -> tuple[Candidate, Choice]:
    """The answer with the largest probability among those with evidence, ties included.

    An answer with a further effect that is too small to be seen counts for the answer without it. An effect
    is named only if it is `_NAMED` times as probable as none, or, beside others, `_NAMED_BESIDE` times as
    probable as the answer without it: many similar improbable effects together can outweigh none.
    """
    shown: dict[frozenset[str], float] = {}
    for candidate, choice in candidates:
        seen = frozenset(name for _, answer in choice for name in answer.seen)
        shown[seen] = shown.get(seen, 0.0) + candidate.probability

    def mass(one: Candidate) -> float:
        named = set(one.effects)
        tied = named | set(one.ties)
        return sum(
            p for seen, p in shown.items() if len(seen) == len(named) and (seen == named or seen <= tied)
        )

    standing = [one for one in candidates if frozenset(one[0].effects) in shown]

    def rank(one: tuple[Candidate, Choice]) -> tuple[float, float]:
        return mass(one[0]), one[0].probability

    def odds(one: Candidate) -> float:
        return _NAMED_BESIDE if one.effects else _NAMED

    best = max(standing, key=rank)
    while best[0].effects != ("outside",):
        simpler = [
            one
            for one in standing
            if set(one[0].effects) < set(best[0].effects) and odds(one[0]) * mass(one[0]) >= mass(best[0])
        ]
        if not simpler:
            break
        best = max(simpler, key=rank)
    return best


def _candidate(probability: float, choice: Choice) -> Candidate:
    names: list[str] = []
    effects: list[Effect] = []
    theta: list[float] = []
    ties: list[str] = []
    parameters: dict[str, float] = {}
    calibrated: Mapping[str, float] = {}
    evidence = 0.0
    known = catalogue()
    for _, answer in choice:
        names += answer.effects
        ties += answer.ties
        evidence += answer.gain
        if answer.fit is None:
            continue
        calibrated = {**calibrated, **answer.fit.calibrated}
        values = dict(by_effect(answer.fit.effects, answer.fit.theta))
        for one in answer.noises:
            values[known[one.id]] = np.array(one.theta)
        for effect, own in values.items():
            effects.append(effect)
            theta += own.tolist()
            for parameter, value in zip(effect.parameters, own, strict=True):
                parameters[f"{effect.id}.{parameter.name}"] = float(value)
    # Effects too small to be seen have no model, nor what was not fitted itself.
    unmodelled = any(answer.unseen or (answer.effects and answer.fit is None) for _, answer in choice)
    model = None if unmodelled else Augmented(calibrated, tuple(effects), np.array(theta))
    return Candidate(tuple(sorted(set(names))), probability, parameters, tuple(ties), evidence, model)
