"""Coloured force noise: a first-order process in addition to white noise."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from ...base.compiled_functions import njit
from .study import Array

# Coloured noise of a smaller deviation than this share of the white one is roughness of every rig, from some
# log likelihood on [nats].
COLOUR, _COLOURED = 0.4, 4.0
# Of logarithms, whose exponential, and the square of that, are finite.
_LARGEST = 300.0
_COLOURS = tuple(itertools.product((0.1, 0.15, 0.2, 0.25), (0.7, 0.8, 0.87, 0.92, 0.95)))


class Colour(NamedTuple):
    """Small coloured noise of the force.

    Attributes:
        deviation: over that of the white noise; keep: what a sample keeps of it.
        log_likelihood: over white noise alone [nats].
    """

    deviation: float
    keep: float
    log_likelihood: float


WHITE = Colour(0.0, 0.0, 0.0)


@njit(error_model="numpy", nogil=True)
def _ar_likelihood(r, deviation, keep, white, innovations):
    """Log likelihood of a first-order autoregressive process in white noise (a Kalman filter).

    Args:
        innovations: normalised, of the shape of r, or empty; written.
    """
    total, mean, variance = 0.0, 0.0, deviation * deviation
    for i in range(r.shape[0]):
        s = variance + white * white
        error = r[i] - mean
        if i < innovations.shape[0]:
            innovations[i] = error / math.sqrt(s)
        total -= 0.5 * (error * error / s + math.log(s))
        gain = variance / s
        mean = keep * (mean + gain * error)
        variance = keep * keep * variance * (1.0 - gain) + (1.0 - keep * keep) * deviation * deviation
    return total


def coloured(parts: Sequence[Array], noise: float) -> tuple[float, float, float]:
    """Log evidence of coloured noise over white noise alone, its deviation, and its memory per sample."""
    size = sum(map(len, parts))
    spread = math.sqrt(sum(float(part @ part) for part in parts) / size)
    none = np.empty(0)
    white = sum(_ar_likelihood(part, 0.0, 0.0, max(spread, 0.5 * noise), none) for part in parts)

    def shape(x: Array) -> tuple[float, float, float]:
        # A search is not bounded where a process without memory is as likely as white noise.
        deviation, forgets, rest = (math.exp(min(one, _LARGEST)) for one in (x[0], -x[1], x[2]))
        return deviation, 1.0 / (1.0 + forgets), rest

    def cost(x: Array) -> float:
        deviation, keep, rest = shape(x)
        return -sum(_ar_likelihood(part, deviation, keep, rest, none) for part in parts)

    best = min(
        (
            minimize(cost, [math.log(max(spread, 0.1 * noise)), start, math.log(noise)], method="Nelder-Mead",
                     options={"maxiter": 250, "xatol": 0.02, "fatol": 0.1})
            for start in (1.0, 3.0)
        ),
        key=lambda one: one.fun,
    )  # fmt: skip
    deviation, keep, _ = shape(best.x)
    # Two parameters more than white noise, each worth half the logarithm of the number of samples.
    return float(-best.fun - white - math.log(size)), deviation, keep


def small_colour(parts: Sequence[Array]) -> Colour:
    """The most likely of `_COLOURS`; `WHITE` if its log likelihood over white noise is little.

    Args:
        parts: residuals over their noise.
    """
    size = sum(map(len, parts))
    variance = sum(float(part @ part) for part in parts) / size

    def likelihood(colour: tuple[float, float]) -> float:
        white = math.sqrt(max(variance - colour[0] ** 2, 0.25))
        return float(sum(_ar_likelihood(part, *colour, white, np.empty(0)) for part in parts))

    best = max(_COLOURS, key=likelihood)
    gain = likelihood(best) - likelihood((0.0, 0.0))
    return Colour(*best, gain) if gain > _COLOURED else WHITE


def whitened(left: Sequence[Array], colour: Colour) -> list[Array]:
    """Residuals whitened by the model of their coloured noise, normalised.

    Args:
        left: residuals over their noise, by run.
    """
    if colour.deviation <= 0.0:
        return list(left)
    found = [np.empty(len(r)) for r in left]
    for r, out in zip(left, found, strict=True):
        _ar_likelihood(r, colour.deviation, colour.keep, 1.0, out)
    return found
