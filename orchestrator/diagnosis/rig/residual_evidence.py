"""Evidence in the residual of a fit of the rig."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .any_law import any_law
from .coloured_noise import Colour, whitened
from .fit import Fit, Fitter
from .local_structure import loudest, repeated
from .misfit import LOUDER, in_contact, noises_beside, unexplained, variance_gain
from .nuisance import Weighing, Weighted, touching
from .study import Array

# Calibrated numbers of one kind deviate together.
KINDS = (
    ("natural_frequency", "damping_ratio", "response_delay"),
    ("contact_damping", "sensor_delay", "sensor_cutoff"),
    ("front_wall", "rear_wall"),
    ("contact_stiffness",),
    ("force_bias",),
)
# Roughness that deviates by more, against what is usual, is none [nats].
_ROUGHER = 20.0


class ResidualEvidence(NamedTuple):
    """Evidence in the residual of a fit, by kind [nats].

    Attributes:
        encoder, force: slow or local structure, see `misfit.unexplained`; contact: see `misfit.in_contact`.
        moved, pushed: laws of the encoder and of the force, see `any_law`.
        bent: excess deviation of calibrated numbers; 0 without effects, where it concerns the tolerances.
        rough: what roughness takes up beyond what it does of rigs; it is not left.
        shaken, struck: what is loudest of the encoder and of the force, see `local_structure.loudest`.
        repeated: what contacts leave again and again, see `local_structure.repeated`.
    """

    encoder: float
    moved: float
    force: float
    contact: float
    pushed: float
    bent: float
    rough: float
    shaken: float
    struck: float
    repeated: float

    @property
    def total(self) -> float:
        """Sum in which the largest of overlapping parts counts; the last three parts only describe it."""
        moved, pushed = max(self.encoder, self.moved), max(self.force, self.contact, self.pushed)
        return moved + pushed + self.bent + self.rough


def residual_evidence(
    weighing: Weighing, fitter: Fitter, fit: Fit, colour: Colour, chosen: Array | None = None
) -> ResidualEvidence:
    """Evidence in the residual of a fit.

    Args:
        fitter: of the weighing.
        colour: small coloured noise of the force, see `stochastic.Force`.
        chosen: see `any_law`.
    """
    left = fitter.marginal.left(fit.residuals)
    moves, forces, touched = left[0::2], whitened(left[1::2], colour), touching(weighing.model, fit)
    noise = math.sqrt(min(float(np.mean(np.square(noises_beside(forces, touched)))), LOUDER))
    moved, pushed = any_law(weighing.model, fitter, fit, weighing.weights, colour, chosen, noise)
    return ResidualEvidence(
        encoder=unexplained(moves),
        moved=moved,
        force=unexplained(forces),
        contact=in_contact(forces, touched),
        pushed=pushed,
        bent=excess_deviation(fit) if fit.effects else 0.0,
        rough=max(fitter.marginal.roughness_evidence(fit.residuals) - _ROUGHER, 0.0),
        shaken=loudest(moves),
        struck=loudest(forces),
        repeated=repeated(forces, touched),
    )


def own_error(weighing: Weighing, fitter: Fitter, fit: Fit, left: float) -> float:
    """Residual evidence that the replay's numerical error may cause, by halving its sub-steps [nats].

    A servo at its limit goes another way where it begins a little otherwise: no numbers of the effect, nor of
    any other, make such a replay follow the rig to the end.

    Args:
        fitter: of the weighing; left: see `ResidualEvidence.total`. No more is reported.
    """
    if left < _ROUGHER:
        return 0.0
    finer = Weighted(weighing.model.finer(), weighing.weights)
    again = finer.residuals(fit.calibrated, fit.effects, fit.theta)
    changed = [one - other for one, other in zip(again, fit.residuals, strict=True)]
    if not all(np.isfinite(one).all() for one in changed):
        return left
    return min(unexplained(fitter.marginal.left(changed)), left)


def excess_deviation(fit: Fit) -> float:
    """Log likelihood that calibrated numbers deviate by more than their tolerances, of all or of one kind."""
    kinds = [[fit.deviation.get(name, 0.0) for name in kind] for kind in KINDS]
    every = [one for kind in kinds for one in kind]
    gains = [variance_gain(len(one), float(np.mean(np.square(one)))) for one in (every, *kinds)]
    return max(max(gains) - math.log(len(gains)), 0.0)
