"""Whole studies made of the model's own noisy runs, and findings about them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from orchestrator.diagnosis.catalogue import catalogue
from orchestrator.diagnosis.finding import Augmented, Candidate, Finding
from orchestrator.diagnosis.model import RigModel
from orchestrator.diagnosis.rig import CHANNELS, Inject
from orchestrator.diagnosis.study import Role, Run, Study
from tests.diagnosis.rigs import NOMINAL

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
    for name, role, mass, speed in _RUNS:
        blank = {column: np.zeros(ticks) for column in ("time", *CHANNELS[:6])}
        run = Run(name, role, mass, speed, blank)
        inject = np.zeros((4, ticks + 1))
        inject[Inject.FORCE] = noise * NOMINAL["force_noise"].value * random.normal(size=ticks + 1)
        out = RigModel(Study("lab", 0.001, NOMINAL, ()), [run]).closed_loop(
            0, {}, effects, np.array(theta, float), inject
        )
        columns = dict(zip(CHANNELS[:6], out, strict=False), time=np.arange(ticks) * 0.001)
        if noise:
            columns |= {name: np.round(columns[name], digits) for name, digits in _DIGITS.items()}
        made.append(replace(run, columns=columns))
    return Study("lab", 0.001, NOMINAL, tuple(made))


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
