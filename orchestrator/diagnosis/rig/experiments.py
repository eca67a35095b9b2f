"""The next experiment: the one that is expected to distinguish tied candidates best."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from .catalogue import SOFTWARE, catalogue
from .components import COMPONENTS, component_of
from .effect import Effect
from .expected_evidence import RIVAL, RIVALS, Posterior, chosen, evidence_over, laplace
from .finding import Augmented, Candidate, Finding, name_of
from .fit import Fitter
from .menu import Experiment, menu_of
from .model import RigModel
from .predicted_runs import Chain, Trial
from .study import Role, Study
from .unsimulated_experiments import without_rival

# Length of the shortest useful run [ticks].
_SHORTEST = 20


def posterior(study: Study, model: Augmented, inflation: float = 1.0) -> Posterior:
    """Posterior of a fitted model's parameters from the training runs; see `expected_evidence.laplace`."""
    return laplace(Fitter(Chain.of(study, study.of(Role.TRAIN), model.effects), inflation), model)


def expected_evidence(
    study: Study, experiment: Experiment, cause: Posterior, rival: Posterior, inflation: float = 1.0
) -> float:
    """Expected evidence of an experiment for a candidate over a rival, if the candidate is right [nats].

    The rival is fitted to the logs that the candidate predicts, its calibration and parameters held by what
    the runs at hand say about them: half of the least sum of squared residuals over the noise and of squared
    departures from there. The noise is the same for both on average. Both calibrations being
    uncertain, the candidate's is taken as it stands, and the rival's may move.

    Args:
        inflation: by which squared residuals are divided, as in `Fitter`.
    """
    values = Fitter(RigModel(study, [])).values(cause.effects, cause.z)
    trial = Trial(
        study, experiment, Augmented(values[0], cause.effects, values[1]), (*cause.effects, *rival.effects)
    )
    if min(len(run) for run in trial.runs) < _SHORTEST:
        return 0.0
    fitter = Fitter(trial, inflation)
    places = range(len(rival.z))
    if _in_software(cause) and _in_software(rival):
        # The replay of software knows no calibration; that of the robot is the same for both.
        count = len(trial.tolerances)
        places = range(count, len(rival.z))
        rival = replace(rival, z=np.concatenate([cause.z[:count], rival.z[count:]]))
    return evidence_over(fitter, rival, places)


def _in_software(one: Posterior) -> bool:
    return bool(one.effects) and all(effect.place in SOFTWARE for effect in one.effects)


def next_experiment(
    study: Study, finding: Finding, among: Sequence[Experiment] | None = None
) -> dict[str, Any] | None:
    """The experiment with the largest expected evidence between the first candidate and its rivals.

    Rivals are its ties, and other candidates of at least 1 % probability; at most four. See
    `expected_evidence.chosen` for how the evidence between them counts.

    Args:
        among: to choose from, in order of effort; by default the menu, with those of installed packages and
            of the study.
    Returns: as `expected_evidence.chosen`; as `unsimulated_experiments.without_rival` where the model of the
        rig holds no rival of the first candidate.
    Raises: ValueError if there is nothing to choose from.
    """
    among = menu_of(study) if among is None else among
    if not among:
        raise ValueError("no experiment to choose from")
    tied = _tied(study, finding)
    if len(tied) < 2:
        return without_rival(study, finding, among)
    places = {effect.place for model in tied.values() for effect in model.effects}
    inflation = max([1.0, *(_residual(finding, place) for place in places)])
    candidates = [posterior(study, model, inflation) for model in tied.values()]
    offered = {one.name: one for one in among}

    def evidence(name: str, cause: int, rival: int) -> float:
        return expected_evidence(study, offered[name], candidates[cause], candidates[rival], inflation)

    return chosen({one.name: one.description for one in among}, list(tied), evidence)


def _residual(finding: Finding, place: str) -> float:
    """Mean square residual of the answer in the logs of a place, over their noise."""
    equal = COMPONENTS[component_of(place)]
    return max(finding.misfit.get(one, 1.0) for one in equal)


def _tied(study: Study, finding: Finding) -> dict[str, Augmented]:
    """The first candidate that the model can replay, its ties and other probable ones, by their effects."""
    if not finding.candidates or not _replayable(finding.candidates[0]):
        return {}
    modelled = [one for one in finding.candidates if _replayable(one)]
    first = modelled[0]
    found = {name_of(first.effects): first.model or finding.recalibrated}
    alone = {one.effects[0]: one for one in modelled if len(one.effects) == 1}
    # What is tied with one effect of several stands, with the others, among the candidates.
    for tie in first.ties if len(first.effects) == 1 else ():
        if tie in alone:
            found[tie] = alone[tie].model or finding.recalibrated
        elif tie in catalogue() and not catalogue()[tie].statistic:
            found[tie] = _fitted(study, catalogue()[tie])
    for one in modelled[1:]:
        if one.probability >= RIVAL and one.model is not None:
            found.setdefault(name_of(one.effects), one.model)
    return dict(list(found.items())[: RIVALS + 1])


def _replayable(candidate: Candidate) -> bool:
    """Whether all effects act in the model; those known by statistics alone do not."""
    return candidate.model is not None and not any(one.statistic for one in candidate.model.effects)


def _fitted(study: Study, effect: Effect) -> Augmented:
    """A tie that no candidate was fitted for."""
    chain = Chain.of(study, study.of(Role.TRAIN), (effect,))
    # Software knows no calibration; its residuals, exact to the log's digits, would drown that of the robot.
    fitter = Fitter(chain.replays[-1])
    nominal = fitter.base((), np.zeros(len(fitter.replay.tolerances)))
    _, base, start = fitter.screen(effect, [nominal])
    fit = fitter.fit((effect,), base.z, start, base.jacobian)
    return Augmented(fit.calibrated, fit.effects, fit.theta)
