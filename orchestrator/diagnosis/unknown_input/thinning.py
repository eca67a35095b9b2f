"""Thin out logs that are sampled much faster than the system moves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..study.study import PortStudy, Role
from .model import StateModel
from .places import Runs
from .polish import Replays

__all__ = ["thinned"]

Array = NDArray[np.float64]
# Samples that are enough for a search, and noises by which simulations with fewer may differ.
_ENOUGH, _SAME_SIMULATION = 3000, 0.1


def thinned(model: StateModel) -> PortStudy:
    """The study with as few samples as simulate the same, but no fewer than `_ENOUGH`.

    Logs are often sampled much faster than the system moves.
    """
    study = model.study
    if not model.filters:
        return study
    count = sum(map(len, study.of(Role.TRAIN, Role.VALIDATION)))
    whole = _simulated(model)
    missed = _size(
        [
            one - model.logged(run)
            for one, run in zip(whole, model.study.of(Role.TRAIN, Role.VALIDATION), strict=True)
        ],
        model,
    )
    for stride in (32, 16, 8, 4, 2):
        if count < stride * _ENOUGH:
            continue
        model.study = study.every(stride)
        differ = [one - two[::stride] for one, two in zip(_simulated(model), whole, strict=True)]
        if _size(differ, model) < max(_SAME_SIMULATION, 0.03 * missed):
            return model.study
    model.study = study
    return study


def _size(differ: Sequence[Array], model: StateModel) -> float:
    """Root mean square of differences of compared signals, over the noise."""
    return float(np.sqrt(np.nanmean(np.square(np.concatenate(differ) / model.noise))))


def _simulated(model: StateModel) -> list[Array]:
    """Compared signals of the runs as configured."""
    replays = Replays(Runs(model, model.study.of(Role.TRAIN, Role.VALIDATION)), ())
    return [replays.found(k, start, model.nominal) for k, start in enumerate(replays.starts)]
