"""Learn the roughness of rigs without hidden effects, along each effect of the catalogue."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from orchestrator.diagnosis.rig.catalogue import of_hardware
from orchestrator.diagnosis.rig.fit import Fitter
from orchestrator.diagnosis.rig.model import RigModel
from orchestrator.diagnosis.rig.nuisance import Weighted, scatter, settling_weights, waves
from orchestrator.diagnosis.rig.search import directions
from orchestrator.diagnosis.rig.study import Array, Role, Study

from .simulated_cases import bare_study

__all__ = ["RoughnessProblem", "learn_roughness", "roughness_problem"]

# Shares of the priors between which what is learned is kept: rigs may be rough in other ways than those
# practised on, if hardly by more than shows; and directions that hardly move any residual say nothing of
# themselves.
_LEAST, _MOST = 0.003, 0.015
_ROUNDS = 3000


@dataclass(frozen=True)
class RoughnessProblem:
    """Linear problem: residuals of a rig without hidden effects, projected on the effects.

    Attributes:
        ids: of the effects, one per direction, those of an effect in the order of its shape's starts.
        hessian, slope: of half the squared residuals by the calibration, in tolerances, and then by the
            effects' sizes, in priors.
        calibrated: where the calibration is taken, in tolerances.
    """

    ids: tuple[str, ...]
    hessian: Array
    slope: Array
    calibrated: Array


def roughness_problem(study: Study) -> RoughnessProblem:
    """The linear problem of a study's train runs."""
    model = RigModel(study, study.of(Role.TRAIN))
    weights = [settling_weights(len(run)) for run in model.runs for _ in range(2)]
    replay = Weighted(model, weights)
    none = Fitter(replay).fit(())
    # What is reckoned with besides is none of it: contacts that scatter, waves of the encoder.
    further = [
        scatter(model, replay, none),
        waves(model, Fitter(replay).marginal.left(none.residuals), weights),
    ]
    fitter = Fitter(replay, 1.0, np.hstack([one for one in further if one is not None]))
    base = fitter.base((), fitter.fit(()).z)
    found = directions(fitter, of_hardware(), base.z)
    jacobian = np.column_stack([base.jacobian, *(one.column for one in found)])
    ids = tuple(one.effect.id for one in found)
    return RoughnessProblem(ids, jacobian.T @ jacobian, jacobian.T @ base.r, base.z)


def roughness_problem_of_rig(seed: int, number: int) -> RoughnessProblem:
    """The same of a simulated rig that hides nothing."""
    return roughness_problem(bare_study(seed, number, (Role.TRAIN,)))


def learn_roughness(problems: Sequence[RoughnessProblem]) -> Mapping[str, tuple[float, ...]]:
    """Maximum-likelihood standard deviations of the roughness, all effects jointly.

    Sizes are normal about zero, with a variance of each direction's own; expectation maximisation (MacKay:
    Bayesian interpolation, Neural Computation 4, 1992). What other directions explain as well comes out
    small.

    Returns: by effect, one per direction, as shares of its prior.
    """
    ids = problems[0].ids
    count = len(problems[0].calibrated)
    variance = np.full(len(ids), 1e-4)
    for _ in range(_ROUNDS):
        total = np.zeros(len(ids))
        for one in problems:
            precision = np.concatenate([np.ones(count), 1.0 / variance])
            covariance = np.linalg.inv(one.hessian + np.diag(precision))
            pulled = one.slope + np.concatenate([one.calibrated, np.zeros(len(ids))])
            mean = -covariance @ pulled
            total += mean[count:] ** 2 + np.diag(covariance)[count:]
        variance = np.maximum(total / len(problems), 1e-9)
    found: dict[str, list[float]] = {}
    for name, value, shows in zip(ids, np.sqrt(variance), _showing(problems), strict=True):
        size = float(np.clip(value, min(_LEAST, shows), _MOST))
        found.setdefault(name, []).append(round(size, 5))
    return {name: tuple(values) for name, values in sorted(found.items())}


def _showing(problems: Sequence[RoughnessProblem]) -> Array:
    """Sizes that move residuals by one standard deviation beyond the calibration, by direction."""
    information = np.zeros(len(problems[0].ids))
    for one in problems:
        count = len(one.calibrated)
        across = one.hessian[:count, count:]
        explained = np.linalg.solve(one.hessian[:count, :count] + np.eye(count), across)
        information += np.diag(one.hessian)[count:] - np.sum(across * explained, axis=0)
    return 1.0 / np.sqrt(np.maximum(information / len(problems), 1e-12))
