"""Answers of the rig's hardware: link, robot, structure, contact and sensor."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter1d

from .answers import SOFTWARE, Answer, Group, simplest, tied
from .catalogue import catalogue
from .effect import Effect, Seen
from .fit import Fit, Fitter, Replay
from .misfit import unexplained
from .model import RigModel
from .rig import Calibrated
from .search import Search, roughness, search
from .stochastic import Force, Noise, link_noise, random_arrival, sensor_noise
from .study import Array, Role, Study

__all__ = ["Weighted", "Widened", "weigh_rig"]

# Log evidence of commands lost or delayed at random from which they are weighed [nats].
_LINK_CLEAR = 5.0
# Log evidence of a line, or of samples that stay put, from which the sensor is where it comes from [nats].
_CLEAR = 20.0
# Tolerances are doubtful where as many calibrated parameters stray by more tolerances than `_STRAYED`, while
# tolerances wider by this factor make all of it ordinary.
_WIDER, _SEVERAL, _STRAYED, _ORDINARY = 2.5, 3, 2.0, 3.0


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

    def seen(self, calibrated: Mapping[str, float], effects: tuple[Effect, ...], theta: Array) -> Seen:
        """See `Replay`."""
        return self.replay.seen(calibrated, effects, theta)


class Widened(Weighted):
    """A replay whose calibration is trusted less."""

    @property
    def tolerances(self) -> Mapping[str, tuple[float, float]]:
        """See `Replay`."""
        return {name: (centre, _WIDER * width) for name, (centre, width) in self.replay.tolerances.items()}


def weigh_rig(study: Study, without: Sequence[str] = ()) -> Group:
    """Weigh the effects of link, robot, structure, contact and sensor.

    Args:
        without: ids of effects to leave out of the catalogue.
    """
    model = RigModel(study, study.of(Role.TRAIN))
    software = {place for place, _ in SOFTWARE}
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
    arrival, deviation = random_arrival(model, best, left[0::2])
    if arrival > _LINK_CLEAR:
        link = _link(model, found.none, arrival, deviation, without)
        if link is not None:
            noises.append(link)
            always = (catalogue()[link.id],)
            fitter, found = _behind_link(model, weights, plain, always, found.none)
            best = found.fits[0] if found.fits and found.gain(found.fits[0]) > 0 else found.none
            left = fitter.left(best.residuals)
    return _group(
        model, fitter, found, best, noises, always, force, _doubt(model, weights, plain, found.none)
    )


def _force(model: RigModel, fitter: Fitter, fit: Fit) -> Force:
    touching = []
    for index in range(len(model.runs)):
        p = model.parameters(index, fit.calibrated, fit.effects, fit.theta)
        at = model.replay(index, fit.calibrated, fit.effects, fit.theta)[7]
        touching.append((at > p[Calibrated.FRONT_WALL]) | (at < p[Calibrated.REAR_WALL]))
    return sensor_noise(model, fitter.left(fit.residuals)[1::2], touching)


def _doubt(model: RigModel, weights: Sequence[float | Array], effects: Sequence[Effect], none: Fit) -> float:
    """Log evidence of wider tolerances over those given, zero unless they explain several strays at once."""
    if none.effects or sum(abs(value) > _STRAYED for value in none.deviation.values()) < _SEVERAL:
        return 0.0
    weighted = Weighted(model, weights)
    fit = Fitter(Widened(model, weights), 1.0, roughness(Fitter(weighted), effects)).fit(())
    strays = np.abs(list(fit.deviation.values()))
    if np.sum(_WIDER * strays > _STRAYED) < _SEVERAL or strays.max() > _ORDINARY:
        return 0.0
    return max(0.0, fit.log_evidence - none.log_evidence)


def _weighted(model: RigModel, weights: Sequence[float | Array], effects: Sequence[Effect]) -> Fitter:
    replay = Weighted(model, weights)
    return Fitter(replay, 1.0, roughness(Fitter(replay), effects))


def _link(
    model: RigModel, none: Fit, arrival: float, deviation: float, without: Sequence[str]
) -> Noise | None:
    """Commands lost or delayed at random, whichever explains the encoder better.

    Args:
        arrival, deviation: log evidence that either is there [nats], and how strong it is [s].
    """
    at = none.calibrated
    lag = 2.0 * at["damping_ratio"] / at["natural_frequency"] + at["response_delay"]
    found = [one for one in link_noise(model, lag, deviation) if one.id not in without]
    if not found:
        return None
    return replace(max(found, key=lambda one: one.log_evidence), log_evidence=arrival, scale=1.0)


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
    doubt: float,
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

    answers = simplest([answer(fit) for fit in (found.none, *found.fits[:12])])
    if not extra:
        answers = [one for one in answers if one.effects]
    answers = tied(fitter, answers)
    nothing = Answer((), doubt, unexplained(fitter.left(found.none.residuals)), found.none)
    left = fitter.left(best.residuals)
    misfit = {
        "robot": float(np.mean(np.concatenate(left[0::2]) ** 2)),
        "contact": float(np.mean(np.concatenate(left[1::2]) ** 2)),
    }
    return Group(
        (nothing, *answers),
        force.line + force.held,
        _place(left, force),
        found.none,
        misfit,
        doubt > 3.0,
    )


def _place(left: Sequence[Array], force: Force) -> str:
    """Where something outside the catalogue acts."""
    encoder, sensor = unexplained(left[0::2]), unexplained(left[1::2])
    if force.line + force.held > _CLEAR and sensor > encoder:
        return "sensor"
    return "robot" if encoder > sensor else "contact"
