"""Shares of the closed-loop gap by component: Shapley values over short windows of the held-out runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import factorial

import numpy as np

from .components import COMPONENTS, component_of, faultless, residuals_of
from .finding import Augmented, Finding
from .motion import contacts
from .restart import Restart
from .study import Array, Role, Run, Study

__all__ = ["Shares", "shapley_shares", "where"]

_COUNT = len(COMPONENTS)
_COALITIONS = [set(some) for size in range(_COUNT + 1) for some in combinations(range(_COUNT), size)]


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
        """Fractions of what all components account for, adding up to 1; equal ones where there is no gap."""
        total = self.values.sum()
        return self.values / total if total > 0.0 else np.full(_COUNT, 1.0 / _COUNT)


def shapley_shares(study: Study, runs: Sequence[Run], model: Augmented) -> Shares:
    """Share out the gap between a model's closed loop and runs.

    Each contact is run from the measured state before it, once per coalition of components whose measured
    residuals are injected: over whole runs model and log would fall out of step, and residuals act at wrong
    times. The gap is the mean square of force over measured peak and velocity over approach speed.
    """
    worth = np.zeros(len(_COALITIONS))
    windows = 0
    for run in runs:
        restart = Restart(study, run, model)
        values = residuals_of(study, run, model).values
        for one in contacts(study, run):
            span = slice(one.begin, one.end)
            velocity, force = run["desired_velocity"][span], run["sensor_force"][span]
            for number, coalition in enumerate(_COALITIONS):
                inject = np.zeros((4, one.end - one.begin + 1))
                for component in coalition:
                    inject[component] = values[component, one.begin : one.end + 1]
                out = restart.ahead(one.begin, one.end - one.begin, inject)
                worth[number] += np.mean(((out[1] - velocity) / abs(velocity[0])) ** 2)
                worth[number] += np.mean(((out[3] - force) / np.abs(force).max()) ** 2)
            windows += 1
    worth /= max(windows, 1)
    return Shares(_values(worth), float(worth[0]), float(worth[-1]), windows)


def _values(gaps: Array) -> Array:
    """Shapley values of what coalitions lessen the gap by."""
    values = np.zeros(_COUNT)
    for number, coalition in enumerate(_COALITIONS):
        for component in range(_COUNT):
            if component not in coalition:
                with_it = _COALITIONS.index(coalition | {component})
                weight = factorial(len(coalition)) * factorial(_COUNT - len(coalition) - 1)
                values[component] += weight / factorial(_COUNT) * (gaps[number] - gaps[with_it])
    return values


def where(study: Study, finding: Finding) -> Mapping[str, float]:
    """Shares of the held-out closed-loop gap by place, adding up to 1.

    Signals tell components apart; within one, its share goes to its places as probable as the candidates
    make them, or to all alike where no candidate lies in it.

    Returns: share by place; negative where a component hides another's part.
    """
    shares = shapley_shares(study, study.of(Role.HELDOUT), faultless(study, finding)).shares
    told = dict.fromkeys(sum(COMPONENTS.values(), ()), 0.0)
    for candidate in finding.candidates:
        places = [one.partition(".")[0] for one in candidate.effects if one != "outside"]
        if candidate.effects == ("outside",):
            places = [finding.outside_place] if finding.outside_place else []
        for place in places:
            component_of(place)  # refuses places that the rig does not have
            told[place] += candidate.probability / len(places)
    shared = {}
    for share, places in zip(shares.tolist(), COMPONENTS.values(), strict=True):
        mass = sum(told[place] for place in places)
        for place in places:
            shared[place] = share * (told[place] / mass if mass > 0.0 else 1.0 / len(places))
    return shared
