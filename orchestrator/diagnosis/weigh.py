"""Which effects cause the gap: weigh all of the catalogue against the train runs of a study."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.ndimage import gaussian_filter1d
from threadpoolctl import threadpool_limits

from .calibration import Calibration, calibration
from .catalogue import catalogue
from .effect import Effect
from .finding import Augmented, Candidate, Finding
from .fit import Fit, Fitter, Replay
from .misfit import unexplained
from .model import RigModel
from .search import Search, collinear, roughness, search, sensitivity
from .software import ControllerReplay, DynamicsReplay
from .stochastic import Force, Noise, link_noise, sensor_noise
from .study import Array, Role, Study

__all__ = ["Answer", "Group", "Weighted", "weigh", "weigh_rig", "weigh_software"]

_SOFTWARE = (("dynamics", DynamicsReplay), ("controller", ControllerReplay))
# Effects whose log evidence differs by less [nats] and whose changes of the replay are as good as parallel,
# the calibration granted, cannot be told apart.
_TIED, _PARALLEL = 6.0, 0.97
_TIES_OF = 3
# Unexplained log likelihood of the encoder from which commands lost or delayed at random are weighed [nats].
_LINK_SUSPECT = 60.0
# Software is exact: residuals beyond this mean square, in last digits, are a gap.
_EXACT = 3.0


class Weighted:
    """A replay whose residuals count less where the noise is larger than specified.

    Args:
        weights: by channel, a factor or one per sample.
    """

    def __init__(self, replay: Replay, weights: Sequence[float | Array]) -> None:
        self.replay = replay
        self.weights = tuple(weights)

    @property
    def tolerances(self) -> Mapping[str, tuple[float, float]]:
        """See `Replay`."""
        return self.replay.tolerances

    def residuals(
        self, calibrated: Mapping[str, float], effects: tuple[Effect, ...], theta: Array
    ) -> list[Array]:
        """See `Replay`."""
        found = self.replay.residuals(calibrated, effects, theta)
        return [r * weight for r, weight in zip(found, self.weights, strict=True)]


@dataclass(frozen=True)
class Answer:
    """One answer of a group of logs.

    Attributes:
        effects: ids, or ("outside",), or none.
        gain: log evidence over none [nats].
        left: unexplained by it [nats].
        fit: the model; None for outside and for none of the software groups.
        noises: stochastic effects among the effects.
    """

    effects: tuple[str, ...]
    gain: float
    left: float
    fit: Fit | None = None
    ties: tuple[str, ...] = ()
    noises: tuple[Noise, ...] = ()


@dataclass(frozen=True)
class Group:
    """Answers of one group of logs, before they are made probabilities.

    Attributes:
        answers: none first, then by falling evidence.
        outside: log evidence that something is there that no answer explains [nats], beside what the answers
            leave; place: where.
        none: the fit of the calibration alone.
        misfit: mean square of what the best answer leaves, by place.
        doubtful: whether the calibration strays in several parameters at once.
    """

    answers: tuple[Answer, ...]
    outside: float
    place: str
    none: Fit | None = None
    misfit: Mapping[str, float] | None = None
    doubtful: bool = False


def weigh_software(study: Study, place: str) -> Group:
    """Weigh the effects of a software component, which replays exactly where nothing is hidden."""
    replay = dict(_SOFTWARE)[place](study, study.of(Role.TRAIN))
    own = [one for one in catalogue().values() if one.place == place and not one.statistic]
    fitter = Fitter(replay)
    none = fitter.fit(())
    size = sum(map(len, none.residuals))
    square = none.chi2 / size
    nothing = Answer((), 0.0, 0.0, none)
    if square < _EXACT:
        return Group((nothing,), 0.0, place, none, {place: square})
    found = search(fitter, own, longest=3)
    answers = []
    for fit in found.fits[:8]:
        left = max(0.0, 0.5 * (fit.chi2 - size))
        answers.append(Answer(tuple(one.id for one in fit.effects), found.gain(fit), left, fit))
    answers = _tied(fitter, found, answers)
    best = answers[0] if answers else nothing
    square = (best.fit or none).chi2 / size
    # A few last digits of rounding are no effect; what is left beyond them is not in the catalogue.
    over = 0.5 * size * max(0.0, square / _EXACT - 1.0)
    return Group((nothing, *answers), over, place, none, {place: square})


def _simplest(answers: Sequence[Answer]) -> list[Answer]:
    """Answers less those that only add effects to a better one."""
    kept: list[Answer] = []
    for answer in sorted(answers, key=lambda one: -one.gain):
        if not any(set(other.effects) < set(answer.effects) for other in kept):
            kept.append(answer)
    return kept


def _tied(fitter: Fitter, found: Search, answers: Sequence[Answer]) -> list[Answer]:
    """Answers with their ties: other effects that change the replay alike and explain it as well."""
    leading = list(answers)
    if not leading:
        return leading
    near = [one for one in leading if one.fit and one.gain > leading[0].gain - _TIED][:6]
    changes = {one.effects: sensitivity(fitter, one.fit) for one in near if one.fit is not None}
    for place, answer in enumerate(leading):
        if answer.effects not in changes:
            continue
        ties = []
        for other in near:
            same = len(other.effects) == len(answer.effects) and other.effects != answer.effects
            if same and collinear(changes[other.effects], changes[answer.effects]) > _PARALLEL:
                ties += [one for one in other.effects if one not in answer.effects]
        leading[place] = replace(answer, ties=tuple(dict.fromkeys(ties)))
    return leading


def weigh_rig(study: Study, without: Sequence[str] = ()) -> Group:
    """Weigh the effects of link, robot, structure, contact and sensor.

    Args:
        without: ids of effects to leave out of the catalogue.
    """
    model = RigModel(study, study.of(Role.TRAIN))
    software = {place for place, _ in _SOFTWARE}
    own = [
        one
        for one in catalogue().values()
        if one.place not in software and not one.statistic and one.id not in without
    ]
    plain = [one for one in own if not one.statistic]
    fitter = Fitter(model, 1.0, roughness(Fitter(model), plain))
    none = fitter.fit(())
    force = _force(model, fitter, none)
    noises = [one for one in force.noises if one.id not in without]
    weights: list[float | Array] = [1.0] * (2 * len(model.runs))
    coloured = next((one.scale for one in force.noises if one.id == "sensor.coloured-noise"), 1.0)
    if coloured > 1.0:
        # It may be an effect that shows in flight, like the tool's inertia: then it goes as that is fitted.
        quick = search(fitter, plain, longest=1)
        if quick.fits:
            again = _force(model, fitter, quick.fits[0])
            noises = [one for one in again.noises if one.id not in without]
            coloured = next((one.scale for one in again.noises if one.id == "sensor.coloured-noise"), 1.0)
            force = again
    lost = any(one.id == "sensor.dropout" for one in noises)
    step = next((one.theta[0] for one in noises if one.id == "sensor.quantisation"), 0.0)
    noise = study.nominal["force_noise"].value
    coarse = math.hypot(1.0, step / math.sqrt(12.0) / noise)
    for index in range(len(model.runs)):
        weight = np.full(len(model.runs[index]), 1.0 / (coloured * coarse))
        if lost:
            weight[force.repeats[index]] = 0.0
        weights[2 * index + 1] = weight
    if noises:
        fitter = _weighted(model, weights, plain)
    found = search(fitter, plain)
    best = found.fits[0] if found.fits and found.gain(found.fits[0]) > 0 else found.none
    left = fitter.left(best.residuals)
    always: tuple[Effect, ...] = ()
    if unexplained(left[0::2]) > _LINK_SUSPECT:
        link = _link(model, found.none, left, without)
        if link is not None:
            noises.append(link)
            always = (catalogue()[link.id],)
            fitter, found = _behind_link(model, weights, plain, always, found.none)
            best = found.fits[0] if found.fits and found.gain(found.fits[0]) > 0 else found.none
            left = fitter.left(best.residuals)
    return _group(model, fitter, found, best, noises, always, force)


def _force(model: RigModel, fitter: Fitter, fit: Fit) -> Force:
    contact = [
        model.replay(index, fit.calibrated, fit.effects, fit.theta)[6] for index in range(len(model.runs))
    ]
    return sensor_noise(model, fitter.left(fit.residuals)[1::2], contact)


def _weighted(model: RigModel, weights: Sequence[float | Array], effects: Sequence[Effect]) -> Fitter:
    replay = Weighted(model, weights)
    return Fitter(replay, 1.0, roughness(Fitter(replay), effects))


def _link(
    model: RigModel, none: Fit, left: Sequence[Array], without: Sequence[str]
) -> Noise | None:
    """Commands lost or delayed at random, if they explain the encoder better than the best effects do."""
    at = none.calibrated
    lag = 2.0 * at["damping_ratio"] / at["natural_frequency"] + at["response_delay"]
    found = [one for one in link_noise(model, lag) if one.id not in without]
    if not found:
        return None
    winner = max(found, key=lambda one: one.log_evidence)
    gain = winner.log_evidence + 0.5 * sum(float(r @ r) for r in left[0::2])
    return replace(winner, log_evidence=gain, scale=1.0) if gain > 20.0 else None


def _behind_link(
    model: RigModel,
    weights: list[float | Array],
    effects: Sequence[Effect],
    always: tuple[Effect, ...],
    none: Fit,
) -> tuple[Fitter, Search]:
    """Search again where the encoder's residuals are mostly the link's: they count less, and no more in the
    contact, which is given the position that was measured."""
    fit = Fitter(Weighted(model, weights)).fit(always, None, Fitter(model).starts(always[0])[0])
    for index, run in enumerate(model.runs):
        out = model.replay(index, fit.calibrated, fit.effects, fit.theta)
        smooth = gaussian_filter1d(run["encoder_position"] - out[2], 3.0)
        model.correction[index][:] = np.append(smooth, smooth[-1])
    for index in range(len(model.runs)):
        r = fit.residuals[2 * index]
        n = len(r) // 16
        sums = r[: 16 * n].reshape(n, 16).sum(axis=1)
        weights[2 * index] = 1.0 / max(1.0, math.sqrt(float(np.mean(sums**2)) / 16.0), float(r.std()))
        weights[2 * index + 1] = 0.5 * np.asarray(weights[2 * index + 1])
    fitter = _weighted(model, weights, effects)
    return fitter, search(fitter, effects, always)


def _group(
    model: RigModel,
    fitter: Fitter,
    found: Search,
    best: Fit,
    noises: Sequence[Noise],
    always: tuple[Effect, ...],
    force: Force,
) -> Group:
    extra = tuple(one.id for one in noises)
    gain = sum(one.log_evidence for one in noises)
    hidden = {one.id for one in always}

    def answer(fit: Fit) -> Answer:
        names = tuple(one.id for one in fit.effects if one.id not in hidden)
        remains = unexplained(fitter.left(fit.residuals))
        return Answer(
            tuple(sorted((*names, *extra))), gain + found.gain(fit), remains, fit, (), tuple(noises)
        )

    answers = _simplest([answer(fit) for fit in (found.none, *found.fits[:12])])
    if not extra:
        answers = [one for one in answers if one.effects]
    answers = _tied(fitter, found, answers)
    nothing = Answer((), 0.0, unexplained(fitter.left(found.none.residuals)), found.none)
    left = fitter.left(best.residuals)
    misfit = {
        "robot": float(np.mean(np.concatenate(left[0::2]) ** 2)),
        "contact": float(np.mean(np.concatenate(left[1::2]) ** 2)),
    }
    strays = sorted((abs(value) for value in found.none.deviation.values()), reverse=True)
    return Group(
        (nothing, *answers),
        force.line + force.held,
        _place(left, force),
        found.none,
        misfit,
        len(strays) > 2 and strays[2] > 3.0,
    )


def _place(left: Sequence[Array], force: Force) -> str:
    """Where something outside the catalogue acts."""
    encoder, sensor = unexplained(left[0::2]), unexplained(left[1::2])
    if force.line + force.held > 0.5 * (encoder + sensor):
        return "sensor"
    return "robot" if encoder > sensor else "contact"


def weigh(study: Study) -> Finding:
    """Find which effects cause the gap.

    Only train runs are used. The groups of logs, satellite software, controller software, and the chain from
    link to sensor, are weighed apart; the probability of an answer is the product of theirs.
    """
    with threadpool_limits(limits=1, user_api="blas"):
        groups = [weigh_software(study, place) for place, _ in _SOFTWARE]
        rig = weigh_rig(study)
    return conclude([*groups, rig], calibration())


def conclude(groups: Sequence[Group], learned: Calibration) -> Finding:
    """Make a finding of the answers of all groups; the last group is the rig's."""
    weighed = [learned.probabilities(group.answers, group.outside) for group in groups]
    joint: list[tuple[float, tuple[tuple[Group, Answer], ...]]] = []
    ranked = []
    for group, probabilities in zip(groups, weighed, strict=True):
        options = [*group.answers, Answer(("outside",), 0.0, 0.0)]
        pairs = sorted(zip(probabilities, options, strict=True), key=lambda one: -one[0])[:8]
        ranked.append([(p, group, answer) for p, answer in pairs])
    for choice in product(*ranked):
        p = math.prod(one[0] for one in choice)
        joint.append((p, tuple((one[1], one[2]) for one in choice)))
    joint.sort(key=lambda one: -one[0])
    joint = joint[:16]
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
