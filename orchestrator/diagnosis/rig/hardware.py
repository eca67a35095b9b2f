"""Answers of the rig's hardware: link, robot, structure, contact and sensor."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from .answers import Answer, Group, complete, simplest, strongest, tied
from .calibration import calibration
from .catalogue import SOFTWARE, catalogue, of_hardware
from .coloured_noise import WHITE
from .effect import Effect, Site
from .fit import Fit, Fitter
from .held_out import Judge, fitter_with_nuisance
from .link_effects import Arrivals, arrivals, other_link, random_links, search_behind
from .marginal import inflation
from .misfit import unexplained
from .model import RigModel
from .nuisance import Weighing, Weighted, Widened, force_weights, positions, touching, waves
from .outside_place import place_outside
from .periodic_delays import rhythm
from .random_arrivals import JITTER, PACKETS
from .residual_evidence import KINDS, ResidualEvidence
from .search import Search, each, search
from .stochastic import Force, Noise, sensor_noise
from .study import Array, Role, Study

# How many fits become answers, and log evidence below which a noise may be chance [nats].
_KEPT, _WEAK = 12, 40.0
# Fits whose log evidence is less than the best by more than both, a share of it and so many nats, are out of
# the question.
_HOPELESS, _BELOW = 0.1, 30.0
# Tolerances are doubtful if a factor on all of them has some log evidence, and more than the best effects.
# Each effect is one of many and costs `_EACH`. The factor costs `_SAME_KIND` if only calibrated numbers of
# one kind deviate by more than `_DEVIATES`, since one effect, such as a delay, moves all numbers of its kind.
# A number that deviates alone, while no other does by more than `_BESIDE`, is attributed to an effect.
_DEVIATES, _BESIDE, _DOUBTED, _EACH, _SAME_KIND = 2.0, 1.8, 2.0, 2.0, 1.0
# A further effect that gains less is hardly named [nats].
_LEAST_GAIN = 2.0
# Log evidence of effects, and log likelihood of what they leave, from which roughness is linearised beside
# them [nats], and the share of the evidence that has to stay.
_STRONG, _MUCH, _KEEPS = 3e4, 20.0, 0.5
# Share of a coloured noise's scale below which it is another one.
_QUIETER = 0.8
# Not even wider tolerances make more deviates than these ordinary.
_ORDINARY = 3.0
# Why what answers leave is not looked at in runs that no fit saw.
_RANDOM = "which of their commands were lost or late is not known"
_LIMITED = "they reach a limit that the train runs do not, or hardly do; give one of them the role train"


def weigh_rig(study: Study, rough: Mapping[str, Sequence[float]] | None = None) -> Group:
    """Weigh the effects of link, robot, structure, contact and sensor.

    Args:
        rough: roughness of every rig, see `Calibration.roughness`; what comes with the product by default.
    """
    rough = calibration().roughness if rough is None else rough
    return _weigh(RigModel(study, study.of(Role.TRAIN)), frozenset(), rough)


class _Sensor(NamedTuple):
    """Noise of the force sensor.

    Attributes:
        force: of the best fit; noises: effects known by statistics; coloured: by which coloured
            noise makes the force's noise appear larger.
        louder, lost: by how much it is larger than specified, see `nuisance.force_weights`.
        fitter: with that noise, and with a small wave of the encoder's scale, if there is one.
    """

    force: Force
    noises: list[Noise]
    coloured: float
    noise_factor: float
    lost: bool
    fitter: Fitter


class _RigResults(NamedTuple):
    """Results about the rig after the link's randomness is weighed.

    Attributes:
        answers: largest log evidence first; left: residuals of the best fit, by run and channel.
        periodic: log evidence of losses that keep a period and are no effect [nats].
        regular: log likelihood that what is random in the link keeps a period [nats].
        by: what the best answers were fitted by.
    """

    answers: list[Answer]
    left: list[Array]
    periodic: float
    regular: float
    by: Fitter


def _weigh(
    model: RigModel, without: Collection[str], rough: Mapping[str, Sequence[float]], lost: Noise | None = None
) -> Group:
    """Arguments as those of `weigh_rig`.

    Args:
        lost: commands lost one by one, if they were found; the model is given the others.
    """
    weighing = Weighing.of(model, [one for one in of_hardware() if one.id not in without], rough)
    sensor = _sensed(weighing, without)
    weighing, fitter, found = _searched(weighing, sensor.fitter)
    quieter = _quieter(weighing, sensor, found, without)
    if quieter is not None:
        sensor = quieter
        weighing, fitter, found = _searched(weighing, sensor.fitter)
    if not model.pull and _limited_servo(fitter, found):
        return _weigh(model.followed(), without, rough, lost)
    # What follows costs much in every fit, and hardly moves one: it counts when fits are weighed.
    fitter = fitter_with_nuisance(weighing, found.best)
    left = fitter.marginal.left(found.best.residuals)
    chance = arrivals(model, found.best, left[0::2], lost is None and PACKETS not in without)
    if chance.apart and chance.losses is not None:
        losses = chance.losses
        packets = Noise(PACKETS, (losses.chance,), losses.log_evidence, uneven=chance.regular)
        return _weigh(model.with_commands(losses.shorter), {*without, PACKETS, JITTER}, rough, packets)
    turns = rhythm(left[0::2], positions(model, found.best))
    # What an effect leaves where it is not fitted may look like a line, or hide a noise.
    last = _force(model, fitter, found.best)
    colour = last.colour if sensor.coloured == 1.0 else WHITE
    judge, unjudged = _judging(Judge(weighing, fitter, colour), found, chance, sensor, lost is None)
    first, at_last = sensor.force, last
    if judge.every is not None:
        first, at_last = (_noise_of_all(judge, one) for one in (found.none, found.best))
        # Where more runs make a small colour an effect, or a line hides it, it is what it was.
        if sensor.coloured == 1.0 and _coloured(at_last) == 1.0 and at_last.line == 0.0:
            judge = replace(judge, colour=at_last.colour)
    sensor_only = min(first.line, at_last.line) + first.held + min(first.spiky, at_last.spiky)
    even = {one.id: one.uneven for one in last.noises}
    noises = [replace(one, uneven=min(one.uneven, even.get(one.id, one.uneven))) for one in sensor.noises]
    noises += [lost] if lost is not None else []
    doubt, each = _tolerance_evidence(weighing, found.none)
    answers, left, periodic, regular, by = _linked(judge, found, noises, chance, without)
    if lost is not None:
        regular = max(regular, lost.uneven)
    periodic, regular = max(periodic, turns), max(regular, turns)
    answers = _doubted(weighing, tied(by, simplest(answers)))
    doubtful = doubt > max([_DOUBTED, *(one.gain - each * len(one.seen) for one in answers)])
    # Of doubtful tolerances roughness takes up much.
    rest = judge.leaves(found.none)
    rest = rest.changed(rough=0.0) if doubtful else rest
    nothing = Answer(
        (), doubt if doubtful else 0.0, rest.total, found.none, doubtful=doubtful, parts=rest.parts
    )
    every = [one.id for one in catalogue().values() if one.place not in SOFTWARE and one.id not in without]
    misfit = {
        "robot": float(np.mean(np.concatenate(left[0::2]) ** 2)),
        "contact": float(np.mean(np.concatenate(left[1::2]) ** 2)),
    }
    return Group(
        tuple(complete([nothing, *answers], every)),
        sensor_only + periodic,
        place_outside(judge, found.none, sensor_only, regular),
        found.none,
        misfit,
        unjudged,
    )


def _searched(weighing: Weighing, fitter: Fitter) -> tuple[Weighing, Fitter, Search]:
    """Search with roughness linearised beside the best fit, if that is strong and has a large residual.

    About the nominal rig it says nothing of motions that only an effect leads to, as far deeper contacts.
    It may take up what the effect itself does, too, or lead astray: then it is none. Beside a servo at its
    limits it is always looked at.

    Returns: the weighing, what was fitted by, and what was found.
    """
    found = search(fitter, weighing.effects)
    left = fitter.marginal.left(found.best.residuals)
    if found.gain(found.best) < _STRONG or (unexplained(left) < _MUCH and not weighing.model.pull):
        return weighing, fitter, found
    about = found.best
    if weighing.model.pull:
        # Few effects: what further ones do may be roughness.
        most = [one for one in found.fits if found.gain(one) > _KEEPS * found.gain(about)]
        about = min(most, key=lambda one: len(one.effects))
    beside = weighing.linearised_about(about)
    by = beside.fitter()
    again = search(by, weighing.effects)
    little = unexplained(by.marginal.left(again.best.residuals)) < 2.0 * max(_MUCH, unexplained(left))
    if not little or again.gain(again.best) < _KEEPS * found.gain(found.best):
        return weighing, fitter, found
    return beside, by, again


def _limited_servo(fitter: Fitter, found: Search) -> bool:
    """Whether a servo at its limits explains most, but with a large residual."""
    clear, best = found.gain(found.best), found.best
    if clear < _STRONG or unexplained(fitter.marginal.left(best.residuals)) < _MUCH:
        return False
    return any(
        one.site is Site.LIMIT
        for fit in found.fits
        if found.gain(fit) > _KEEPS * clear
        for one in fit.effects
    )


def _sensed(weighing: Weighing, without: Collection[str]) -> _Sensor:
    """Find the force's noise, and let its samples count by it: the weighing's weights are changed."""
    model, weights = weighing.model, weighing.weights
    fitter = weighing.fitter()
    none = fitter.fit(())
    # A small wave that is there without any effect should not be taken for one in the search.
    waved = waves(model, fitter.marginal.left(none.residuals), weights)
    force = _force(model, fitter, none)
    if _coloured(force) > 1.0:
        # It may be an effect that shows in flight, like the tool's inertia: then it goes as that is fitted.
        quick = search(fitter, weighing.effects, longest=1)
        if quick.fits:
            force = _force(model, fitter, quick.fits[0])
    return _with_noise(weighing, force, without, waved)


def _quieter(weighing: Weighing, sensor: _Sensor, found: Search, without: Collection[str]) -> _Sensor | None:
    """Force noise of the best fit, where that is clearly less than the noise assumed before.

    Beside a model that lacks much, contacts are not where they were, and what they do is taken for noise.
    """
    if sensor.coloured == 1.0 or not found.best.effects:
        return None
    weights = force_weights(weighing.model.runs, 1.0, sensor.lost)
    plain = replace(weighing, weights=weights, known={})
    by = plain.fitter()
    residuals = by.residuals(found.best.effects, found.best.z)
    force = _force(weighing.model, by, replace(found.best, residuals=tuple(residuals)))
    if _coloured(force) > _QUIETER * sensor.coloured:
        return None
    return _with_noise(weighing, force, without, None)


def _with_noise(weighing: Weighing, force: Force, without: Collection[str], waved: Array | None) -> _Sensor:
    """Noise and stochastic effects of the force; updates the weights of its samples.

    Args:
        waved: a small wave of the encoder's scale, see `nuisance.waves`.
    """
    model, weights = weighing.model, weighing.weights
    noises = [one for one in force.noises if one.id not in without]
    step = next((one.theta[0] for one in noises if one.id == "sensor.quantisation"), 0.0)
    coarse = math.hypot(1.0, step / math.sqrt(12.0) / model.noise[1])
    noise_factor, lost = _coloured(force) * coarse, any(one.id == "sensor.dropout" for one in noises)
    weights[:] = force_weights(model.runs, noise_factor, lost)
    return _Sensor(force, noises, _coloured(force), noise_factor, lost, weighing.fitter(waved))


def _judging(
    judge: Judge, found: Search, chance: Arrivals, sensor: _Sensor, complete: bool
) -> tuple[Judge, str]:
    """A judge of all runs, if those that no fit saw can judge; else why they cannot, if there are any.

    Args:
        judge: of the runs that fits saw; complete: whether all commands are known to have arrived.
    """
    runs = judge.weighing.model.study.runs
    if len(runs) == len(judge.weighing.model.runs):
        return judge, ""
    if not complete or chance.log_evidence != 0.0:
        return judge, _RANDOM
    judge = judge.over(runs, found.best, sensor.noise_factor, sensor.lost)
    return judge, _LIMITED if judge.limited else ""


def _noise_of_all(judge: Judge, fit: Fit) -> Force:
    """Noise of the force in all runs beside a fit to some of them."""
    by, here, _ = judge.carried(fit)
    return _force(by.weighing.model, by.fitter, here)


def _coloured(force: Force) -> float:
    return next((one.scale for one in force.noises if one.id == "sensor.coloured-noise"), 1.0)


def _force(model: RigModel, fitter: Fitter, fit: Fit) -> Force:
    return sensor_noise(model, fitter.marginal.left(fit.residuals)[1::2], touching(model, fit))


def _linked(
    judge: Judge,
    found: Search,
    noises: Sequence[Noise],
    chance: Arrivals,
    without: Collection[str],
) -> _RigResults:
    """Answers without randomness of the link and with it.

    Args:
        judge, noises: as those of `_answers`; without: ids that are not sought.
    """
    weighing, fitter = judge.weighing, judge.fitter
    left = fitter.marginal.left(found.best.residuals)
    answers = _answers(judge, found, noises)
    links = random_links(weighing.model, found.none, chance, without)
    if not links:
        return _RigResults(answers, left, chance.periodic, chance.periodic, fitter)
    alone = {(): found.none} | {_ids(one): one for one in found.fits}
    gains = {(): 0.0} | {one.effects: one.gain for one in reversed(answers)}
    level = max(gains.values()) + chance.log_evidence
    always = (catalogue()[links[0].id],)
    beyond, again = search_behind(weighing, always, found.best)
    behind = beyond.fitter()
    beside = _answers(Judge(beyond, behind, judge.colour), again, [*noises, links[0]], always)
    # The best of them lies above the best without it by the log evidence of what is random; but it does not
    # share in what effects gain that it does not have.
    own = tuple(one for one in beside[0].effects if one != links[0].id)
    fit = alone.get(tuple(one for one in own if one not in {noise.id for noise in noises}))
    if fit is not None and own in gains:
        rest = fitter.marginal.left(fit.residuals)[0::2]
        level = min(level, gains[own] + arrivals(weighing.model, fit, rest, False).log_evidence)
    raised, unforeseen = level - beside[0].gain, unexplained(chance.unforeseen)
    beside = [
        _behind(replace(one, gain=one.gain + raised, nonrandom=one.nonrandom + chance.regular), unforeseen)
        for one in beside
    ]
    answers = sorted([*answers, *beside, *other_link(beside, links)], key=lambda one: -one.gain)
    left = behind.marginal.left(again.best.residuals) if again.best.effects else left
    # Lost commands that keep a period are distinguished from chance, or beside it, or within what is random.
    by = behind if {PACKETS, JITTER} & set(answers[0].effects) else fitter
    return _RigResults(answers, left, 0.0, chance.regular, by)


def _behind(answer: Answer, unforeseen: float) -> Answer:
    """An answer that includes the encoder residual beyond random arrivals [nats]."""
    parts = list(answer.parts)
    for place in range(ResidualEvidence._fields.index("encoder"), len(parts), len(ResidualEvidence._fields)):
        parts[place] += unforeseen
    return replace(answer, left=answer.left + unforeseen, parts=tuple(parts))


def _ids(fit: Fit) -> tuple[str, ...]:
    return tuple(sorted(one.id for one in fit.effects))


def _doubted(weighing: Weighing, answers: list[Answer]) -> list[Answer]:
    """Answers, with that instead of whose further effect wider tolerances would do as well."""
    if not answers or answers[0].fit is None or len(answers[0].effects) < 2:
        return answers
    best = answers[0]
    found = []
    for one in answers[1:]:
        further = set(best.effects) - set(one.effects)
        if one.fit is None or not set(one.effects) < set(best.effects) or len(further) != 1:
            continue
        if best.gain - one.gain < _LEAST_GAIN:
            return answers  # it is hardly named
        doubt, each = _tolerance_evidence(weighing, one.fit)
        if doubt > max(_DOUBTED, best.gain - one.gain - each):
            found.append(replace(one, gain=one.gain + doubt, doubtful=True))
    if not found:
        return answers
    doubted = max(found, key=lambda one: one.gain)
    others = [one for one in answers if one.effects != doubted.effects]
    return sorted([doubted, *others], key=lambda one: -one.gain)


def _tolerance_evidence(weighing: Weighing, fit: Fit) -> tuple[float, float]:
    """Log evidence of wider tolerances over the stated ones, and the price of an effect beside them [nats].

    It is zero unless some number deviates, and not it alone, and none does beyond wider tolerances.

    Args:
        fit: without any effect, or with those that act anyway.
    """
    kinds = [max(abs(fit.deviation.get(name, 0.0)) for name in kind) for kind in KINDS]
    far = sum(most > _DEVIATES for most in kinds)
    each = _EACH if far > 1 else _SAME_KIND
    second = sorted(map(abs, fit.deviation.values()))[-2:-1]
    if not far or max(second, default=0.0) < _BESIDE:
        return 0.0, each
    columns = weighing.roughness()
    theta = fit.z[len(fit.deviation) :]
    given, wider = (
        Fitter(one(weighing.model, weighing.weights), 1.0, columns).fit(fit.effects, start=theta)
        for one in (Weighted, Widened)
    )
    if max(map(abs, wider.deviation.values())) > _ORDINARY:
        return 0.0, each
    # Like is compared with like: what the answers reckon with besides, as a wave, is in neither.
    return max(0.0, wider.log_evidence - given.log_evidence), each


def _answers(
    judge: Judge,
    found: Search,
    noises: Sequence[Noise],
    always: tuple[Effect, ...] = (),
) -> list[Answer]:
    """Answers from a search, largest log evidence first; without the empty one if the noise is unknown.

    Args:
        judge: of what they leave, and by what they are weighed.
        noises: effects known by statistics; weak ones may be there or not.
        always: effects of every model, which are among the noises.
    """
    fitter = judge.fitter
    left = fitter.marginal.left(found.best.residuals)
    by = [inflation(left[0::2]), inflation(left[1::2])] * (len(left) // 2)
    least = fitter.log_evidence(found.none, by)
    hidden = {one.id for one in always}
    answers = []
    fits = (found.none, *found.fits[:_KEPT])
    gains = [fitter.log_evidence(fit, by) - least for fit in fits]
    # What gains nothing leaves what none leaves, and what is out of the question is not looked at.
    worth = max(0.0, max(gains) * (1.0 - _HOPELESS) - _BELOW)
    judged = [fit if over > worth else found.none for fit, over in zip(fits, gains, strict=True)]
    each(judge.leaves, list({id(one): one for one in judged}.values()))
    for fit, over, like in zip(fits, gains, judged, strict=True):
        names = [one.id for one in fit.effects if one.id not in hidden]
        rest = judge.leaves(like)
        for some in _subsets(noises, always):
            random = sum(one.log_evidence for one in some)
            every = tuple(sorted((*names, *(one.id for one in some))))
            if every:
                nonrandom, size = sum(one.uneven for one in some), strongest(fit, some)
                details = {"nonrandom": nonrandom, "random": random, "numerics": rest.own_error, "size": size}
                answers.append(
                    Answer(every, over + random, rest.total, fit, (), some, parts=rest.parts, **details)
                )
    return simplest(answers)


def _subsets(noises: Sequence[Noise], always: tuple[Effect, ...]) -> list[tuple[Noise, ...]]:
    """All noises, and all but one of those that may be chance."""
    hidden = {one.id for one in always}
    weak = [one for one in noises if one.log_evidence < _WEAK and one.id not in hidden]
    return [tuple(noises), *(tuple(one for one in noises if one is not gone) for gone in weak)]
