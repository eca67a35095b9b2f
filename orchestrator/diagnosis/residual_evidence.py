"""What a fit of the rig leaves unexplained."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .any_law import any_law
from .benign import Weighing, Weighted, touching
from .colour import Colour, whitened
from .fit import Fit, Fitter
from .local import loudest, repeated
from .misfit import LOUDER, in_contact, louder, noises_beside, unexplained
from .study import Array

__all__ = ["KINDS", "Remains", "bent", "own_error", "remains"]

# Calibrated numbers of one kind stray together.
KINDS = (
    ("natural_frequency", "damping_ratio", "response_delay"),
    ("contact_damping", "sensor_delay", "sensor_cutoff"),
    ("front_wall", "rear_wall"),
    ("contact_stiffness",),
    ("force_bias",),
)
# Roughness that deviates by more, against what is usual, is none [nats].
_ROUGHER = 20.0


class Remains(NamedTuple):
    """What a fit leaves unexplained, part by part [nats].

    Attributes:
        encoder, force: slow or local structure, see `misfit.unexplained`; contact: see `misfit.in_contact`.
        moved, pushed: laws of the encoder and of the force, see `any_law`.
        bent: how far calibrated numbers deviate; without any effect that is for tolerances to tell.
        rough: what roughness takes up beyond what it does of rigs; it is not left.
        shaken, struck: what is loudest of the encoder and of the force, see `local.loudest`.
        repeated: what contacts leave again and again, see `local.repeated`.
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
        """Of parts that may say about the same the largest counts; the last three only tell more of it."""
        moved, pushed = max(self.encoder, self.moved), max(self.force, self.contact, self.pushed)
        return moved + pushed + self.bent + self.rough


def remains(
    weighing: Weighing, fitter: Fitter, fit: Fit, colour: Colour, chosen: Array | None = None
) -> Remains:
    """What a fit leaves unexplained.

    Args:
        fitter: of the weighing.
        colour: small coloured noise of the force, see `stochastic.Force`.
        chosen: see `any_law`.
    """
    left = fitter.marginal.left(fit.residuals)
    moves, forces, touched = left[0::2], whitened(left[1::2], colour), touching(weighing.model, fit)
    noise = math.sqrt(min(float(np.mean(np.square(noises_beside(forces, touched)))), LOUDER))
    moved, pushed = any_law(weighing.model, fitter, fit, weighing.weights, colour, chosen, noise)
    return Remains(
        encoder=unexplained(moves),
        moved=moved,
        force=unexplained(forces),
        contact=in_contact(forces, touched),
        pushed=pushed,
        bent=bent(fit) if fit.effects else 0.0,
        rough=max(fitter.marginal.strayed(fit.residuals) - _ROUGHER, 0.0),
        shaken=loudest(moves),
        struck=loudest(forces),
        repeated=repeated(forces, touched),
    )


def own_error(weighing: Weighing, fitter: Fitter, fit: Fit, left: float) -> float:
    """What of that which a fit leaves the replay's own error may make, by halving its sub-steps [nats].

    A servo at its limit goes another way where it begins a little otherwise: no numbers of the effect, nor of
    any other, make such a replay follow the rig to the end.

    Args:
        fitter: of the weighing; left: see `Remains.total`. No more is reported.
    """
    if left < _ROUGHER:
        return 0.0
    finer = Weighted(weighing.model.finer(), weighing.weights)
    again = finer.residuals(fit.calibrated, fit.effects, fit.theta)
    changed = [one - other for one, other in zip(again, fit.residuals, strict=True)]
    if not all(np.isfinite(one).all() for one in changed):
        return left
    return min(unexplained(fitter.marginal.left(changed)), left)


def bent(fit: Fit) -> float:
    """Log likelihood that calibrated numbers stray by more than their tolerances, of all or of one kind."""
    kinds = [[fit.deviation.get(name, 0.0) for name in kind] for kind in KINDS]
    every = [one for kind in kinds for one in kind]
    told = [louder(len(one), float(np.mean(np.square(one)))) for one in (every, *kinds)]
    return max(max(told) - math.log(len(told)), 0.0)
