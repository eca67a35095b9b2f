"""What the communication step adds to what is replayed, taken off where the logs are better explained so."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from ...base.errors import ConfigError
from ...simulation.run import Prepared, prepare
from ...system.connection import Port
from ..effect import Effect, by_effect
from ..finding import NOMINAL, Augmented
from ..fit import Fit
from ..headline import nats
from ..search import Search, search
from ..search_progress import stage, twice
from ..study import Array
from ..verdict import Warned
from .effect import PortEffect
from .replay import PortReplay, Weighted, candidates_of
from .seek import is_noise
from .study import PortRun, PortStudy, Role
from .tempering import Tempering
from .wary import WaryFitter
from .weigh import Weighed, weigh_ports

__all__ = ["Stepped", "told_of_step", "weighed_without_step", "with_steps"]

# By how much shorter the step is at most by which its error is reported, and with which a study goes on then.
_SHORTEST, _ONWARD = 32, 8
# An error of the step that moves the weighed residuals by less makes nothing that logs could tell [nats].
_UNSEEN = 1.0
# Share of an error that is just not seen, the inverse of it, to which steps are shortened to go on with.
_BELOW = 4.0
# How many single effects are tried besides the answer, with the error of the step off.
_OTHERS = 3
# Log evidence by which shorter steps explain less, from which on the machine itself takes the step [nats].
_WORSE = 10.0


@dataclass(frozen=True)
class _Limit:
    """Two studies with shorter steps, the second with half as long ones: what they give leads to no steps.

    An error that halves with the step, as that of signals held over steps, is gone in twice the second less
    the first (Richardson's extrapolation); of one that falls faster, more is left than in the second alone,
    but less than in the first.

    Attributes:
        own: the study whose step it is.
        onward: by how much shorter steps are whose error is not seen, without extrapolation.
    """

    own: PortStudy
    longer: PortStudy
    shorter: PortStudy
    onward: int
    # Each replay unpacks the FMUs, which takes longer than short runs.
    _kept: dict[tuple[int, str], PortReplay] = field(default_factory=dict, compare=False, repr=False)

    def errors(self, run: PortRun, model: Augmented) -> dict[Port, Array]:
        """What a model gives of a run without steps, less that with the study's, by compared port."""
        coarse, before, after = (
            self._signals(one, run, model) for one in (self.own, self.longer, self.shorter)
        )
        return {port: 2.0 * after[port] - before[port] - coarse[port] for port in coarse}

    def _signals(self, study: PortStudy, run: PortRun, model: Augmented) -> dict[Port, Array]:
        key = study.parts, run.name
        if key not in self._kept:
            self._kept[key] = PortReplay(study, [run])
        return self._kept[key].signals(run, model.calibrated, model.effects, model.theta)


class Stepped(NamedTuple):
    """What was found once the error of the step was looked at.

    Attributes:
        study: with shorter steps where they are right.
        worse: by how much less the logs are explained without the step's error [nats]; 0 if they are not.
    """

    study: PortStudy
    weighed: Weighed
    worse: float = 0.0


def weighed_without_step(study: PortStudy, tempering: Tempering) -> Stepped:
    """Weigh a study's candidates; again without the step's own error, where that explains the logs better.

    What a step is too long for, effects imitate: a delay of half a step, a gain of what oscillates. Its error
    is what a model gives without steps, see `_Limit`, less what it gives with the step as configured. That
    hardly depends on the effects, but for those at compared outputs, which act on it, too; so that one
    model's stands for all: that of the answer, of it less one of its effects, of none, or as believed,
    whichever explains the train runs best with its error taken off. If it explains them better than the
    answer did before, all candidates are weighed so; at once where that is plain, see `_plainly`. Components
    that work at that very step, as digital controllers do, explain less with another.

    A system whose steps are exact, as that of a linear one whose inputs are held, may miss something with
    the answer alone: dry friction switches from one sample to the next.
    """
    if (plain := _plainly(study)) is not None:
        onward, corrected = plain
        return Stepped(onward, weigh_ports(corrected, tempering))
    weighed = weigh_ports(study, tempering)
    stage("step")
    top = weighed.top
    own = _limit(study, weighed.weights, NOMINAL)
    limit = own or _limit(study, weighed.weights, Augmented(top.calibrated, top.effects, top.theta))
    if limit is None:
        return Stepped(study, weighed)
    places = range(len(top.effects))
    count = len(study.nominal)
    models = [((*top.effects[:place], *top.effects[place + 1 :]), top.without(place)) for place in places]
    models += [(top.effects, top.z), ((), top.z[:count]), ((), np.zeros(count))]
    distinct = {(effects, z.tobytes()): (effects, z) for effects, z in models}
    before = _evidence(study, top.effects, top.z, weighed.weights)
    tried = [(_corrected(study, limit, effects, z), effects, z) for effects, z in distinct.values()]
    # Where a model runs away with shorter steps, it says nothing of the error of the step.
    steady = [one for one in tried if all(map(_finite, one[0].runs))]
    if not steady:
        return Stepped(study, weighed)
    found = [_evidence(*one, weighed.weights) for one in steady]
    if own is not None and not max(found) > before:
        # The answer may hold what imitates the error: others were never tried without it.
        for effects, z in _others(study, limit, weighed):
            one = _corrected(study, limit, effects, z), effects, z
            if all(map(_finite, one[0].runs)):
                steady.append(one)
                found.append(_evidence(*one, weighed.weights))
    best = int(np.argmax(found))
    if not found[best] > before:
        worse = before - found[best]
        return Stepped(study, weighed, worse if math.isfinite(worse) else 0.0)
    return Stepped(_onward(study, limit), weigh_ports(steady[best][0], tempering))


def _onward(study: PortStudy, limit: _Limit) -> PortStudy:
    """The study with the steps to go on with."""
    # FMUs may refuse steps that are shorter still than those by which the error was reported.
    halvings = range(int(math.log2(limit.onward)), 0, -1)
    shorter = (with_steps(study, 2**number) for number in halvings)
    return next(one for one in shorter if one is not None)


def _plainly(study: PortStudy) -> tuple[PortStudy, PortStudy] | None:
    """The study with shorter steps, and that with the error of its step taken off, where it is plain at once
    that the latter is right: with it a model of one effect or none leaves nothing but noise, without it none
    of these does.

    Then no answer explains the logs better, whatever effects it holds, and none need be sought with the error
    of the step in them, which takes most of the time.
    """
    replay = PortReplay(study, study.of(Role.TRAIN))
    none = WaryFitter(replay).fit(())
    if not math.isfinite(none.cost) or is_noise(replay, none):
        return None
    limit = _limit(study, dict.fromkeys(study.compared, 1.0), NOMINAL)
    if limit is None:
        return None
    tried = [_corrected(study, limit, (), z) for z in (none.z, np.zeros_like(none.z))]
    steady = [one for one in tried if all(map(_finite, one.runs))]
    if not steady:
        return None
    found = [(one, _left(one, ())) for one in steady]
    without, least = min(found, key=lambda one: one[1].cost)
    if is_noise(PortReplay(without, without.of(Role.TRAIN)), least):
        return _onward(study, limit), without
    effects = candidates_of(study)
    if is_noise(replay, _singles(replay, WaryFitter(replay), effects).best):
        return None
    again = PortReplay(without, without.of(Role.TRAIN))
    for fit in _singles(again, WaryFitter(again), effects).fits[:_OTHERS]:
        # What the step makes of the model with the effect may be a little else than of that without.
        corrected = _corrected(study, limit, fit.effects, fit.z)
        if all(map(_finite, corrected.runs)) and is_noise(
            PortReplay(corrected, corrected.of(Role.TRAIN)), _left(corrected, fit.effects, fit.z)
        ):
            return _onward(study, limit), corrected
    twice()
    return None


def _left(study: PortStudy, effects: tuple[Effect, ...], z: Array | None = None) -> Fit:
    """A fit to the train runs of a study, from normalised parameters on."""
    fitter = WaryFitter(PortReplay(study, study.of(Role.TRAIN)))
    count = len(fitter.nominal)
    return fitter.fit(effects) if z is None else fitter.fit(effects, z[:count], z[count:])


def _singles(replay: PortReplay, fitter: WaryFitter, effects: Sequence[Effect]) -> Search:
    """Fits of single effects.

    Args:
        replay: what the fitter fits to, whatever it weighs.
    """
    with threadpool_limits(limits=1, user_api="blas"):
        workers = 2 if replay.player.parallel else 1
        return search(fitter, effects, longest=1, workers=workers)


def _others(study: PortStudy, limit: _Limit, weighed: Weighed) -> list[tuple[tuple[Effect, ...], Array]]:
    """Single effects that explain the logs best once the error of the step is off, that of the model as
    believed: with their fits' normalised parameters.
    """
    corrected = _corrected(study, limit, (), np.zeros(len(study.nominal)))
    if not all(map(_finite, corrected.runs)):
        return []
    replay = PortReplay(corrected, corrected.of(Role.TRAIN))
    fitter = WaryFitter(Weighted.of(replay, weighed.weights))
    fits = _singles(replay, fitter, weighed.effects).fits
    return [(one.effects, one.z) for one in fits[:_OTHERS]]


def told_of_step(found: Stepped, configured: PortStudy) -> list[Warned] | None:
    """What to say about a step other than the configured one, or of that as the machine's; None: nothing."""
    study = found.study
    step, before = (f"{1e3 * float(one.prepared.grid.step_size):g} ms" for one in (study, configured))
    interval = f"{1e3 * study.interval:g} ms"
    if study.parts == configured.parts:
        if not found.worse > _WORSE:
            return None
        what = (
            f"shorter steps than {step} explain the logs less, by {nats(found.worse)}: the machine itself is "
        )
        what += "taken to work in these, as a digital controller or a simulation does, or the answer lacks "
        what += "an effect"
        return [Warned(place="numerics", what=what, remedy="")]
    return [
        Warned(
            place="numerics",
            what=f"the error of the configured step, {before}, shows in the logs: without it they are "
            f"explained better, so that it is taken off, and steps of {step} are taken",
            remedy=f"augmented.yaml has these steps. Set run.step_size to {step} and the study's interval to "
            f"{interval} to have them from the begin.",
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


def _apart(
    weights: Mapping[Port, float], replay: PortReplay, one: Sequence[Array], other: Sequence[Array]
) -> float:
    """Log likelihood that residuals tell from others, by channel [nats]."""
    pairs = zip(replay.channels, one, other, strict=True)
    return 0.5 * sum(
        (weights.get(port, 0.0) * float(np.linalg.norm(a - b))) ** 2 for (_, port), a, b in pairs
    )


def _limit(study: PortStudy, weights: Mapping[Port, float], model: Augmented) -> _Limit | None:
    """Steps short enough to say what none would give; None if the study's own are, or it takes no other.

    Args:
        model: whose signals tell.
    """
    runs = study.of(Role.TRAIN)
    longer, given = study, PortReplay(study, runs).of(model)
    own, extrapolated, found, parts = given, given, None, 2
    while parts <= _SHORTEST:
        shorter = with_steps(study, parts)
        if shorter is None:
            return found
        replay = PortReplay(shorter, runs)
        now = replay.of(model)
        before, extrapolated = (
            extrapolated,
            [2.0 * one - other for one, other in zip(now, given, strict=True)],
        )
        if not _apart(weights, replay, extrapolated, before) > _UNSEEN:
            return found
        # What steps miss falls with their length, what that tells with its square.
        least = _BELOW * math.sqrt(_apart(weights, replay, own, extrapolated) / _UNSEEN)
        onward = 2 ** math.ceil(math.log2(min(max(least, 2.0), _ONWARD)))
        found = _Limit(study, longer, shorter, onward)
        longer, given, parts = shorter, now, 2 * parts
    return found


def _finite(run: PortRun) -> bool:
    return all(np.isfinite(one).all() for one in run.errors.values())


def _on_log(study: PortStudy, effect: Effect) -> bool:
    """Whether an effect acts at a compared output."""
    return isinstance(effect, PortEffect) and effect.port in study.compared


def _corrected(study: PortStudy, limit: _Limit, effects: tuple[Effect, ...], z: Array) -> PortStudy:
    """A study that knows the error of its step, by a model.

    Args:
        z: normalised parameters of the model.
    """
    calibrated, theta = WaryFitter(PortReplay(study, [])).values(effects, z)
    # What acts on the way to the log acts on what the step made of the signal, too.
    inside = [one for one in by_effect(effects, theta) if not _on_log(study, one[0])]
    model = Augmented(
        calibrated,
        tuple(effect for effect, _ in inside),
        np.concatenate([np.zeros(0), *(own for _, own in inside)]),
    )
    runs = []
    for run in study.runs:
        runs.append(replace(run, errors=limit.errors(run, model)))
    return replace(study, runs=tuple(runs))


def _evidence(
    study: PortStudy, effects: tuple[Effect, ...], z: Array, weights: Mapping[Port, float]
) -> float:
    """Log evidence of a model, fitted from normalised parameters on [nats]."""
    fitter = WaryFitter(Weighted.of(PortReplay(study, study.of(Role.TRAIN)), weights))
    count = len(fitter.nominal)
    fit = fitter.fit(effects, z[:count], z[count:] if effects else None)
    return fit.log_evidence if math.isfinite(fit.cost) else -math.inf
