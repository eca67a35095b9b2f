"""Shares of the closed-loop gap by component: Shapley values over short windows of the held-out runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .components import COMPONENTS, component_of, residuals_of
from .finding import Augmented, Finding
from .motion import contacts
from .restart import Restart, contact_error
from .sharing import by_place, coalitions, shapley_values
from .study import Array, Role, Run, Study

__all__ = ["Shares", "shapley_shares", "where"]

_COUNT = len(COMPONENTS)
_COALITIONS = coalitions(_COUNT)


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
    return Shares(shapley_values(worth.tolist(), _COUNT), float(worth[0]), float(worth[-1]), windows)


def where(study: Study, finding: Finding) -> Mapping[str, float]:
    """Shares of the held-out closed-loop gap by place, adding up to 1.

    Signals distinguish components; within one, its share goes to its places as probable as the candidates
    make them, or equally to all where no candidate lies in it.

    Returns: share by place; negative where a component hides another's part.
    """
    shares = shapley_shares(study, study.of(Role.HELDOUT), finding.faultless(study.nominal)).shares

    def place_of(effect: str) -> str:
        place = effect.partition(".")[0]
        component_of(place)  # refuses places that the rig does not have
        return place

    return by_place(shares.tolist(), COMPONENTS, finding, place_of)
