"""Answers of the rig's hardware: link, robot, structure, contact and sensor."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter1d

from .answers import Answer, Group, complete, simplest, tied
from .any_law import any_law
from .benign import Weighted, Widened, scatter, settled, touching, waves, weighted
from .calibration import calibration
from .catalogue import SOFTWARE, catalogue, of_hardware
from .colour import whitened
from .effect import Effect
from .fit import Fit, Fitter, inflation
from .losses import Losses, lost_commands
from .misfit import in_contact, louder, unexplained
from .model import RigModel
from .search import Search, roughness, search
from .stochastic import Force, Noise, arrival_innovations, link_noise, random_arrival, sensor_noise
from .study import Array, Role, Study

__all__ = ["weigh_rig"]

# How many fits become answers, and log evidence below which a noise may be chance [nats].
_KEPT, _WEAK = 12, 40.0
# Log evidence of commands lost or delayed at random from which they are weighed [nats].
_LINK_CLEAR = 5.0
# The same of commands lost one by one, of which a few may be chance.
_LOSSES_CLEAR = 15.0
# Log evidence of lost commands that stand apart, over that of random arrivals, at which they are what these
# are; and of it the share that may be left when they are taken away.
_LIKELIER, _REST = 2.0, 0.1
_PACKETS = "link.packet-loss"
# Log evidence of a line, or of samples that stay put, from which the sensor is where it comes from [nats].
_CLEAR = 20.0
# Roughness that strays by more, against what is usual, is none [nats].
_ROUGHER = 20.0
# Tolerances are doubtful where a factor on all of them has some log evidence, and more than the best effect,
# while calibrated numbers of several kinds stray by more than `_STRAYED`: one effect, as a delay, strays in
# all numbers of its kind.
_STRAYED, _DOUBTED = 2.0, 2.0
# Not even wider tolerances make more strays than these ordinary.
_ORDINARY = 3.0
_KINDS = (
    ("natural_frequency", "damping_ratio", "response_delay"),
    ("contact_damping", "sensor_delay", "sensor_cutoff"),
    ("front_wall", "rear_wall"),
    ("contact_stiffness",),
    ("force_bias",),
)


def weigh_rig(
    study: Study, without: Sequence[str] = (), rough: Mapping[str, Sequence[float]] | None = None
) -> Group:
    """Weigh the effects of link, robot, structure, contact and sensor.

    Args:
        without: ids of effects to leave out of the catalogue.
        rough: roughness of every rig, see `Calibration.roughness`; what comes with the product by default.
    """
    rough = calibration().roughness if rough is None else rough
    return _weigh(RigModel(study, study.of(Role.TRAIN)), frozenset(without), rough)


def _weigh(
    model: RigModel, without: Collection[str], rough: Mapping[str, Sequence[float]], lost: Noise | None = None
) -> Group:
    """Arguments as those of `weigh_rig`.

    Args:
        lost: commands lost one by one, if they were found; the model is given the others.
    """
    plain = [one for one in of_hardware() if one.id not in without]
    weights = [settled(len(run)) for run in model.runs for _ in range(2)]
    fitter = weighted(model, weights, plain, rough)
    none = fitter.fit(())
    # A small wave that is there without any effect should not be taken for one in the search.
    waved = waves(model, fitter.left(none.residuals), weights)
    force = _force(model, fitter, none)
    noises = [one for one in force.noises if one.id not in without]
    coloured = next((one.scale for one in force.noises if one.id == "sensor.coloured-noise"), 1.0)
    if coloured > 1.0:
        # It may be an effect that shows in flight, like the tool's inertia: then it goes as that is fitted.
        quick = search(fitter, plain, longest=1)
        if quick.fits:
            again = _force(model, fitter, quick.fits[0])
            noises = [one for one in again.noises if one.id not in without]
            coloured = next((one.scale for one in again.noises if one.id == "sensor.coloured-noise"), 1.0)
            force = again
    dropout = any(one.id == "sensor.dropout" for one in noises)
    step = next((one.theta[0] for one in noises if one.id == "sensor.quantisation"), 0.0)
    noise = model.study.nominal["force_noise"].value
    coarse = math.hypot(1.0, step / math.sqrt(12.0) / noise)
    for index in range(len(model.runs)):
        weight = settled(len(model.runs[index])) / (coloured * coarse)
        if dropout:
            weight[force.repeats[index]] = 0.0
        weights[2 * index + 1] = weight
    if noises or waved is not None:
        fitter = weighted(model, weights, plain, rough, waved)
    found = search(fitter, plain)
    # What follows costs much in every fit, and hardly moves one: it counts when fits are weighed.
    scattered = scatter(model, fitter.replay, found.best)
    fitter = weighted(model, weights, plain, rough, None, scattered)
    left = fitter.left(found.best.residuals)
    waved = waves(model, left, weights)
    if waved is not None:
        fitter = weighted(model, weights, plain, rough, waved, scattered)
        left = fitter.left(found.best.residuals)
    arrival, deviation = random_arrival(model, found.best, left[0::2])
    losses = None
    if lost is None and _PACKETS not in without:
        losses = lost_commands(model, found.best, left[0::2])
        if _told_apart(model, found.best, left[0::2], losses, arrival):
            told = Noise(_PACKETS, (losses.chance,), losses.log_evidence, uneven=losses.regular)
            return _weigh(model.given(losses.shorter), {*without, _PACKETS, "link.jitter"}, rough, told)
    # What an effect leaves where it is not fitted may look like a line, or hide a noise.
    last = _force(model, fitter, found.best)
    line = min(force.line, last.line)
    colour = last.colour if coloured == 1.0 else (0.0, 0.0)
    even = {one.id: one.uneven for one in last.noises}
    noises = [replace(one, uneven=min(one.uneven, even.get(one.id, one.uneven))) for one in noises]
    noises += [lost] if lost is not None else []
    doubt = _doubt(model, weights, plain, rough, found.none)
    answers = _answers(model, fitter, weights, found, noises, colour)
    surplus = losses.log_evidence - arrival if losses is not None else 0.0
    periodic = _periodic(losses) if arrival <= _LINK_CLEAR else 0.0
    links = []
    if arrival > _LINK_CLEAR:
        # Random arrivals take up what the encoder strays, whatever it is; but then it is not white.
        unforeseen = arrival_innovations(model, found.best, left[0::2], deviation)
        arrival /= inflation(unforeseen)
    if arrival > _LINK_CLEAR:
        links = _links(model, found.none, arrival, deviation, surplus, without)
    if links:
        # The best of them lies above the best without it by the log evidence of what is random.
        level = arrival + max((one.gain for one in answers), default=0.0)
        always = (catalogue()[links[0].id],)
        behind, again = _behind_link(model, weights, plain, rough, always, found.none)
        beside = _answers(model, behind, weights, again, [*noises, links[0]], colour, always)
        top = max(one.gain for one in beside)
        rest, odd = unexplained(unforeseen), losses.regular if losses is not None else 0.0
        beside = [
            replace(one, gain=one.gain - top + level, left=one.left + rest, odd=one.odd + odd)
            for one in beside
        ]
        answers = sorted([*answers, *beside, *_other_link(beside, links)], key=lambda one: -one.gain)
        left = behind.left(again.best.residuals) if again.best.effects else left
    # Lost commands that keep a period are told apart from chance, or beside it, or within what is random.
    kept = [one.uneven for one in (lost,) if one is not None]
    kept += [losses.regular] if losses is not None and links else []
    linked = max((periodic, *kept)) > 0.0
    answers = tied(fitter, simplest(answers))
    best = max((one.gain for one in answers), default=0.0)
    doubtful = doubt > max(_DOUBTED, best)
    doubt = doubt if doubtful else 0.0
    # Of doubtful tolerances roughness takes up much.
    remains = _remains(model, fitter, weights, found.none, colour, rougher=not doubtful)
    nothing = Answer((), doubt, remains, found.none)
    every = [one.id for one in catalogue().values() if one.place not in SOFTWARE and one.id not in without]
    misfit = {
        "robot": float(np.mean(np.concatenate(left[0::2]) ** 2)),
        "contact": float(np.mean(np.concatenate(left[1::2]) ** 2)),
    }
    return Group(
        tuple(complete([nothing, *answers], every)),
        line + force.held + periodic,
        "link" if linked else _place(left, line + force.held, colour),
        found.none,
        misfit,
        doubtful,
    )


def _told_apart(model: RigModel, fit: Fit, left: Sequence[Array], losses: Losses, arrival: float) -> bool:
    """Whether losses explain the encoder better than random arrivals do, and one by one.

    Not where they are so many that they run into each other.

    Args:
        fit, left: as those of `random_arrival`; arrival: log evidence that it found [nats].
    """
    if losses.log_evidence < max(_LOSSES_CLEAR, _LIKELIER * arrival):
        return False
    rest = [r - moved / model.noise[0] for r, moved in zip(left, losses.moved, strict=True)]
    after, _ = random_arrival(model, fit, rest)
    return after < max(_REST * losses.log_evidence, _LINK_CLEAR)


def _periodic(losses: Losses | None) -> float:
    """Log evidence of losses that keep a period, too few to be told as lost by chance [nats].

    Chance keeps none, so that they are believed from as much evidence on as its losses, the period's added.
    """
    if losses is None or losses.regular == 0.0:
        return 0.0
    told = losses.log_evidence + losses.regular
    return told if told > _LOSSES_CLEAR else 0.0


def _force(model: RigModel, fitter: Fitter, fit: Fit) -> Force:
    return sensor_noise(model, fitter.left(fit.residuals)[1::2], touching(model, fit))


def _doubt(
    model: RigModel,
    weights: Sequence[Array],
    effects: Sequence[Effect],
    rough: Mapping[str, Sequence[float]],
    none: Fit,
) -> float:
    """Log evidence of wider tolerances over those given.

    It is zero unless numbers of several kinds stray, and none does beyond wider tolerances.
    """
    kinds = [[abs(none.deviation.get(name, 0.0)) for name in kind] for kind in _KINDS]
    if none.effects or sum(max(kind) > _STRAYED for kind in kinds) < 2:
        return 0.0
    columns = roughness(Fitter(Weighted(model, weights)), effects, rough)
    given, wider = (Fitter(one(model, weights), 1.0, columns).fit(()) for one in (Weighted, Widened))
    if max(map(abs, wider.deviation.values())) > _ORDINARY:
        return 0.0
    # Like is compared with like: what the answers reckon with besides, as a wave, is in neither.
    return max(0.0, wider.log_evidence - given.log_evidence)


def _links(
    model: RigModel,
    none: Fit,
    arrival: float,
    deviation: float,
    surplus: float,
    without: Collection[str],
) -> list[Noise]:
    """Commands lost or delayed at random, the one that explains the encoder better first.

    Args:
        arrival, deviation: log evidence that either is there [nats], and how strong it is [s]; the second has
            less evidence by what it explains less.
        surplus: log evidence of lost commands over that of random arrivals, where they are sought one by one
            [nats]: random delays leave it far below.
    """
    at = none.calibrated
    lag = 2.0 * at["damping_ratio"] / at["natural_frequency"] + at["response_delay"]
    found = [one for one in link_noise(model, lag, deviation) if one.id not in without]
    if surplus > 0.0:
        found = [replace(one, log_evidence=surplus if one.id == _PACKETS else 0.0) for one in found]
    found.sort(key=lambda one: -one.log_evidence)
    return [
        replace(one, log_evidence=arrival + one.log_evidence - found[0].log_evidence, scale=1.0)
        for one in found
    ]


def _other_link(answers: Sequence[Answer], links: Sequence[Noise]) -> list[Answer]:
    """The best answers with the other kind of randomness instead, which was not fitted."""
    found = []
    for other in links[1:]:
        for answer in answers[:3]:
            names = {*answer.effects} - {links[0].id} | {other.id}
            noises = (*(one for one in answer.noises if one is not links[0]), other)
            gain = answer.gain - links[0].log_evidence + other.log_evidence
            found.append(replace(answer, effects=tuple(sorted(names)), gain=gain, noises=noises, fit=None))
    return found


def _behind_link(
    model: RigModel,
    weights: list[Array],
    effects: Sequence[Effect],
    rough: Mapping[str, Sequence[float]],
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
        noise = max(1.0, math.sqrt(float(np.mean(sums**2)) / 16.0), float(r.std()))
        weights[2 * index] = weights[2 * index] / noise
        weights[2 * index + 1] = 0.5 * weights[2 * index + 1]
    fitter = weighted(model, weights, effects, rough)
    return fitter, search(fitter, effects, always)


def _remains(
    model: RigModel,
    fitter: Fitter,
    weights: Sequence[Array],
    fit: Fit,
    colour: tuple[float, float],
    rougher: bool = True,
) -> float:
    """What a fit leaves unexplained [nats].

    Args:
        rougher: whether what roughness takes up beyond what it does of rigs counts, too: it is not left.
    """
    left = fitter.left(fit.residuals)
    forces = whitened(left[1::2], colour)
    told = unexplained(forces), in_contact(forces, touching(model, fit))
    found = unexplained(left[0::2]) + max(*told, any_law(model, fitter, fit, weights, colour))
    # What an effect only imitates bends the calibration, too. Without any that is for tolerances to tell.
    bent = _bent(fit) if fit.effects else 0.0
    return found + bent + (max(fitter.strayed(fit.residuals) - _ROUGHER, 0.0) if rougher else 0.0)


def _bent(fit: Fit) -> float:
    """Log likelihood that calibrated numbers stray by more than their tolerances, of all or of one kind."""
    kinds = [[fit.deviation.get(name, 0.0) for name in kind] for kind in _KINDS]
    every = [one for kind in kinds for one in kind]
    told = [louder(len(one), float(np.mean(np.square(one)))) for one in (every, *kinds)]
    return max(max(told) - math.log(len(told)), 0.0)


def _answers(
    model: RigModel,
    fitter: Fitter,
    weights: Sequence[Array],
    found: Search,
    noises: Sequence[Noise],
    colour: tuple[float, float],
    always: tuple[Effect, ...] = (),
) -> list[Answer]:
    """What a search found as answers, largest log evidence first; without none, if nothing is known of noise.

    Args:
        noises: effects known by statistics; weak ones may be there or not.
        colour: small coloured noise of the force, see `Force`.
        always: effects of every model, which are among the noises.
    """
    left = fitter.left(found.best.residuals)
    by = [inflation(left[0::2]), inflation(left[1::2])] * (len(left) // 2)
    least = fitter.log_evidence(found.none, by)
    hidden = {one.id for one in always}
    answers = []
    for fit in (found.none, *found.fits[:_KEPT]):
        names = [one.id for one in fit.effects if one.id not in hidden]
        over, remains = fitter.log_evidence(fit, by) - least, _remains(model, fitter, weights, fit, colour)
        for some in _subsets(noises, always):
            gain = over + sum(one.log_evidence for one in some)
            every = tuple(sorted((*names, *(one.id for one in some))))
            if every:
                odd = sum(one.uneven for one in some)
                answers.append(Answer(every, gain, remains, fit, (), some, odd=odd))
    return simplest(answers)


def _subsets(noises: Sequence[Noise], always: tuple[Effect, ...]) -> list[tuple[Noise, ...]]:
    """All noises, and all but one of those that may be chance."""
    hidden = {one.id for one in always}
    weak = [one for one in noises if one.log_evidence < _WEAK and one.id not in hidden]
    return [tuple(noises), *(tuple(one for one in noises if one is not gone) for gone in weak)]


def _place(left: Sequence[Array], odd: float, colour: tuple[float, float]) -> str:
    """Where something outside the catalogue acts."""
    encoder, sensor = unexplained(left[0::2]), unexplained(whitened(left[1::2], colour))
    if odd > _CLEAR and sensor > encoder:
        return "sensor"
    return "robot" if encoder > sensor else "contact"
