"""What the communication step adds to what is replayed, taken off where the logs are better explained so."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ...errors import ConfigError
from ...run import Prepared, prepare
from ...system import Port
from ..effect import Effect
from ..finding import NOMINAL, Augmented
from ..study import Array
from ..verdict import Warned
from .replay import PortReplay, Weighted
from .study import PortStudy, Role
from .tempering import Tempering
from .wary import WaryFitter
from .weigh import Weighed, weigh_ports

__all__ = ["told_of_step", "weighed_without_step", "with_steps"]

# By how much shorter the step is at most by which its error is told, and with which a study goes on then.
_SHORTEST, _ONWARD = 32, 8
# A step whose halving moves the weighed residuals by less makes nothing that logs could tell [nats].
_UNSEEN = 1.0

_Models = Mapping[tuple[Effect, ...], Array]


def weighed_without_step(study: PortStudy, tempering: Tempering) -> tuple[PortStudy, Weighed]:
    """Weigh a study's candidates; again without the step's own error, where that explains the logs better.

    What a step is too long for, effects imitate: a delay of half a step, a gain of what oscillates. Its error
    is what a model gives with steps so short that halving them changes nothing that logs tell, less what it
    gives with the step as configured. That hardly depends on the effects, so that one model's stands for
    all: that of the answer, of it less one of its effects, or of none, whichever explains the train runs best
    with its error taken off. If it explains them better than the answer did before, all candidates are
    weighed so. Components that work at that very step, as digital controllers do, explain less with another.

    Returns: the study, with shorter steps where they are right; and what was found.
    """
    weighed = weigh_ports(study, tempering)
    if study.fixed:
        return study, weighed
    finest = _finest(study, weighed.weights)
    if finest is None:
        return study, weighed
    top = weighed.top
    places = range(len(top.effects))
    models = {(*top.effects[:place], *top.effects[place + 1 :]): top.without(place) for place in places}
    models |= {top.effects: top.z, (): top.z[: len(study.nominal)]}
    before = _evidence(study, top.effects, top.z, weighed.weights)
    corrected = {effects: _corrected(study, finest, effects, z) for effects, z in models.items()}
    found = {
        effects: _evidence(corrected[effects], effects, z, weighed.weights) for effects, z in models.items()
    }
    best = max(found, key=lambda effects: found[effects])
    if not found[best] > before:
        return study, weighed
    onward = with_steps(study, min(finest.parts // study.parts, _ONWARD))
    assert onward is not None
    return onward, weigh_ports(corrected[best], tempering)


def told_of_step(study: PortStudy, configured: PortStudy) -> list[Warned]:
    """What to tell of a step other than the configured one."""
    if study.parts == configured.parts:
        return []
    step, before = (f"{1e3 * float(one.prepared.grid.step_size):g} ms" for one in (study, configured))
    return [
        Warned(
            place="numerics",
            what=f"the error of the configured step, {before}, shows in the logs: without it they are "
            f"explained better, so that it is taken off, and steps of {step} are taken",
            remedy=f"Set run.step_size to {step} and the study's interval to {1e3 * study.interval:g} ms; "
            "or, if the step is a controller's sample time, the interval alone.",
        )
    ]


def with_steps(study: PortStudy, parts: int) -> PortStudy | None:
    """The study with so many communication steps where it has one; None if an FMU cannot take such steps.

    Instances whose `step_size` the config gives keep it.
    """
    step = float(study.prepared.grid.step_size / parts)

    def stepped(prepared: Prepared) -> Prepared:
        return prepare(prepared.config, [f"run.step_size={step!r} s"])

    try:
        prepared = stepped(study.prepared)
        trials = tuple(replace(one, prepared=stepped(one.prepared)) for one in study.trials)
    except ConfigError:
        return None
    return replace(study, prepared=prepared, trials=trials, parts=study.parts * parts)


def _finest(study: PortStudy, weights: Mapping[Port, float]) -> PortStudy | None:
    """The study with steps whose error cannot be seen; None if its own cannot, or it takes no other."""
    runs, before = study.of(Role.TRAIN), PortReplay(study, study.of(Role.TRAIN)).of(NOMINAL)
    found, parts = None, 2
    while parts <= _SHORTEST:
        finer = with_steps(study, parts)
        if finer is None:
            return found
        replay = PortReplay(finer, runs)
        now = replay.of(NOMINAL)
        moved = 0.5 * sum(
            (weights.get(port, 0.0) * float(np.linalg.norm(one - other))) ** 2
            for (_, port), one, other in zip(replay.channels, now, before, strict=True)
        )
        if not moved > _UNSEEN:
            return found
        found, before, parts = finer, now, 2 * parts
    return found


def _corrected(study: PortStudy, finest: PortStudy, effects: tuple[Effect, ...], z: Array) -> PortStudy:
    """A study that knows the error of its step, by a model.

    Args:
        z: normalised parameters of the model.
    """
    calibrated, theta = WaryFitter(PortReplay(study, [])).values(effects, z)
    model = Augmented(calibrated, effects, theta)
    runs = []
    for run in study.runs:
        coarse, fine = (
            PortReplay(one, [run]).signals(run, model.calibrated, model.effects, model.theta)
            for one in (study, finest)
        )
        runs.append(replace(run, errors={port: fine[port] - coarse[port] for port in coarse}))
    return replace(study, runs=tuple(runs))


def _evidence(
    study: PortStudy, effects: tuple[Effect, ...], z: Array, weights: Mapping[Port, float]
) -> float:
    """Log evidence of a model, fitted from normalised parameters on [nats]."""
    fitter = WaryFitter(Weighted.of(PortReplay(study, study.of(Role.TRAIN)), weights))
    count = len(fitter.nominal)
    fit = fitter.fit(effects, z[:count], z[count:] if effects else None)
    return fit.log_evidence if math.isfinite(fit.cost) else -math.inf
