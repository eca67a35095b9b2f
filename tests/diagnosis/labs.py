"""Whole studies made of the model's own noisy runs, and findings about them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from orchestrator.diagnosis.rig.catalogue import catalogue
from orchestrator.diagnosis.rig.finding import Augmented, Candidate, Finding
from orchestrator.diagnosis.rig.rig import CHANNELS, Inject
from orchestrator.diagnosis.rig.study import Role, Study
from tests.diagnosis.rigs import NOMINAL, TICK, own_run

_RUNS = (
    ("train-1", Role.TRAIN, 279.07, 0.02),
    ("train-2", Role.TRAIN, 404.49, 0.02),
    ("heldout-1", Role.HELDOUT, 340.0, 0.024),
    ("heldout-2", Role.HELDOUT, 279.07, 0.016),
    ("repeat-1", Role.REPEAT, 340.0, 0.024),
    ("repeat-2", Role.REPEAT, 279.07, 0.016),
)
# Last digits of the labelled cases' logs.
_DIGITS = dict(zip(CHANNELS[:6], (9, 9, 9, 6, 4, 1), strict=True))
NONE = Augmented({}, (), np.zeros(0))


def lab(ids=(), theta=(), noise=1.0, ticks=2000, seed=0):
    """A study of a rig with effects and the sensor's noise, which goes around the loop.

    Logs have the digits of real ones, or all where there is no noise.
    """
    effects = tuple(catalogue()[one] for one in ids)
    random = np.random.default_rng(seed)
    made = []
    for entry in _RUNS:
        inject = np.zeros((4, ticks + 1))
        inject[Inject.FORCE] = noise * NOMINAL["force_noise"].value * random.normal(size=ticks + 1)
        run = own_run(*entry, ticks, effects, theta, inject)
        if noise:
            rounded = {name: np.round(run[name], digits) for name, digits in _DIGITS.items()}
            run = replace(run, columns={**run.columns, **rounded})
        made.append(run)
    return Study("lab", TICK, NOMINAL, tuple(made))


class Noisy:
    """A trial as a lab would log it: with the noise of its channels, the same each time."""

    def __init__(self, trial, seed):
        self.trial, self.tolerances, self.seed = trial, trial.tolerances, seed

    def residuals(self, calibrated, effects, theta):
        """See `Replay`."""
        random = np.random.default_rng(self.seed)
        parts = self.trial.residuals(calibrated, effects, theta)
        return [part + random.standard_normal(len(part)) for part in parts]


def model(ids=(), theta=()):
    return Augmented({}, tuple(catalogue()[one] for one in ids), np.array(theta, float))


def found(ids=(), theta=(), ties=(), recalibrated=NONE):
    """The finding that some effects, as they are, cause the gap."""
    answer = model(ids, theta) if ids else recalibrated
    return Finding(
        (Candidate(tuple(ids), 1.0, {}, tuple(ties), 0.0, answer),),
        tuple(ids),
        tuple(one.partition(".")[0] for one in ids),
        "",
        tuple(ids),
        recalibrated,
    )
