"""What one of many values explains by chance, if only because it was sought among them."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from ..study import Array
from .comb import Comb

__all__ = ["chance_saves"]

# How many unrelated values tell what chance makes.
_DRAWN = 48
# Share of its square by which a trace leaves what other parameters do, below which it is rounding.
_SAME = 1e-9


def chance_saves(
    comb: Comb, value: float, trace: Callable[[float], Array], r: Array, columns: Array, z: Array
) -> float:
    """What the best of as many values that have nothing to do with the residuals saves of them [nats].

    Laplace's volume pays for how narrow the best value is against its prior: about ln M, if M values apart
    could be told. That is enough where all that is left besides is white noise: a value that has nothing to
    do with the residuals r, but moves them by p, saves W c of them at its best size, where W is half their
    square and c = (r.p)^2 / (r.r p.p). If p may have any direction of d, c exceeds x with a probability of
    about (1 - x)^((d - 1) / 2), and the best of M saves

        W (1 - M^(-2 / (d - 1))), where d = 1 / mean(c); 2 W mean(c) ln M if that is small,

    which is ln M for white noise, as mean(c) is 1 / (2 W) then. Where something is left that goes along with
    the signal's values, as what a heat loss makes with those of a heater, the errors that any step gives to
    them meet more of it. How much is measured: mean(c) over steps about as large as the one found that are
    not near it. A step is worth what it explains beyond that; one that is as good as any, sought among M, is
    worth nothing.

    The right step pays, too: r is what is left without it, and of what it explains unrelated steps meet about
    1/n, if the signal takes n values. Of long signals of many values that is little. What is left with it
    would hold less of that, but also less of what a wrong one, being the best, happened to meet.

    Args:
        comb: where the value was sought; one of `chance`.
        value: the one found.
        trace: the stacked residuals with a value in place of that one, shape (residuals,).
        r: the same without any, shape (residuals,).
        columns: derivatives of the residuals by all other normalised parameters, shape (residuals, others).
        z: these parameters, of which priors have a size of one, shape (others,).
    Returns: that; 0 where no unrelated value moves anything else than the other parameters do.
    """
    basis = np.linalg.qr(np.vstack([columns, np.eye(len(z))]))[0]
    left = np.concatenate([r, z])
    left -= basis @ (basis.T @ left)
    square = float(left @ left)
    met = []
    for other in comb.unrelated(value, _DRAWN):
        with np.errstate(over="ignore", invalid="ignore"):
            moved = trace(other) - r
            along = basis[: len(r)].T @ moved
            size = float(moved @ moved - along @ along)
            share = float(left[: len(r)] @ moved) ** 2 / (size * square) if size > 0.0 else math.nan
        if math.isfinite(share) and size > _SAME * float(moved @ moved):
            met.append(min(share, 1.0))
    mean = float(np.mean(met)) if met else 0.0
    if mean == 0.0:
        return 0.0
    best = -math.expm1(-2.0 * math.log(comb.tried(value)) / max(1.0 / mean - 1.0, 1.0))
    return 0.5 * square * best
