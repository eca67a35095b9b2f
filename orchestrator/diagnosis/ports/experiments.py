"""What to run next on any system: the experiment that is expected to tell tied answers apart best."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from ...system import Port
from ..effect import Effect
from ..finding import Augmented, Finding, name_of
from ..fit import Fitter
from ..outlook import RIVAL, RIVALS, Posterior, chosen, evidence_over, laplace
from ..study import Nominal
from .replay import PortReplay, Weighted
from .study import PortRun, PortStudy, Role, Trial

__all__ = ["next_experiment", "no_experiment", "tried"]


def no_experiment(study: PortStudy, finding: Finding) -> str:
    """Why nothing can be proposed; "" if it can, or nothing needs to be."""
    if not study.trials:
        return "the study names no experiments"
    if finding.effects == ("outside",):
        return "the answer is outside the candidates: there is no law to simulate"
    return ""


def tried(study: PortStudy, trial: Trial) -> PortStudy:
    """The study as it is in an experiment: its system, calibrated numbers moved as the settings move them.

    What logs replaced comes from the system itself, but for free inputs, which stand at their start values.
    """
    system = trial.prepared.system
    nominal = {}
    for name, one in study.nominal.items():
        port = Port.of(name)
        before, after = (two.start(port) for two in (study.prepared.system, system))
        nominal[name] = Nominal(one.value + after - before, one.tolerance)
    columns = {port: _without_start(one) for port, one in study.columns.items()}
    fed = tuple(port for port in study.fed if port in study.compared)
    return replace(study, prepared=trial.prepared, nominal=nominal, columns=columns, fed=fed, runs=())


def _without_start(column: Any) -> Any:
    """A column whose first sample is no start value: an experiment that was not made has none."""
    return column.model_copy(update={"start": False})


def predicted(study: PortStudy, cause: Augmented) -> PortRun:
    """A run of an experiment as a candidate makes it, without noise."""
    samples = study.prepared.grid.steps // study.parts + 1
    open_study = replace(study, fed=())
    empty = PortRun("trial", Role.TRAIN, {study.compared[0]: np.zeros(samples)})
    replay = PortReplay(open_study, [empty])
    logs = replay.signals(empty, cause.calibrated, cause.effects, cause.theta)
    return PortRun("trial", Role.TRAIN, logs)


def next_experiment(
    study: PortStudy, finding: Finding, weights: Mapping[Port, float], effects: tuple[Effect, ...]
) -> dict[str, Any] | None:
    """The experiment with the largest expected evidence between the first candidate and its rivals.

    Each is simulated as a candidate predicts it, and a rival fitted to that, held by what the train runs tell
    of its parameters; see `outlook.evidence_over`, and `outlook.chosen` for how the evidence counts.

    Args:
        weights: of the compared ports' residuals, as fits took them.
        effects: all candidates.
    Returns: as `outlook.chosen`; None where nothing rivals the first candidate.
    """
    models = _tied(study, finding, weights, effects)
    if len(models) < 2 or not study.trials:
        return None
    train = PortReplay(study, study.of(Role.TRAIN))
    with threadpool_limits(limits=1, user_api="blas"):
        candidates = [laplace(Fitter(Weighted.of(train, weights)), one) for one in models.values()]
        trials = {trial.name: tried(study, trial) for trial in study.trials}

        def evidence(name: str, cause: int, rival: int) -> float:
            return _expected(study, trials[name], candidates[cause], candidates[rival], weights)

        return chosen({one.name: one.description for one in study.trials}, list(models), evidence)


def _expected(
    study: PortStudy, then: PortStudy, cause: Posterior, rival: Posterior, weights: Mapping[Port, float]
) -> float:
    """Evidence of an experiment for a candidate over a rival [nats]."""
    empty = Fitter(PortReplay(then, []))
    calibrated, theta = empty.values(cause.effects, cause.z)
    run = predicted(then, Augmented(calibrated, cause.effects, theta))
    if not all(np.isfinite(values).all() for values in run.logs.values()):
        return 0.0
    then = replace(then, runs=(run,), settled=min(study.settled, len(run) // 2))
    fitter = Fitter(Weighted.of(PortReplay(then, [run]), weights))
    return evidence_over(fitter, rival, range(len(rival.z)))


def _tied(
    study: PortStudy, finding: Finding, weights: Mapping[Port, float], effects: tuple[Effect, ...]
) -> dict[str, Augmented]:
    """The first candidate, its ties and other probable ones, by their effects."""
    first = finding.candidates[0] if finding.candidates else None
    if first is None or first.model is None:
        return {}
    found = {name_of(first.effects): first.model}
    alone = {one.effects[0]: one for one in finding.candidates if len(one.effects) == 1}
    known = {one.id: one for one in effects}
    for tie in first.ties if len(first.effects) == 1 else ():
        model = alone[tie].model if tie in alone else None
        found[tie] = model or _fitted(study, known[tie], weights)
    for one in finding.candidates[1:]:
        if one.probability >= RIVAL and one.model is not None:
            found.setdefault(name_of(one.effects), one.model)
    return dict(list(found.items())[: RIVALS + 1])


def _fitted(study: PortStudy, effect: Effect, weights: Mapping[Port, float]) -> Augmented:
    """A tie that no candidate was fitted for."""
    fitter = Fitter(Weighted.of(PortReplay(study, study.of(Role.TRAIN)), weights))
    base = fitter.base((), fitter.nominal)
    _, base, start = fitter.screen(effect, [base])
    fit = fitter.fit((effect,), base.z, start, base.jacobian)
    return Augmented(fit.calibrated, fit.effects, fit.theta)
