"""Whether a law that no catalogue holds would explain what an answer leaves of the force."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.signal import lfilter
from scipy.special import logsumexp

from .colour import WHITE, Colour
from .fit import Fit, Fitter
from .misfit import answering, stretches
from .model import RigModel
from .rig import Calibrated
from .study import Array

__all__ = ["any_law"]

# Sizes that such a law may have, in standard deviations of the noise, all about as likely beforehand.
_SIZES = 0.02 * 2.0 ** np.arange(12)
# Memories of the rod and of what warms up [s], and share of the fastest rate at which a force turns.
_SHORT, _LONG, _TURNS = (0.005, 0.03), (0.2, 1.0), 0.1


def any_law(model: RigModel, fitter: Fitter, fit: Fit, weights: Sequence[Array], colour: Colour) -> float:
    """Log evidence that a smooth law of depth, rate, side, time and memory is in what a fit leaves [nats].

    The mean square of what is left drowns a small law in the noise of all samples; this looks along some
    thirty shapes: of a contact's force, each by frame, and of what a sensor may remember of contacts. Their
    sizes are normal, and the evidence is that of a linear model over none (Bishop: Pattern Recognition and
    Machine Learning, 2006, eq. 3.86), in which calibration and effects go along.

    Args:
        weights: of samples, by run and channel, as the fitter's.
        colour: small coloured noise of the force: slow shapes tell less beside it. It may be a law instead
            that made the noise appear coloured; then they must tell more than colour does.
    """
    if not all(np.isfinite(r).all() for r in fit.residuals):
        return 0.0
    ends = np.cumsum([0, *map(len, fit.residuals)])
    runs = range(len(model.runs))
    rows = np.concatenate([np.arange(ends[2 * run + 1], ends[2 * run + 2]) for run in runs])
    shapes = [_shapes(model, run, fit) for run in runs]
    # In standard deviations of the noise, where they act.
    acts = np.maximum(sum(np.count_nonzero(one, axis=1) for one in shapes), 1)
    size = np.sqrt(sum(np.sum(one**2, axis=1) for one in shapes) / acts)
    columns = np.concatenate([one * weights[2 * run + 1] for run, one in zip(runs, shapes, strict=True)], 1).T
    columns = columns[:, size > 0.0] / size[size > 0.0]
    z = fit.z
    chosen = fitter.jacobian(fit.effects, z, fitter.marginal.stacked(fit.residuals), range(len(z)))
    square, product = fitter.marginal.products(fit.residuals, columns, rows, chosen)
    told = []
    for noise in dict.fromkeys((WHITE, colour)):
        louder = 1.0 + noise.deviation**2 * (1.0 + noise.keep) / (1.0 - noise.keep)
        less = colour.log_likelihood - noise.log_likelihood
        told.append(_evidence(square / louder, product / louder) - less)
    return max(float(logsumexp(told)) - math.log(len(told)), 0.0)


def _evidence(square: Array, product: Array) -> float:
    """Log evidence of shapes over none, by their products: of one of them, or of all of one size.

    Many small ones may make up a law, but beside thirty that are none a single one hardly shows.
    """
    spread, turn = np.linalg.eigh(square)
    every = _told(np.maximum(spread, 0.0), turn.T @ product)
    one = _told(np.maximum(np.diagonal(square), 0.0), product)
    told = logsumexp(every.sum(axis=0)), logsumexp(one) - math.log(len(product))
    return float(logsumexp(told)) - math.log(len(told) * len(_SIZES))


def _told(spread: Array, along: Array) -> Array:
    """Log evidence of shapes that do not overlap, by their squares and products, shape (shapes, sizes)."""
    spread, along = spread[:, None], along[:, None]
    return 0.5 * (along**2 / (spread + _SIZES**-2.0) - np.log1p(_SIZES**2 * spread))


def _shapes(model: RigModel, index: int, fit: Fit) -> Array:
    """Shapes of the sensor's force over a run, by tick, shape (shapes, n)."""
    p = model.parameters(index, fit.calibrated, fit.effects, fit.theta)
    at = model.replay(index, fit.calibrated, fit.effects, fit.theta)[7]
    tick = model.study.tick
    depths = np.maximum(at - p[Calibrated.FRONT_WALL], 0.0), np.maximum(p[Calibrated.REAR_WALL] - at, 0.0)
    rate = np.gradient(at, tick)
    deepest = max(float(max(one.max() for one in depths)), 1e-12)
    fastest = max(float(np.abs(rate).max()), 1e-12)
    load, turns = (depths[0] + depths[1]) / deepest, (depths[0] - depths[1]) / deepest
    warm = [_faded(load, tick, memory) for memory in _LONG]
    kept = [*warm, *(_faded(turns, tick, memory) for memory in _LONG), last := _last(turns), last == 0.0]
    time = np.arange(len(at)) / len(at)
    found = []
    for sign, depth in zip((1.0, -1.0), depths, strict=True):
        u, w, touches = depth / deepest, sign * rate / fastest, depth > 0.0
        found += [u**1.5, u**2, u**3, u * w, touches * w * np.abs(w), u * np.tanh(w / _TURNS), u * time]
        found += [touches * _deepest_yet(u), *(touches * _faded(u, tick, memory) for memory in _SHORT)]
        found += [u * one for one in warm]
    contact = _sensed(np.array(found), p, tick)
    contact[:, ~answering(load > 0.0)] = 0.0
    return np.concatenate([contact, np.array(kept)])


def _faded(u: Array, tick: float, memory: float) -> Array:
    """What a first-order memory makes of it."""
    share = 1.0 - math.exp(-tick / memory)
    return lfilter([share], [1.0, share - 1.0], u)


def _deepest_yet(u: Array) -> Array:
    """The largest value since the contact began."""
    found = np.zeros(len(u))
    for contact in stretches(u > 0.0):
        found[contact] = np.maximum.accumulate(u[contact])
    return found


def _last(turns: Array) -> Array:
    """The side of the last contact, -1 or 1; 0 before the first."""
    touched = np.where(turns != 0.0, np.arange(len(turns)), -1)
    last = np.maximum.accumulate(touched)
    return np.where(last >= 0, np.sign(turns[last]), 0.0)


def _sensed(shapes: Array, p: Array, tick: float) -> Array:
    """Shapes behind the sensor's delay and filter."""
    n = shapes.shape[1]
    since = np.arange(n) - max(float(p[Calibrated.SENSOR_DELAY]), 0.0) / tick
    behind = np.array([np.interp(since, np.arange(n), one) for one in shapes])
    if p[Calibrated.SENSOR_CUTOFF] > 0.0:
        share = 1.0 - math.exp(-tick * p[Calibrated.SENSOR_CUTOFF])
        behind = lfilter([share], [1.0, share - 1.0], behind, axis=1)
    return behind
