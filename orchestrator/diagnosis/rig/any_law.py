"""Whether a law that no catalogue holds would explain what an answer leaves of force and motion."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag
from scipy.special import logsumexp

from .coloured_noise import WHITE, Colour
from .fit import Fit, Fitter
from .marginal import inflation
from .model import RigModel
from .shapes import ONE_BY_ONE, force_shapes, motion_shapes
from .study import Array

# Sizes that such a law may have, in standard deviations of the noise, all about as likely beforehand.
_SIZES = 0.02 * 2.0 ** np.arange(12)


def any_law(
    model: RigModel,
    fitter: Fitter,
    fit: Fit,
    weights: Sequence[Array],
    colour: Colour,
    chosen: Array | None = None,
    noise: float = 1.0,
) -> tuple[float, float]:
    """Log evidence that a law is in what a fit leaves, of the encoder and of the force [nats].

    The mean square of the residual hides a small law in the noise of all samples; this looks along families
    of shapes: of a contact's force, of what a sensor may remember of contacts, of what the servo makes of
    accelerations. Their sizes are normal, and the evidence is that of a linear model over none (Bishop:
    Pattern Recognition and Machine Learning, 2006, eq. 3.86), in which calibration and effects go along.

    Args:
        weights: of samples, by run and channel, as the fitter's.
        colour: small coloured noise of the force: slow shapes say less beside it. It may be a law instead
            that made the noise appear coloured; then they must say more than colour does.
        chosen: derivatives of the stacked residuals by what was fitted, where they are known.
        noise: of the force, over what is specified.
    """
    if not all(np.isfinite(r).all() for r in fit.residuals):
        return 0.0, 0.0
    z = fit.z
    if chosen is None:
        chosen = fitter.jacobian(fit.effects, z, fitter.marginal.stacked(fit.residuals), range(len(z)))

    model_of = fit.calibrated, fit.effects, fit.theta
    played = [
        (model.parameters(run, *model_of), model.replay(run, *model_of)) for run in range(len(model.runs))
    ]

    def along(channel: int, shapes: Callable[[Array, Array, float], dict[str, Array]]) -> _Along:
        ends = np.cumsum([0, *map(len, fit.residuals)])
        own = range(channel, len(fit.residuals), 2)
        rows = np.concatenate([np.arange(ends[one], ends[one + 1]) for one in own])
        weight = np.concatenate([weights[one] for one in own])
        columns, families = _columns([shapes(*one, model.study.tick) for one in played], weight)
        return _Along(*fitter.marginal.products(fit.residuals, columns, rows, chosen, z), families)

    # What the encoder deviates slowly on every rig makes shapes say less.
    slow = inflation(fitter.marginal.left(fit.residuals)[0::2])
    moved, pushed = along(0, motion_shapes).evidence(slow), along(1, force_shapes)
    gains = []
    for one in dict.fromkeys((WHITE, colour)):
        louder = noise**2 + one.deviation**2 * (1.0 + one.keep) / (1.0 - one.keep)
        less = colour.log_likelihood - one.log_likelihood
        gains.append(pushed.evidence(louder) - less)
    return max(moved, 0.0), max(float(logsumexp(gains)) - math.log(len(gains)), 0.0)


class _Along(NamedTuple):
    """Residuals along shapes.

    Attributes:
        square, product: of the shapes, and with the residuals, of shapes (m, m) and (m,); families: which
            are of one.
    """

    square: Array
    product: Array
    families: Mapping[str, Array]

    def evidence(self, louder: float) -> float:
        """See `_evidence`, where the noise has so many times its variance."""
        return _evidence(self.square / louder, self.product / louder, self.families)


def _columns(shapes: Sequence[Mapping[str, Array]], weight: Array) -> tuple[Array, dict[str, Array]]:
    """Shapes of all runs, in standard deviations of the noise where they act, shape (samples, shapes).

    Args:
        shapes: by run and family; weight: of all samples.
    Returns: them, and which are of a family.
    """
    joined = {
        name: block_diag(*(one[name] for one in shapes))
        if name in ONE_BY_ONE
        else np.concatenate([one[name] for one in shapes], axis=1)
        for name in shapes[0]
    }
    columns, families, count = [], {}, 0
    for name, family in joined.items():
        acts = np.maximum(np.count_nonzero(family, axis=1), 1)
        size = np.sqrt(np.sum(family**2, axis=1) / acts)
        columns.append((family[size > 0.0] / size[size > 0.0, None]) * weight)
        families[name] = np.arange(count, count := count + len(columns[-1]))
    return np.concatenate(columns).T, {name: of for name, of in families.items() if len(of)}


def _evidence(square: Array, product: Array, families: Mapping[str, Array]) -> float:
    """Log evidence of shapes over none, by their products: of one of them, or of all of a family of one size.

    Many small ones may make up a law, but beside dozens that are none a single one hardly shows. Runs in
    which nothing moves nor touches show none.
    """
    found = []
    for of in families.values():
        spread, turn = np.linalg.eigh(square[np.ix_(of, of)])
        found.append(logsumexp(_shape_evidence(np.maximum(spread, 0.0), turn.T @ product[of]).sum(axis=0)))
    common = [of for name, of in families.items() if name not in ONE_BY_ONE]
    if common:
        one = np.concatenate(common)
        single = _shape_evidence(np.maximum(np.diagonal(square)[one], 0.0), product[one])
        found.append(logsumexp(single) - math.log(len(one)))
    return float(logsumexp(found)) - math.log(len(found) * len(_SIZES)) if found else 0.0


def _shape_evidence(spread: Array, along: Array) -> Array:
    """Log evidence of shapes that do not overlap, by their squares and products, shape (shapes, sizes)."""
    spread, along = spread[:, None], along[:, None]
    return 0.5 * (along**2 / (spread + _SIZES**-2.0) - np.log1p(_SIZES**2 * spread))
