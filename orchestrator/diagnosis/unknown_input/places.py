"""Rank places by how well an unknown input there explains the logs.

At each place w(t) is a random walk whose intensity the likelihood chooses. Start states and calibrated
parameters are free within their priors in the same filter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..study.study import PortRun
from .evaluation import Inserted, Kinds, Place
from .model import StateModel
from .open_run import signals_along, simulated, substeps
from .played import PlayedModel
from .smoother import Smoothed, filtered, pass_effort

Array = NDArray[np.float64]
# Random walk: share of the signal's spread that w moves by within a twentieth of a run.
_MOVES = (1e-3, 1e-2, 1e-1, 1.0, 10.0, 100.0)
# Samples that rank places roughly; nats a value by which places that are looked at may fall behind.
_BRIEF, _APART = 400, 1.0
# Part of the noise by which half the step may change a simulation.
STEP_ERROR = 0.1
# Variance of a start state over the square of its spread, and of a state that a log starts.
_START = 1.0


@dataclass(frozen=True)
class Ranked:
    """A place and how well w there explains the logs.

    Attributes:
        gain: log likelihood beyond that of the calibrated model alone [nats].
        order, intensity: of the random walk. moves: its steps in a twentieth of a run over the spread.
    """

    place: Place
    gain: float
    order: int
    intensity: float
    moves: float = 1.0


class Runs:
    """Runs of a study made ready for filters.

    Attributes:
        scale: spread of each state; parameters follow, by their tolerance.
        spread: of all signals [states, inputs, outputs]. slope: of their derivatives.
        low, high: least and largest values of the signals.
        tone: frequency of what calibration leaves, once it is known, where that is a tone [rad/s]; else 0.
    """

    def __init__(self, model: StateModel, runs: Sequence[PortRun]) -> None:
        self.model, self.runs, self.tone = model, tuple(runs), 0.0
        self.data = [(*model.external(run), model.logged(run), model.started(run)) for run in runs]
        self.sub = 1
        if model.filters:
            size = np.maximum(np.abs(model.start), 1e-3)
            self.sub = max(substeps(model, size, ext[0]) for ext, *_ in self.data)
        found = self._with_longer_steps()
        slopes = np.vstack([np.diff(one, axis=0) / model.study.interval for one in found])
        slopes = slopes[np.isfinite(slopes).all(axis=1)]
        self.slope = slopes.std(axis=0) if len(slopes) else np.ones(slopes.shape[1])
        every = np.vstack(found)
        every = every[np.isfinite(every).all(axis=1)]
        whole = every if len(every) else np.zeros((1, every.shape[1]))
        self.low, self.high = whole.min(axis=0), whole.max(axis=0)
        spread = every.std(axis=0) if len(every) else np.ones(every.shape[1])
        # Logs show the spread of what is compared, even where the model runs away or rests.
        logged = np.vstack([one[2] for one in self.data])
        count = len(model.states)
        for index, port in enumerate(model.compared):
            real = float(np.nanstd(logged[:, index]))
            at = count + len(model.inputs) + model.outputs.index(port)
            for k in [at, *([model.states.index(port)] if port in model.states else [])]:
                spread[k] = real
                self.low[k], self.high[k] = np.nanmin(logged[:, index]), np.nanmax(logged[:, index])
        self.spread = np.where(spread > 0.0, spread, 1e-6 * np.maximum(1.0, np.abs(every).max(initial=0.0)))
        self.scale = np.concatenate([self.spread[:count], np.maximum(model.tolerance, 1e-12)])
        self.length = float(np.mean([len(run) for run in runs])) * model.study.interval

    def _with_longer_steps(self) -> list[Array]:
        """Signals of the runs as configured; steps get twice as long where that changes little."""

        def configured() -> tuple[list[Array], list[Array]]:
            made = [
                self.simulated(ext, held, np.concatenate([start, self.model.nominal]), signals=True)
                for ext, held, _, start in self.data
            ]
            return [one for one, _ in made], [signals for _, signals in made]

        fine, signals = configured()
        short = self.sub
        if short > 1:
            self.sub = (short + 1) // 2
            coarse, _ = configured()
            change = np.concatenate([
                (one - two) / self.model.noise for one, two in zip(coarse, fine, strict=True)
            ])  # fmt: skip
            if not float(np.sqrt(np.mean(change**2))) < STEP_ERROR:
                self.sub = short
        return signals

    def simulated(
        self, ext: Array, held: Any, z: Array, laws: Sequence[Inserted] = (), signals: bool = False
    ) -> tuple[Array, Array]:
        """Compared outputs of an open run from z, and its signals [states, inputs, outputs] if asked for."""
        if isinstance(self.model, PlayedModel):
            return self.model.simulated(ext, z, laws, signals)
        return simulated(self.model, ext, held, z, self.sub_of(laws), laws)

    def sub_of(self, laws: Sequence[Inserted]) -> int:
        """Steps of RK4 a sample; more with laws that have states, whose time may be as short as a sample."""
        finer = self.model.finer.get(frozenset(laws), 1)
        return self.sub * max(4 if any(one.states for one in laws) else 1, finer)

    def hidden(self, index: int, laws: Sequence[Inserted], start: Array, constants: Array) -> Array:
        """Start values of the laws' own states in a run: 0, or the signal that the law reads."""
        found = np.zeros(sum(one.states for one in laws))
        if self.model.filters and any(one.settled for one in laws):
            ext, held, *_ = self.data[index]
            z = np.concatenate([start, constants[: len(self.model.nominal)]])
            signals, at = self.simulated(ext[:1], held, z, signals=True)[1][0], 0
            for one in laws:
                found[[at + k for k in one.settled]] = signals[one.signals[0]]
                at += one.states
        return found

    def hidden_scale(self, laws: Sequence[Inserted]) -> Array:
        """Sizes of the laws' own states, for differences."""
        return np.repeat([self.spread[one.signals[0]] for one in laws], [one.states for one in laws])

    def passes(
        self,
        laws: Sequence[Inserted] = (),
        priors: Sequence[tuple[float, float]] = (),
        order: int = 0,
        intensity: float = 0.0,
        *,
        w: Place | None = None,
        smooth: bool = False,
        constants: tuple[Array, Array] | None = None,
        w_scale: float = 1.0,
        only: Sequence[int] | None = None,
        samples: int | None = None,
    ) -> list[Smoothed]:
        """Filter the runs one after the other; the constants' estimate from a run is the next one's prior.

        Args:
            priors: mean and standard deviation of a law's numbers.
            constants: mean and covariance of parameters and numbers, in place of the priors.
            only: indices of the runs. samples: of each run, from its begin; None: all.
        """
        model = self.model
        nx, nh = len(model.states), sum(one.states for one in laws)
        if constants is None:
            mean = np.concatenate([model.nominal, [one for one, _ in priors]])
            cov = np.diag(np.concatenate([model.tolerance, [one for _, one in priors]]) ** 2)
        else:
            mean, cov = constants
        sizes = np.concatenate(
            [
                self.scale[:nx],
                self.hidden_scale(laws),
                self.scale[nx:],
                [abs(one) for _, one in priors],
                [w_scale] * order,
            ]
        )
        if order == 2:
            sizes[-1] = w_scale / self.length
        found = []
        for index in range(len(self.data)) if only is None else only:
            ext, held, logged, start = self.data[index]
            if samples is not None:
                end = self.model.study.settled + samples
                ext, logged = ext[:end], logged[:end]
            z = np.concatenate([start, self.hidden(index, laws, start, mean), mean, np.zeros(order)])
            variance = np.zeros((len(z), len(z)))
            variance[:nx, :nx] = np.diag(_START * self.scale[:nx] ** 2)
            at = slice(nx + nh, nx + nh + len(mean))
            variance[at, at] = cov
            if order:
                first = intensity * (self.length / 20.0) ** (2 * order - 1)
                variance[-order, -order] = 10.0 * first
                if order == 2:
                    variance[-1, -1] = 10.0 * first / (self.length / 20.0) ** 2
            one = filtered(
                model, ext, held, logged, z, variance, sizes, self.sub_of(laws), laws=laws, w=w, order=order,
                intensity=intensity, begin=model.study.settled, smooth=smooth,
            )  # fmt: skip
            found.append(one)
            if not np.isfinite(one.loglik):
                return found
            mean, cov = one.z[at], one.covariance[at, at]
        return found

    def effort(self) -> float:
        """Evaluations of components that a simulation of all runs takes."""
        return float(sum(len(one[2]) for one in self.data)) * 4 * self.sub * len(self.model.rows)

    def pass_effort(self) -> float:
        """Evaluations of components that a filter's pass over all runs takes."""
        size = len(self.scale)
        samples = sum(len(one[2]) for one in self.data)
        return float(samples * pass_effort(len(self.model.rows), size, self.sub, False))

    def affordable(self, least: int) -> int | None:
        """Samples of each run that fits look at, at least so many; None: all."""
        share = self.model.effort.share(self.effort())
        if share == 1.0:
            return None
        return max(least, int(share * max(len(one[2]) for one in self.data)))

    def logged_spread(self) -> float:
        """Spread of what is logged, over the noise."""
        parts = [np.nanstd(logged, axis=0) / self.model.noise for _, _, logged, _ in self.data]
        return float(np.sqrt(np.mean(np.square(parts))))

    def spread_at(self, place: Place) -> float:
        """Spread of the signal at a place; of a derivative, that of its state over a twentieth of a run."""
        nx, nu = len(self.model.states), len(self.model.inputs)
        if place.kind == 1:
            return float(self.spread[nx + place.index])
        if place.kind in (Kinds.RATE, Kinds.EXCHANGE):
            return float(self.spread[place.index] / (self.length / 20.0))
        return float(self.spread[nx + nu + place.index])


def loglik(found: Sequence[Smoothed]) -> float:
    """Of several runs."""
    return float(sum(one.loglik for one in found))


def rank(
    runs: Runs,
    places: Sequence[Place] | None = None,
    laws: Sequence[Inserted] = (),
    priors: Sequence[tuple[float, float]] = (),
) -> tuple[float, list[Ranked]]:
    """Places by the likelihood of a random walk there.

    Returns: the calibrated model's log likelihood alone, and the places, best first.
    """
    alone = loglik(runs.passes(laws, priors))
    every = runs.model.places() if places is None else list(places)
    # A part of one run shows which places come near, and about which intensity.
    rough = [(_climbed(runs, place, laws, priors, 1, _MOVES, brief=True), place) for place in every]
    best = max((one.gain for one, _ in rough), default=0.0)
    brief = min(_BRIEF, max(len(run) for run in runs.runs)) * len(runs.model.compared)
    found = []
    for one, place in rough:
        if one.gain < best - _APART * brief:
            continue
        near = [moves for moves in _MOVES if 0.05 < moves / one.moves < 20.0]
        tried = [_climbed(runs, place, laws, priors, order, near) for order in (1, 2)]
        first = max(tried, key=lambda each: each.gain)
        found.append(replace(first, gain=first.gain - alone))
    found.sort(key=lambda one: one.gain, reverse=True)
    return alone, found


def _climbed(
    runs: Runs,
    place: Place,
    laws: Sequence[Inserted],
    priors: Sequence[tuple[float, float]],
    order: int,
    grid: Sequence[float],
    brief: bool = False,
) -> Ranked:
    """The likeliest intensity of a random walk at a place; `gain` is the log likelihood itself."""
    size = runs.spread_at(place)
    best, last = Ranked(place, -np.inf, order, 0.0), -np.inf
    for moves in grid:
        intensity = (moves * size) ** 2 / (runs.length / 20.0) ** (2 * order - 1)
        scale = max(size * min(moves, 1.0), 1e-12)
        only, samples = ([0], _BRIEF) if brief else (None, None)
        value = loglik(
            runs.passes(laws, priors, order, intensity, w=place, w_scale=scale, only=only, samples=samples)
        )
        if value < min(last, best.gain - 30.0):
            break
        last = value
        if value > best.gain:
            best = Ranked(place, value, order, intensity, moves)
    return best


def smoothed_at(
    runs: Runs,
    ranked: Ranked,
    laws: Sequence[Inserted] = (),
    priors: Sequence[tuple[float, float]] = (),
) -> list[dict[str, Any]]:
    """w, its variance and all signals along each run: keys `w`, `variance`, `signals`."""
    place, size = ranked.place, runs.spread_at(ranked.place)
    made = runs.passes(laws, priors, ranked.order, ranked.intensity, w=place, smooth=True, w_scale=size)
    found = []
    for index, one in enumerate(made):
        if not len(one.variance) or not np.isfinite(one.loglik):
            continue
        signals = signals_along(runs.model, runs.data[index][0], one.path, laws, place, ranked.order)
        found.append(
            {"w": one.path[:, -ranked.order], "variance": one.variance, "signals": signals, "run": index}
        )
    return found
