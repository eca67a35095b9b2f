"""Which effects cause the gap: weigh all of the catalogue against the train runs of a study."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np
from threadpoolctl import threadpool_limits

from .answers import SOFTWARE, Answer, Group, weigh_software
from .calibration import Calibration, calibration
from .catalogue import catalogue
from .effect import Effect
from .finding import Augmented, Candidate, Finding
from .fit import Fit
from .hardware import weigh_rig
from .study import Array, Study

__all__ = ["conclude", "weigh"]


def weigh(study: Study) -> Finding:
    """Find which effects cause the gap.

    Only train runs are used. The groups of logs, satellite software, controller software, and the chain from
    link to sensor, are weighed apart; the probability of an answer is the product of theirs.
    """
    with threadpool_limits(limits=1, user_api="blas"):
        groups = [weigh_software(study, place) for place, _ in SOFTWARE]
        rig = weigh_rig(study)
    return conclude([*groups, rig], calibration())


def conclude(groups: Sequence[Group], learned: Calibration) -> Finding:
    """Make a finding of the answers of all groups; the last group is the rig's."""
    weighed = [learned.probabilities(group.answers, group.outside) for group in groups]
    joint: list[tuple[float, tuple[tuple[Group, Answer], ...]]] = []
    ranked = []
    for group, probabilities in zip(groups, weighed, strict=True):
        if group is not groups[-1] and len(group.answers) == 1 and group.outside == 0.0:
            ranked.append([(1.0, group, group.answers[0])])  # software that replays to the last digit
            continue
        options = [*group.answers, Answer(("outside",), 0.0, 0.0)]
        pairs = sorted(zip(probabilities, options, strict=True), key=lambda one: -one[0])[:8]
        ranked.append([(p, group, answer) for p, answer in pairs])
    for choice in product(*ranked):
        p = math.prod(one[0] for one in choice)
        joint.append((p, tuple((one[1], one[2]) for one in choice)))
    joint.sort(key=lambda one: -one[0])
    merged: dict[tuple[str, ...], tuple[float, tuple[tuple[Group, Answer], ...]]] = {}
    for p, choice in joint:  # something outside may act in one group or another: it is one answer
        key = tuple(sorted({name for _, answer in choice for name in answer.effects}))
        merged[key] = (p + merged[key][0], merged[key][1]) if key in merged else (p, choice)
    joint = sorted(merged.values(), key=lambda one: -one[0])[:16]
    total = sum(p for p, _ in joint)
    candidates = tuple(_candidate(p / total, choice) for p, choice in joint)
    first = candidates[0]
    outside = next((group.place for group, answer in joint[0][1] if answer.effects == ("outside",)), "")
    places = {one.partition(".")[0] for one in first.effects if one != "outside"} | {outside} - {""}
    answer_set, held = [], 0.0
    for one in candidates:
        answer_set.append(" + ".join(one.effects) or "none")
        held += one.probability
        if held >= 0.95:
            break
    rig = groups[-1]
    assert rig.none is not None
    misfit = {place: value for group in groups for place, value in (group.misfit or {}).items()}
    doubtful = rig.doubtful and first.effects in ((), ("outside",))
    return Finding(
        candidates,
        first.effects,
        tuple(sorted(places)),
        outside,
        tuple(answer_set),
        Augmented(rig.none.calibrated, (), np.zeros(0)),
        doubtful,
        misfit,
    )


def _candidate(probability: float, choice: Sequence[tuple[Group, Answer]]) -> Candidate:
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
        values = dict(_split(answer.fit))
        for one in answer.noises:
            values[known[one.id]] = np.array(one.theta)
        for effect, own in values.items():
            effects.append(effect)
            theta += own.tolist()
            for parameter, value in zip(effect.parameters, own, strict=True):
                parameters[f"{effect.id}.{parameter.name}"] = float(value)
    outside = "outside" in names
    model = None if outside else Augmented(calibrated, tuple(effects), np.array(theta))
    return Candidate(tuple(sorted(set(names))), probability, parameters, tuple(ties), evidence, model)


def _split(fit: Fit) -> list[tuple[Effect, Array]]:
    found, first = [], 0
    for effect in fit.effects:
        found.append((effect, fit.theta[first : first + len(effect.parameters)]))
        first += len(effect.parameters)
    return found
