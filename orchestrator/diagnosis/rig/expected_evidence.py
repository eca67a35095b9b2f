"""Evidence between fitted candidates that a future experiment is expected to give."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import sqrt
from typing import Any

import numpy as np

from .effect import Effect
from .finding import Augmented
from .fit import Fitter
from .study import Array

# Candidates at least this probable are rivals of the first; how many of them an experiment is chosen for.
RIVAL, RIVALS = 0.01, 4
# Evidence that distinguishes two [nats].
_SEPARATED = 10.0
# Of experiments within so much of the best, the first of the menu is taken: it costs least.
_AS_GOOD = 0.95
_ITERATIONS = 6
# A fit ends when a step lowers the sum of squares by no more than this part of it.
_SETTLED = 1e-4


@dataclass(frozen=True)
class Posterior:
    """Posterior of a candidate's parameters, given the runs.

    Attributes:
        z: all parameters, normalised by their priors; precision: their inverse covariance.
    """

    effects: tuple[Effect, ...]
    z: Array
    precision: Array


def laplace(fitter: Fitter, model: Augmented) -> Posterior:
    """Laplace's approximation at a fitted model; the fit is completed first."""
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
        r = np.concatenate(fitter.residuals(about.effects, at)) / sqrt(fitter.marginal.inflation)
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
    """Evidence over a rival in the logs that another candidate predicts [nats].

    Half of the least sum of squared residuals over the noise and of squared departures of the rival's
    parameters from what the runs at hand say about them.

    Args:
        fitter: of the predicted logs, without noise: the noise is the same for both on average.
        places: parameters of the rival that may move.
    """
    cost = least(fitter, rival, rival.z, places)[1]
    # Where a rival's replay diverges, nothing can be compared.
    return 0.5 * cost if np.isfinite(cost) else 0.0


def chosen(
    menu: Mapping[str, str], between: Sequence[str], evidence: Callable[[str, int, int], float]
) -> dict[str, Any]:
    """The experiment that separates a candidate from its rivals best; the first one of equals.

    If several separate the first candidate from all its rivals, the best one also separates the rivals from
    each other best: one of them may be right. Pairs that none of these distinguishes do not count.

    Args:
        menu: descriptions by name, in order of effort.
        between: the candidates, the first one's rivals after it.
        evidence: that an experiment, by name, is expected to give for one candidate over another, by their
            places in `between` [nats].
    Returns: name, description, expected_evidence [nats] between the two that are separated least, of the
        pairs that count, `between`, evidence by rival of the first, `menu` with the least evidence over a
        rival of each experiment, `leaves`, pairs that stay tied, and `then`, the best experiment for these,
        "" if there is none.
    """
    rivals = range(1, len(between))
    others = list(combinations(rivals, 2))
    expected = {name: {(0, rival): evidence(name, 0, rival) for rival in rivals} for name in menu}
    first = {name: min(pairs.values()) for name, pairs in expected.items()}
    able = [name for name in menu if first[name] >= _SEPARATED]
    for name in able:
        expected[name] |= {pair: evidence(name, *pair) for pair in others}
    counted = [pair for pair in others if any(expected[name][pair] >= _SEPARATED for name in able)]
    least_expected = first
    if able:
        least_expected = {
            name: min([first[name], *(expected[name][pair] for pair in counted)]) for name in able
        }
    best = _cheapest(least_expected)
    left = [pair for pair, value in expected[best].items() if value < _SEPARATED]
    then = ""
    if left:
        again = {
            name: min(pairs[pair] if pair in pairs else evidence(name, *pair) for pair in left)
            for name, pairs in expected.items()
        }
        further = _cheapest(again)
        then = further if again[further] >= _SEPARATED else ""
    return {
        "name": best,
        "description": menu[best],
        "expected_evidence": least_expected[best],
        "between": list(between),
        "evidence": {between[rival]: expected[best][0, rival] for rival in rivals},
        "menu": first,
        "leaves": [[between[one], between[other]] for one, other in left],
        "then": then,
    }


def _cheapest(evidence: Mapping[str, float]) -> str:
    """The first of those that are as good as the best."""
    enough = _AS_GOOD * max(evidence.values())
    return next(name for name, value in evidence.items() if value >= enough)
