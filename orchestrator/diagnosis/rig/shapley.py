"""Shares of the closed-loop gap by component: Shapley values over short windows of the held-out runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import factorial

import numpy as np

from .components import COMPONENTS, residuals_of
from .finding import Augmented, Finding
from .motion import contacts
from .restart import Restart, contact_error
from .study import Array, Role, Run, Study

_COUNT = len(COMPONENTS)
# None first, all last.
_COALITIONS = [frozenset(some) for size in range(_COUNT + 1) for some in combinations(range(_COUNT), size)]


@dataclass(frozen=True)
class Shares:
    """Shapley values of the components.

    Attributes:
        values: of each component, in the order of `COMPONENTS`, shape (4,): by how much its measured
            residual, injected, lessens the gap. They add up to `gap - left`.
        gap, left: mean square of model minus log over the windows, without residuals and with all injected.
        windows: how many.
    """

    values: Array
    gap: float
    left: float
    windows: int

    @property
    def shares(self) -> Array:
        """Shares of the components, adding up to 1; equal ones if there is no gap."""
        total = self.values.sum()
        return self.values / total if total > 0.0 else np.full(_COUNT, 1.0 / _COUNT)


def shapley_shares(study: Study, runs: Sequence[Run], model: Augmented) -> Shares:
    """Share out the gap between a model's closed loop and runs.

    Each contact is run from the measured state before it, once per coalition of components whose measured
    residuals are injected: over complete runs model and log would fall out of step, and residuals act at
    wrong times. The gap is the mean square of force over measured peak and velocity over approach speed.
    """
    worth = np.zeros(len(_COALITIONS))
    windows = 0
    for run in runs:
        restart = Restart(study, run, model)
        values = residuals_of(study, run, model).values
        for one in contacts(study, run):
            for number, coalition in enumerate(_COALITIONS):
                inject = np.zeros((4, one.end - one.begin + 1))
                for component in coalition:
                    inject[component] = values[component, one.begin : one.end + 1]
                out = restart.ahead(one.begin, one.end - one.begin, inject)
                worth[number] += np.mean(contact_error(run, one, out) ** 2, axis=1).sum()
            windows += 1
    worth /= max(windows, 1)
    return Shares(shapley_values(worth.tolist()), float(worth[0]), float(worth[-1]), windows)


def shapley_values(gaps: Sequence[float]) -> Array:
    """Shapley values of the reduction of a gap by coalitions of components.

    Args:
        gaps: by coalition, those of no component first, that of all last, in the order of `combinations`.
    Returns: by component, shape (4,); they add up to the gap of none less that of all.
    """
    found = dict(zip(_COALITIONS, gaps, strict=True))
    values = np.zeros(_COUNT)
    for coalition in _COALITIONS:
        for player in set(range(_COUNT)) - coalition:
            weight = factorial(len(coalition)) * factorial(_COUNT - len(coalition) - 1)
            lessened = found[coalition] - found[coalition | {player}]
            values[player] += weight / factorial(_COUNT) * lessened
    return values


def where(study: Study, finding: Finding) -> Mapping[str, float]:
    """Shares of the held-out closed-loop gap by place, adding up to 1.

    Signals distinguish components; within one, its share goes to its places as probable as the candidates
    make them, or equally to all where no candidate lies in it.

    Returns: share by place; negative where a component hides another's part.
    """
    shares = shapley_shares(study, study.of(Role.HELDOUT), finding.faultless(study.nominal)).shares.tolist()
    probability = dict.fromkeys((place for places in COMPONENTS.values() for place in places), 0.0)
    for candidate in finding.candidates:
        places = [one.partition(".")[0] for one in candidate.effects if one != "outside"]
        if candidate.effects == ("outside",) and finding.outside_place:
            places = [finding.outside_place]
        for place in places:
            probability[place] += candidate.probability / len(places)
    shared: dict[str, float] = {}
    for share, places in zip(shares, COMPONENTS.values(), strict=True):
        mass = sum(probability[place] for place in places)
        for place in places:
            shared[place] = share * (probability[place] / mass if mass > 0.0 else 1.0 / len(places))
    return shared
