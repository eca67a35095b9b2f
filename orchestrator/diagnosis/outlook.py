"""What an experiment that was not made yet is expected to tell between fitted candidates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import sqrt
from typing import Any

import numpy as np

from .effect import Effect
from .finding import Augmented
from .fit import Fitter
from .study import Array

__all__ = ["RIVAL", "RIVALS", "Posterior", "chosen", "evidence_over", "laplace", "least", "named"]

# Candidates at least this probable are rivals of the first; how many of them an experiment is chosen for.
RIVAL, RIVALS = 0.01, 4
# Evidence that tells two apart [nats].
_TOLD_APART = 10.0
# Of experiments within so much of the best, the first of the menu is taken: it costs least.
_AS_GOOD = 0.95
_ITERATIONS = 6
# A fit ends when a step lowers the sum of squares by no more than this part of it.
_SETTLED = 1e-4


@dataclass(frozen=True)
class Posterior:
    """What the runs at hand tell of a candidate's parameters.

    Attributes:
        z: all parameters, normalised by their priors; precision: their inverse covariance.
    """

    effects: tuple[Effect, ...]
    z: Array
    precision: Array


def laplace(fitter: Fitter, model: Augmented) -> Posterior:
    """Laplace's approximation at a fitted model; the fit is taken to its end."""
    z = fitter.normalised(model.calibrated, model.effects, model.theta)
    prior = Posterior(model.effects, np.zeros(len(z)), np.eye(len(z)))
    z, _, hessian = least(fitter, prior, z, range(len(z)))
    return Posterior(model.effects, z, hessian)


def least(fitter: Fitter, about: Posterior, z: Array, places: Sequence[int]) -> tuple[Array, float, Array]:
    """Least sum of squared residuals and departures from a posterior, by damped Gauss-Newton steps.

    Args:
        z: where to begin; places: parameters that may move.
    Returns: normalised parameters, the sum there, and its Hessian's half at the last linearisation.
    """

    def tried(at: Array) -> tuple[float, Array]:
        r = np.concatenate(fitter.residuals(about.effects, at)) / sqrt(fitter.inflation)
        step = at - about.z
        with np.errstate(over="ignore", invalid="ignore"):
            cost = float(r @ r + step @ about.precision @ step)
        return (cost if np.isfinite(cost) else np.inf), r

    cost, r = tried(z)
    hessian = about.precision
    free = np.array(places, np.intp)
    for _ in range(_ITERATIONS):
        if not np.isfinite(cost):
            break
        # Also divides by the inflation: its residuals are those that it is given.
        jacobian = fitter.jacobian(about.effects, z, r, places)
        hessian = jacobian.T @ jacobian + about.precision
        slope = jacobian.T @ r + about.precision @ (z - about.z)
        step = np.zeros(len(z))
        step[free] = np.linalg.solve(hessian[np.ix_(free, free)], slope[free])
        before = cost
        for share in (1.0, 0.3, 0.1):
            cost_ahead, r_ahead = tried(z - share * step)
            if cost_ahead < cost:
                z, r, cost = z - share * step, r_ahead, cost_ahead
                break
        if before - cost < _SETTLED * cost + 0.1:
            break
    return z, cost, hessian


def evidence_over(fitter: Fitter, rival: Posterior, places: Sequence[int]) -> float:
    """Evidence over a rival that logs give which another candidate predicts [nats].

    Half of the least sum of squared residuals over the noise and of squared departures of the rival's
    parameters from what the runs at hand tell of them.

    Args:
        fitter: of the predicted logs, without noise: what is left of it is the same for both on average.
        places: parameters of the rival that may move.
    """
    cost = least(fitter, rival, rival.z, places)[1]
    # Where a rival's replay has no end, nothing was simulated that could tell.
    return 0.5 * cost if np.isfinite(cost) else 0.0


def chosen(menu: Mapping[str, str], expected: Mapping[str, Array], between: Sequence[str]) -> dict[str, Any]:
    """The experiment that tells a candidate from its rivals best; of those as good, the first.

    Args:
        menu: descriptions by name, in order of effort; expected: evidence over each rival [nats], by name.
        between: the candidates, the first one's rivals after it.
    Returns: name, description, expected_evidence [nats] over the rival that is told apart least, between,
        evidence by rival, `menu` with the number of each experiment, and `then`, the best one for what the
        first one leaves tied, "" if there is none.
    """
    least_told = {name: float(values.min()) for name, values in expected.items()}
    best = _cheapest(least_told)
    left = np.flatnonzero(expected[best] < _TOLD_APART)
    further = {name: float(values[left].min()) for name, values in expected.items()} if left.size else {}
    then = _cheapest(further) if further else ""
    return {
        "name": best,
        "description": menu[best],
        "expected_evidence": least_told[best],
        "between": list(between),
        "evidence": dict(zip(between[1:], expected[best].tolist(), strict=True)),
        "menu": least_told,
        "then": then if then != best else "",
    }


def _cheapest(evidence: Mapping[str, float]) -> str:
    """The first of those that are as good as the best."""
    enough = _AS_GOOD * max(evidence.values())
    return next(name for name, value in evidence.items() if value >= enough)


def named(effects: tuple[str, ...]) -> str:
    """A candidate by its effects."""
    return " + ".join(effects) or "none"
