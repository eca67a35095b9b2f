"""What to run next on any system: the experiment that is expected to distinguish tied answers best."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from ...fmi import Kind
from ...system.connection import Port
from ..answers import Answer
from ..effect import Effect
from ..expected_evidence import RIVAL, RIVALS, Posterior, chosen, evidence_over, laplace
from ..finding import Augmented, Finding, name_of
from ..fit import Fitter
from ..study import Nominal
from .apart import driven_of
from .replay import PortReplay, Weighted, measure
from .study import PortRun, PortStudy, Role, Trial

__all__ = ["next_experiment", "no_experiment", "sensors", "tried"]

# Noise of a sensor that was not there, as a share of its signal's spread; and how many are tried at most.
_SENSOR, _SENSORS = 1e-3, 3


def no_experiment(study: PortStudy, finding: Finding) -> str:
    """Why nothing can be proposed; "" if it can, or nothing needs to be."""
    if not study.trials and not _silent(study):
        return "the study names no experiments, and all outputs are logged"
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


@dataclass(frozen=True)
class _Planned:
    """An experiment: the study as it is then, without runs; like: a run whose inputs it takes, if any."""

    description: str
    study: PortStudy
    like: PortRun | None = None


def _silent(study: PortStudy) -> list[Port]:
    """Outputs that were not logged, of what is driven: of sources they are known."""
    system, driven = study.prepared.system, driven_of(study)
    reals = [port for port in system.recorded if system.variable(port).kind is Kind.REAL]
    return [port for port in reals if port not in study.columns and port.instance in driven]


def sensors(study: PortStudy, models: Sequence[Augmented]) -> dict[str, _Planned]:
    """The first train run again, with one more output logged: those at which models differ most.

    Each is taken to have a thousandth of its signal's spread as noise, as the description says.
    """
    silent = _silent(study)
    if not silent:
        return {}
    like = study.of(Role.TRAIN)[0]
    spread = measure(study, like).spread
    replay = PortReplay(study, [like], seen=silent)
    first, *rivals = (replay.signals(like, one.calibrated, one.effects, one.theta) for one in models)
    apart = {}
    for port in silent:
        differ = min(float(np.std((first[port] - one[port])[study.settled :])) for one in rivals)
        if spread[port] > 0.0 and np.isfinite(differ) and differ > 0.0:
            apart[port] = differ / spread[port]
    found = {}
    for port in sorted(apart, key=lambda port: -apart[port])[:_SENSORS]:
        noise = _SENSOR * spread[port]
        unit = "" if study.unit(port) == "1" else f" {study.unit(port)}"
        column = study.columns[study.compared[0]].model_copy(
            update={"column": str(port), "noise": noise, "feed": False, "start": False}
        )
        then = replace(
            study,
            columns={**study.columns, port: column},
            compared=(*study.compared, port),
            runs=(),
        )
        text = f"{like.name} again, with {port} logged, too, by a sensor with a noise of {noise:.2g}{unit}"
        found[f"log {port}"] = _Planned(text, then, like)
    return found


def predicted(study: PortStudy, cause: Augmented, like: PortRun | None = None) -> PortRun:
    """A run of an experiment as a candidate makes it, without noise.

    Args:
        like: run whose logs take the place of what is fed and not compared; None: nothing is fed.
    """
    fed = study.given if like else ()
    samples = study.prepared.grid.steps // study.parts + 1
    empty = like or PortRun("trial", Role.TRAIN, {study.compared[0]: np.zeros(samples)})
    replay = PortReplay(replace(study, fed=fed), [empty])
    logs = replay.signals(empty, cause.calibrated, cause.effects, cause.theta)
    return PortRun(
        "trial", Role.TRAIN, {**{port: empty.logs[port] for port in fed if port in empty.logs}, **logs}
    )


def next_experiment(
    study: PortStudy,
    finding: Finding,
    weights: Mapping[Port, float],
    effects: tuple[Effect, ...],
    answers: Sequence[Answer] = (),
) -> dict[str, Any] | None:
    """The experiment with the largest expected evidence between the first candidate and its rivals.

    Of those that the study names, and runs as before with one more output logged. Each is simulated as a
    candidate predicts it, and a rival fitted to that, held by what the train runs tell of its parameters; see
    `expected_evidence.evidence_over`, and `expected_evidence.chosen` for how the evidence counts.

    Args:
        weights: of the compared ports' residuals, as fits took them.
        effects: all candidates; answers: with their fits, ties among them.
    Returns: as `expected_evidence.chosen`; None where nothing rivals the first candidate.
    """
    models = _tied(study, finding, weights, effects, answers)
    if len(models) < 2:
        return None
    train = PortReplay(study, study.of(Role.TRAIN))
    with threadpool_limits(limits=1, user_api="blas"):
        candidates = [laplace(Fitter(Weighted.of(train, weights)), one) for one in models.values()]
        menu = {trial.name: _Planned(trial.description, tried(study, trial)) for trial in study.trials}
        menu |= sensors(study, list(models.values()))
        if not menu:
            return None

        def evidence(name: str, cause: int, rival: int) -> float:
            return _expected(menu[name], candidates[cause], candidates[rival], weights)

        return chosen({name: one.description for name, one in menu.items()}, list(models), evidence)


def _expected(planned: _Planned, cause: Posterior, rival: Posterior, weights: Mapping[Port, float]) -> float:
    """Evidence of an experiment for a candidate over a rival [nats].

    Args:
        weights: of the compared ports' residuals; of a port that is logged for the first time, 1.
    """
    then = planned.study
    empty = Fitter(PortReplay(then, []))
    calibrated, theta = empty.values(cause.effects, cause.z)
    run = predicted(then, Augmented(calibrated, cause.effects, theta), planned.like)
    weights = {**dict.fromkeys(then.compared, 1.0), **weights}
    if not all(np.isfinite(values).all() for values in run.logs.values()):
        return 0.0
    then = replace(then, runs=(run,), settled=min(then.settled, len(run) // 2))
    fitter = Fitter(Weighted.of(PortReplay(then, [run]), weights))
    return evidence_over(fitter, rival, range(len(rival.z)))


def _tied(
    study: PortStudy,
    finding: Finding,
    weights: Mapping[Port, float],
    effects: tuple[Effect, ...],
    answers: Sequence[Answer],
) -> dict[str, Augmented]:
    """The first candidate, its ties and other probable ones, by their effects."""
    first = finding.candidates[0] if finding.candidates else None
    if first is None or first.model is None:
        return {}
    found = {name_of(first.effects): first.model}
    known = {one.id: one for one in effects}
    for tie in first.ties:
        swapped = [{tie, *first.effects} - {gone} for gone in first.effects]
        fits = [one.fit for one in answers if one.fit is not None and set(one.effects) in swapped]
        if fits:
            best = min(fits, key=lambda fit: fit.cost)
            model = Augmented(best.calibrated, best.effects, best.theta)
            found[name_of([one.id for one in best.effects])] = model
        elif len(first.effects) == 1:
            found[tie] = _fitted(study, known[tie], weights)
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
