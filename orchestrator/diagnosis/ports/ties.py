"""Effects that cannot be determined from those of an answer: fitted in their place, they predict the same."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..answers import Answer
from ..effect import Effect
from ..fit import Fit, Fitter
from ..search import HOPELESS, each, separation
from ..search_progress import counted_calls, stage
from ..study import Array

__all__ = ["Alike", "alike"]

# Fitted replays that data like these separate by less are the same [nats]; and how many are fitted.
_APART, _FITTED = 8.0, 6
# An effect that moves the residuals by less does nothing [nats].
_NOTHING = 1.0
# What is fitted must promise to come so near: as a share of what the effect explains, and in nats.
_NEAR, _NEAR_NATS = 0.02, 40.0


@dataclass(frozen=True)
class Alike:
    """A model that predicts what an answer's does.

    Attributes:
        alien: effects of the fit that the answer does not hold.
    """

    fit: Fit
    alien: tuple[str, ...]


def alike(fitter: Fitter, answer: Answer, effects: Sequence[Effect], workers: int = 1) -> list[Alike]:
    """Models with one effect of an answer replaced whose fitted replays data like these would not separate.

    Evidence does not count here: a gain of a port and the parameter that it equals predict the same to the
    last digit, and differ in evidence by how wide their priors are. How far calibrated numbers stray does.

    Args:
        workers: threads.
    """
    top = answer.fit
    if top is None:
        return []
    stage("ties")
    fits = [
        fit for place in range(len(top.effects)) for fit in _replaced(fitter, top, place, effects, workers)
    ]
    return [
        Alike(fit, (fit.effects[-1].id,))
        for fit in fits
        if np.isfinite(fit.cost)
        and _acts(fitter, fit)
        and separation(fitter, top, fit) + _bent(fitter, top, fit) < _APART
    ]


def _replaced(fitter: Fitter, top: Fit, place: int, effects: Sequence[Effect], workers: int) -> list[Fit]:
    """Fits with one effect of a fit replaced by those that promise to predict the same, which stand last."""
    others = top.effects[:place] + top.effects[place + 1 :]
    z = top.without(place)
    r = fitter.stacked(others, z)
    trace = fitter.stacked(top.effects, top.z) - r
    if not np.isfinite(trace).all() or not trace.any():
        return []
    count = len(fitter.nominal)
    basis = np.linalg.qr(fitter.jacobian(others, z, r, range(count))[:, :count])[0]

    def nearest(effect: Effect) -> tuple[float, Effect, Array] | None:
        return _nearest(fitter, effect, (others, z, r), trace, basis)

    def fitted(one: tuple[float, Effect, Array]) -> Fit:
        _, effect, start = one
        begin = np.concatenate([z[count:], start])
        return fitter.fit((*others, effect), z[:count], begin, aim=top.cost + HOPELESS)

    new = [effect for effect in effects if all(effect.id != one.id for one in top.effects)]
    promising = [one for one in each(counted_calls(nearest, False, workers), new, workers) if one is not None]
    promising.sort(key=lambda one: one[0])
    return each(counted_calls(fitted, True, workers), promising[:_FITTED], workers)


def _acts(fitter: Fitter, fit: Fit) -> bool:
    """Whether the last effect of a fit does anything: one that came to nothing stands for none."""
    alone = fitter.stacked(fit.effects[:-1], fit.without(len(fit.effects) - 1))
    with np.errstate(over="ignore", invalid="ignore"):
        apart = fitter.stacked(fit.effects, fit.z) - alone
        # Nor is it nothing where the model runs away without it.
        return not 0.5 * float(apart @ apart) < _NOTHING


def _bent(fitter: Fitter, one: Fit, other: Fit) -> float:
    """What the calibration of the other fit deviates more, in log probability [nats]."""
    count = len(fitter.nominal)
    return max(0.5 * float(other.z[:count] @ other.z[:count] - one.z[:count] @ one.z[:count]), 0.0)


def _nearest(
    fitter: Fitter,
    effect: Effect,
    at: tuple[tuple[Effect, ...], Array, Array],
    trace: Array,
    basis: Array,
) -> tuple[float, Effect, Array] | None:
    """How far an effect of the right size, with other calibrated numbers, stays from a trace [nats].

    Args:
        at: the other effects, their normalised parameters, and the residuals there.
        trace: what the effect to be replaced does to the stacked residuals; basis: of the calibration's.
    Returns: the distance, the effect, and where its fit begins; None if it stays too far.
    """
    others, z, r = at
    across = trace - basis @ (basis.T @ trace)
    square = float(across @ across)
    best: tuple[float, Effect, Array] | None = None
    for start in fitter.starts(effect):
        own = fitter.stacked((*others, effect), np.concatenate([z, start])) - r
        if not np.isfinite(own).all():
            continue
        own = own - basis @ (basis.T @ own)
        size = float(own @ own)
        if size == 0.0:
            continue
        amplitude = float(own @ across) / size
        apart = 0.5 * (square - amplitude**2 * size)
        if apart < max(_NEAR * 0.5 * square, _NEAR_NATS) and (best is None or apart < best[0]):
            begin = start.copy()
            one = effect.parameters[0]
            if not one.shape and not one.whole:
                low, high = one.low / one.scale, one.high / one.scale
                begin[0] = min(max(begin[0] * amplitude, low), high)
            best = apart, effect, begin
    return best
