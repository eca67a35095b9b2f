"""Read a law off the estimated unknown input, then fit it in the filter itself.

A regression of w on each law of the library finds the few that are worth a fit. The fit puts the law into the
system, with its numbers as constants of the filter beside the calibrated parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .laws import Law, library
from .model import Inserted, Kinds, Place, StateModel
from .places import Ranked, Runs, loglik, smoothed_at

__all__ = ["Candidate", "Fitted", "fit", "screened"]

Array = NDArray[np.float64]
# Samples of a run that the regression looks at.
_SAMPLES = 400
_PASSES = 4


@dataclass(frozen=True)
class Candidate:
    """A law at a place, reading a signal.

    Attributes:
        share: of w's power on the stretches that the regression did not see, which the law explains.
        numbers: where its fit begins.
    """

    law: Law
    place: Place
    signal: str
    inserted: Inserted
    numbers: tuple[float, ...]
    share: float

    @property
    def name(self) -> str:
        """Place, law and signal."""
        return f"{self.law.name} at {self.place.name} of {self.signal}"


@dataclass(frozen=True)
class Fitted:
    """Laws fitted together.

    Attributes:
        laws: candidates; numbers: theirs, one after the other; sigmas: standard deviations.
        loglik: of the runs. constants: mean and covariance of parameters and numbers.
    """

    laws: tuple[Candidate, ...]
    numbers: Array
    sigmas: Array
    loglik: float
    constants: tuple[Array, Array]


def _unit(model: StateModel, index: int) -> str:
    ports = [*model.states, *model.inputs, *model.outputs]
    return model.study.unit(ports[index])


def _own(model: StateModel, place: Place) -> int | None:
    """Signal at the place itself."""
    nx, nu = len(model.states), len(model.inputs)
    if place.kind is Kinds.INPUT:
        return nx + place.index
    return nx + nu + place.index if place.kind is Kinds.OUTPUT else None


def _starts(law: Law, spread: float) -> list[list[float]]:
    grids = [[]]
    for number in law.numbers[1 if law.linear else 0 :]:
        size = spread if number.relative else 1.0
        grids = [[*one, start * size] for one in grids for start in number.starts]
    return [[1.0, *one] if law.linear else one for one in grids]


def screened(
    runs: Runs, places: Sequence[Ranked], fixed: Fitted | None = None, most: int = 14
) -> list[Candidate]:
    """Laws that w at these places may be, best first; laws with states of their own come last, unscreened."""
    model, found, blind = runs.model, list[Candidate](), list[Candidate]()
    laws = () if fixed is None else tuple(one.inserted for one in fixed.laws)
    priors = () if fixed is None else list(zip(fixed.numbers, fixed.sigmas, strict=True))
    for ranked in places:
        place = ranked.place
        smoothed = smoothed_at(runs, ranked, laws, priors)
        if len(smoothed) < 1:
            continue
        pieces = []
        settled = model.study.settled
        for one in smoothed:
            stride = max(1, len(one["w"]) // _SAMPLES)
            at = slice(settled, None, stride)
            time = np.arange(len(one["w"]))[at] * model.study.interval
            weight = 1.0 / np.sqrt(np.abs(one["variance"][at]) + 1e-12 * one["w"].var() + 1e-300)
            pieces.append((time, one["w"][at], weight, one["signals"][at]))
        if len(pieces) == 1:  # the second half judges
            half = len(pieces[0][0]) // 2
            pieces = [tuple(v[:half] for v in pieces[0]), tuple(v[half:] for v in pieces[0])]
        own = _own(model, place)
        signals = model.signals_of(place)
        if own is not None:
            signals = {**signals, place.name: own}
        for law in library():
            if law.kinds and int(place.kind) not in law.kinds:
                continue
            for name, index in signals.items():
                if not law.fits(_unit(model, index), index == own):
                    continue
                best = _regressed(law, pieces, index, float(runs.spread[index]))
                if best is None:
                    continue
                share, numbers = best
                put = Inserted(place, law.address, (index,), len(law.numbers), law.states)
                one = Candidate(law, place, name, put, tuple(numbers), share)
                (blind if law.states else found).append(one)
    found.sort(key=lambda one: one.share, reverse=True)
    return [*_spread_out(found, most), *blind[:6]]


def _spread_out(found: Sequence[Candidate], most: int) -> list[Candidate]:
    """The best ones, at most three of one law."""
    kept: list[Candidate] = []
    for one in found:
        if one.share > 0.02 and sum(k.law.name == one.law.name for k in kept) < 3:
            kept.append(one)
        if len(kept) == most:
            break
    return kept


def _regressed(
    law: Law, pieces: Sequence[Any], index: int, spread: float
) -> tuple[float, list[float]] | None:
    if law.states:
        return 0.0, _starts(law, spread)[0]
    best = None
    for start in _starts(law, spread):
        columns = [law.values(time, np.ascontiguousarray(s[:, index]), start) for time, _, _, s in pieces]
        a = np.concatenate([c * p[2] for c, p in zip(columns[:-1], pieces[:-1], strict=True)])
        b = np.concatenate([p[1] * p[2] for p in pieces[:-1]])
        power = float(a @ a)
        if not np.isfinite(power) or power <= 0.0:
            continue
        factor = float(a @ b) / power
        c, d = columns[-1] * pieces[-1][2], pieces[-1][1] * pieces[-1][2]
        share = 1.0 - float(((d - factor * c) ** 2).sum() / (d**2).sum())
        if best is None or share > best[0]:
            best = share, ([factor, *start[1:]] if law.linear else start)
    return best


def fit(runs: Runs, laws: Sequence[Candidate], start: Array | None = None) -> Fitted:
    """Fit laws together: passes of the filter, each linearised where the last one ended."""
    inserted = [one.inserted for one in laws]
    numbers = np.array([v for one in laws for v in one.numbers]) if start is None else start.copy()
    wide = np.abs(numbers) * 1.0 + 1e-12
    best: Fitted | None = None
    count = len(runs.model.nominal)
    for _ in range(_PASSES):
        priors = list(zip(numbers, wide, strict=True))
        passes = runs.passes(inserted, priors)
        value = loglik(passes)
        if not np.isfinite(value):
            break
        z, cov = passes[-1].z, passes[-1].covariance
        at = slice(len(runs.model.states) + sum(one.states for one in inserted), None)
        mean, covariance = z[at], cov[at, at]
        if best is not None and value < best.loglik + 1.0:
            break
        best = Fitted(
            tuple(laws), mean[count:].copy(), np.sqrt(np.abs(np.diag(covariance)[count:])), value,
            (mean.copy(), covariance.copy()),
        )  # fmt: skip
        numbers = mean[count:].copy()
    if best is None:
        nothing = np.concatenate([runs.model.nominal, numbers])
        return Fitted(tuple(laws), numbers, wide, -np.inf, (nothing, np.eye(len(nothing))))
    return best
