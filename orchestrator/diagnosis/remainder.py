"""What a fit of the rig leaves unexplained."""

from __future__ import annotations

import math

import numpy as np

from .any_law import any_law
from .benign import Weighing, Weighted, touching
from .colour import Colour, whitened
from .fit import Fit, Fitter
from .misfit import in_contact, louder, unexplained

__all__ = ["KINDS", "bent", "own_error", "remains"]

# Calibrated numbers of one kind stray together.
KINDS = (
    ("natural_frequency", "damping_ratio", "response_delay"),
    ("contact_damping", "sensor_delay", "sensor_cutoff"),
    ("front_wall", "rear_wall"),
    ("contact_stiffness",),
    ("force_bias",),
)
# Roughness that strays by more, against what is usual, is none [nats].
_ROUGHER = 20.0


def remains(weighing: Weighing, fitter: Fitter, fit: Fit, colour: Colour, rougher: bool = True) -> float:
    """What a fit leaves unexplained [nats].

    Args:
        fitter: of the weighing.
        colour: small coloured noise of the force, see `stochastic.Force`.
        rougher: whether what roughness takes up beyond what it does of rigs counts, too: it is not left.
    """
    left = fitter.marginal.left(fit.residuals)
    forces = whitened(left[1::2], colour)
    told = unexplained(forces), in_contact(forces, touching(weighing.model, fit))
    moved, pushed = any_law(weighing.model, fitter, fit, weighing.weights, colour)
    # What an effect only imitates bends the calibration, too. Without any that is for tolerances to tell.
    found = max(unexplained(left[0::2]), moved) + max(*told, pushed) + (bent(fit) if fit.effects else 0.0)
    return found + (max(fitter.marginal.strayed(fit.residuals) - _ROUGHER, 0.0) if rougher else 0.0)


def own_error(weighing: Weighing, fitter: Fitter, fit: Fit, left: float) -> float:
    """What of that which a fit leaves the replay's own error may make, by halving its sub-steps [nats].

    A servo at its limit goes another way where it begins a little otherwise: no numbers of the effect, nor of
    any other, make such a replay follow the rig to the end.

    Args:
        fitter: of the weighing; left: see `remains`. No more is told.
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
