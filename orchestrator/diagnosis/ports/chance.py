"""What one of many values explains by chance, if only because it was sought among them."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from ..study import Array
from .comb import Comb

__all__ = ["chance_saves"]

# How many unrelated values say what chance makes.
_DRAWN = 48
# Share of its square by which a trace leaves what other parameters do, below which it is rounding.
_SAME = 1e-9


def chance_saves(
    comb: Comb,
    value: float,
    trace: Callable[[float], Array],
    beside: tuple[Array, Array],
    columns: Array,
    z: Array,
) -> float:
    """What the best of as many values that have nothing to do with the residuals saves of them [nats].

    Laplace's volume pays for how narrow the best value is against its prior: about ln M, if M values apart
    could be told. That is enough where all that is left besides is white noise. A value that has nothing to
    do with what there is to explain, W nats, but moves the residuals r by p, saves W c of it at its best
    size, with c = (r.p)^2 / (r.r p.p). If p may have any direction of d, c exceeds x with a probability of
    about (1 - x)^((d - 1) / 2), and the best of M saves all of W but the share M^(-2 / (d - 1)). Of what is
    left with the value found, half the square of r, it would then have saved

        (r.r / 2) (M^(2 / (d - 1)) - 1), where d = 1 / mean(c),

    which is ln M for white noise, as mean(c) is 1 / r.r then. Where something is left that goes along with
    the signal's values, as what a heat loss makes with those of a heater, the errors that any step gives to
    them meet more of it. How much is measured: mean(c) over steps about as large as the one found that are
    not near it. A step is worth what it explains beyond that: one that is as good as the best of M is worth
    nothing, and the right one, which leaves nothing but noise, pays no more than its volume.

    Args:
        comb: where the value was sought; one of `chance`.
        value: the one found.
        trace: the stacked residuals with a value in place of that one, shape (residuals,).
        beside: the same with none, and with the one found, each of shape (residuals,).
        columns: derivatives of the residuals by all other normalised parameters, shape (residuals, others).
        z: these parameters, of which priors have a size of one, shape (others,).
    Returns: that; 0 where no unrelated value moves anything else than the other parameters do.
    """
    none, found = beside
    basis = np.linalg.qr(np.vstack([columns, np.eye(len(z))]))[0]
    left = np.concatenate([found, z])
    left -= basis @ (basis.T @ left)
    square = float(left @ left)
    met = []
    for other in comb.unrelated(value, _DRAWN):
        with np.errstate(over="ignore", invalid="ignore"):
            moved = trace(other) - none
            along = basis[: len(none)].T @ moved
            size = float(moved @ moved - along @ along)
            share = float(left[: len(none)] @ moved) ** 2 / (size * square) if size > 0.0 else math.nan
        if math.isfinite(share) and size > _SAME * float(moved @ moved):
            met.append(min(share, 1.0))
    mean = float(np.mean(met)) if met else 0.0
    if mean == 0.0:
        return 0.0
    return 0.5 * square * math.expm1(2.0 * math.log(comb.tried(value)) / max(1.0 / mean - 1.0, 1.0))
