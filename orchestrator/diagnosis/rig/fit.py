"""Maximum a posteriori fits of effects, jointly with the calibration, and their evidence."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from .descent import Descent, Place, cost_of
from .effect import Effect, Parameter, Seen
from .marginal import Marginal
from .study import Array

# Derivatives of normalised residuals beyond this are those of a model that diverges; NaN is beyond, too.
_RUNAWAY = 1e60
# Differences that move the residuals by more standard deviations are no approximation of a derivative.
_FAR = 20.0
# Bases whose costs differ by less are much the same place: effects are screened from the better one alone.
_ALIKE = 60.0
# What a jagged parameter is moved by, normalised, where a model is carried to other runs, and the cost that
# this may make on those that it was fitted to.
_ASIDE, _OPEN = np.outer(10.0 ** np.arange(-6, -1), (1.0, 1.5, 2.0, 3.0, 5.0, 7.0)).ravel(), 2.0
_SWEEPS = 4
# Normalised parameters that differ by less are the same.
_SAME = 1e-9
# A calibrated number of more tolerances than the first is not zero; it loses at most the second share of it.
_SURE, _SIZE = 3.0, 0.95


@dataclass(frozen=True)
class Fit:
    """A fitted model.

    Attributes:
        effects: beside the calibration.
        calibrated: calibrated parameters, by name.
        theta: all parameters of the effects, one after the other.
        deviation: of the calibrated parameters, in units of their tolerances, by name.
        cost: sum of squared normalised residuals and priors.
        chi2: of the residuals alone.
        log_determinant: of the Hessian in normalised parameters; Laplace's volume.
        residuals: normalised, per run and channel, as the replay gives them.
        z: all parameters, normalised by their priors.
    """

    effects: tuple[Effect, ...]
    calibrated: dict[str, float]
    theta: Array
    deviation: dict[str, float]
    cost: float
    chi2: float
    log_determinant: float
    residuals: tuple[Array, ...]
    z: Array

    @property
    def log_evidence(self) -> float:
        """Laplace's approximation of the log evidence, up to a common constant [nats].

        Parameters are normalised by their priors, whose volumes are one.
        """
        return -0.5 * self.cost - 0.5 * self.log_determinant

    def without(self, place: int) -> Array:
        """Normalised parameters less those of one of its effects."""
        last = len(self.z) - sum(len(one.parameters) for one in self.effects[place + 1 :])
        return np.delete(self.z, np.arange(last - len(self.effects[place].parameters), last))


class Base(NamedTuple):
    """A point about which effects are screened.

    Attributes:
        z: normalised parameters; r: stacked residuals there; jacobian: their derivatives.
    """

    effects: tuple[Effect, ...]
    z: Array
    r: Array
    jacobian: Array


class Replay(Protocol):
    """A component, or a chain of them, that is driven by its measured inputs and compared at its outputs.

    Attributes:
        tolerances: of the calibrated parameters that it depends on, by name: nominal value and standard
            deviation, SI.
    """

    @property
    def tolerances(self) -> Mapping[str, tuple[float, float]]: ...

    def residuals(
        self, calibrated: Mapping[str, float], effects: tuple[Effect, ...], theta: Array
    ) -> list[Array]:
        """Measured minus replayed outputs over their noise, per run and channel."""


@runtime_checkable
class Seeing(Protocol):
    """A replay with the data from which effects propose start values."""

    def seen(self, calibrated: Mapping[str, float], effects: tuple[Effect, ...], theta: Array) -> Seen:
        """Data for effects that propose start values."""


class Fitter:
    """Fits effects to replays.

    Args:
        inflation, roughness, apart: as those of `marginal.Marginal`.

    Attributes:
        marginal: by which residuals are weighed.
    """

    def __init__(
        self, replay: Replay, inflation: float = 1.0, roughness: Array | None = None, apart: int = 0
    ) -> None:
        self.replay = replay
        self.marginal = Marginal(inflation, roughness, apart)
        self._names = tuple(replay.tolerances)
        self._centre = np.array([one[0] for one in replay.tolerances.values()])
        self._tolerance = np.array([one[1] for one in replay.tolerances.values()])
        # A calibrated number that is clearly not zero keeps its sign, and some of its size: a stiffness, a
        # frequency or a delay of the other sign is no calibration's error, and runs away.
        nearest = -_SIZE * self._centre / self._tolerance
        sure = np.abs(self._centre) > _SURE * self._tolerance
        self._low = np.where(sure & (self._centre > 0.0), nearest, -math.inf)
        self._high = np.where(sure & (self._centre < 0.0), nearest, math.inf)

    @property
    def nominal(self) -> Array:
        """The normalised calibration as it is believed to be."""
        return np.zeros(len(self._names))

    # Normalised parameters: the calibration in tolerances, then the effects' in prior scales.

    def _theta(self, effects: tuple[Effect, ...], z: Array) -> Array:
        parameters = [one for effect in effects for one in effect.parameters]
        return np.array(
            [_value(one, value) for one, value in zip(parameters, z[len(self._names) :], strict=True)]
        )

    def _calibrated(self, z: Array) -> dict[str, float]:
        values = self._centre + self._tolerance * z[: len(self._names)]
        return dict(zip(self._names, values.tolist(), strict=True))

    def normalised(self, calibrated: Mapping[str, float], effects: tuple[Effect, ...], theta: Array) -> Array:
        """Normalised parameters of a model; calibrated ones that are not named are nominal."""
        values = [
            calibrated.get(name, centre) for name, centre in zip(self._names, self._centre, strict=True)
        ]
        parameters = [one for effect in effects for one in effect.parameters]
        return np.concatenate(
            [
                (np.array(values) - self._centre) / self._tolerance,
                [_normalised(one, value) for one, value in zip(parameters, theta, strict=True)],
            ]
        )

    def values(self, effects: tuple[Effect, ...], z: Array) -> tuple[dict[str, float], Array]:
        """Calibration by name, and parameters of the effects, from normalised ones."""
        return self._calibrated(z), self._theta(effects, z)

    def residuals(self, effects: tuple[Effect, ...], z: Array) -> list[Array]:
        """Normalised residuals, per run and channel, at normalised parameters."""
        return self.replay.residuals(self._calibrated(z), effects, self._theta(effects, z))

    def stacked(self, effects: tuple[Effect, ...], z: Array) -> Array:
        """All residuals in a row, inflation and roughness accounted for."""
        return self.marginal.stacked(self.residuals(effects, z))

    def log_evidence(self, fit: Fit, inflation: Sequence[float]) -> float:
        """Log evidence of a fit where the squares of residuals are inflated, per run and channel [nats].

        See `Fit.log_evidence`; the fit itself is taken as it is.
        """
        r = self.marginal.stacked(fit.residuals)
        parts = np.split(r, np.cumsum([len(one) for one in fit.residuals])[:-1])
        square = sum(float(one @ one) / by for one, by in zip(parts, inflation, strict=True))
        return -0.5 * (square + fit.cost - fit.chi2) - 0.5 * fit.log_determinant

    def starts(self, effect: Effect) -> list[Array]:
        """Start values for fits of an effect, normalised."""
        choices = []
        for one in effect.parameters:
            if one.whole:
                values: Sequence[float] = range(int(one.low), int(one.high) + 1)
            else:
                values = one.starts or (0.05 * one.scale,)
            choices.append([_normalised(one, value) for value in values])
        return [np.array(start) for start in product(*choices)]

    def fit(
        self,
        effects: tuple[Effect, ...],
        begin: Array | None = None,
        start: Array | None = None,
        known: Array | None = None,
        aim: float = math.inf,
    ) -> Fit:
        """Fit effects and calibration.

        Args:
            begin: normalised calibration to begin from; zero, the nominal one, by default.
            start: normalised parameters of the effects to begin from.
            known: derivatives of the stacked residuals by the calibration where the fit begins, if at hand,
                shape (residuals, calibrated).
            aim: a cost; a fit that will not come near it is given up.
        Returns: of infinite cost where the model runs away from the begin.
        Raises: ValueError if there are not as many parameters to begin from as the effects have.
        """
        count = len(self._names)
        parameters = [one for effect in effects for one in effect.parameters]
        z = np.zeros(count + len(parameters))
        if begin is not None:
            z[:count] = begin
        if start is not None:
            if len(start) != len(parameters):
                raise ValueError(f"{len(start)} parameters to begin from, {len(parameters)} to fit")
            z[count:] = start
        r = self.stacked(effects, z)
        cost = cost_of(r, z)
        if not math.isfinite(cost):
            # Where the model runs away, no derivative leads back.
            return self._fitted(effects, z, r, cost, 0.0)
        jacobian = self.jacobian(effects, z, r, range(len(z)) if known is None else range(count, len(z)))
        if known is not None:
            jacobian[:, :count] = known
        at = Place(z, r, cost, jacobian, known is None)
        self._descent(effects).run(at, aim)
        _, log_determinant = np.linalg.slogdet(at.hessian)
        return self._fitted(effects, at.z, at.r, at.cost, float(log_determinant))

    def carried(self, fit: Fit, by: Fitter) -> tuple[Fit, Array]:
        """A model that was fitted to other runs, applied to these.

        Its parameters may move by one linear step within their uncertainty on the other runs, if that
        improves the fit. Parameters without derivatives may move within the range that those runs allow. The
        deviations from the calibration are not changed.

        Args:
            by: a fitter of those runs.
        Returns: the fit, and derivatives of the stacked residuals by its normalised parameters.
        """
        z = self._refitted_jagged(fit, by)
        r = self.stacked(fit.effects, z)
        jacobian = self.jacobian(fit.effects, z, r, range(len(z)))
        if np.isfinite(r).all():
            smooth = self._smooth(fit.effects)
            step = np.zeros(len(z))
            step[smooth] = _least(jacobian[:, smooth], r, np.concatenate([z[smooth], z[~smooth]]))[0]
            ahead = self._bounded(fit.effects, z - step)
            moved = self.stacked(fit.effects, ahead)
            if cost_of(moved, ahead) < cost_of(r, z):
                z, r = ahead, moved
        here = self._fitted(fit.effects, z, r, cost_of(r, z), fit.log_determinant)
        return replace(here, deviation=fit.deviation), jacobian

    def _refitted_jagged(self, fit: Fit, by: Fitter) -> Array:
        """Normalised parameters; those without derivatives are moved to their best values on these runs.

        Commands that are rounded equally by many resolutions in the other runs may be rounded differently
        here.

        Args:
            by: a fitter of the other runs; parameters move only where its cost hardly changes.
        """
        effects, z = fit.effects, fit.z
        own = [one.jagged for effect in effects for one in effect.parameters]
        jagged = len(self._names) + np.flatnonzero(own)
        if not jagged.size:
            return z
        cost, most = self._cost(effects, z), by._cost(effects, z) + _OPEN
        for place in _SWEEPS * [*jagged[::-1]]:
            near = np.repeat(z[None], 2 * len(_ASIDE), axis=0)
            near[:, place] += np.concatenate([-_ASIDE, _ASIDE])
            for ahead in self._bounded(effects, near):
                here = self._cost(effects, ahead)
                if here < cost and by._cost(effects, ahead) < most:
                    z, cost = ahead, here
        return z

    def _cost(self, effects: tuple[Effect, ...], z: Array) -> float:
        return cost_of(self.stacked(effects, z), z)

    def _smooth(self, effects: tuple[Effect, ...]) -> Array:
        """Parameters with useful derivatives."""
        own = [one.smooth for effect in effects for one in effect.parameters]
        return np.array([True] * len(self._names) + own)

    def _descent(self, effects: tuple[Effect, ...]) -> Descent:
        """A descent of effects and calibration."""
        return Descent(
            lambda z: self.stacked(effects, z),
            lambda z, r: self.jacobian(effects, z, r, range(len(z))),
            *self._limits(effects),
            np.flatnonzero(self._smooth(effects)),
        )

    def _fitted(
        self, effects: tuple[Effect, ...], z: Array, r: Array, cost: float, log_determinant: float
    ) -> Fit:
        """A fit that ended at z, where the stacked residuals are r."""
        with np.errstate(over="ignore", invalid="ignore"):
            chi2 = float(r @ r)
        return Fit(
            effects,
            self._calibrated(z),
            self._theta(effects, z),
            dict(zip(self._names, z[: len(self._names)].tolist(), strict=True)),
            float(cost),
            chi2,
            log_determinant,
            tuple(self.residuals(effects, z)),
            z,
        )

    def jacobian(self, effects: tuple[Effect, ...], z: Array, r: Array, places: Iterable[int]) -> Array:
        """Derivatives of the stacked residuals by normalised parameters, by differences; others are zero."""
        found = np.zeros((r.size, len(z)), order="F")
        for place in places:
            with np.errstate(over="ignore", invalid="ignore"):
                column = self._column(effects, z, r, place)
            # Where a model diverges, derivatives have no meaning; a fit does not move in that direction.
            if np.abs(column).max(initial=0.0) < _RUNAWAY:
                found[:, place] = column
        return found

    def _column(self, effects: tuple[Effect, ...], z: Array, r: Array, place: int) -> Array:
        """Derivatives of the stacked residuals by one parameter."""
        step = 0.05
        column = self._difference(effects, z, r, place, step)
        moved = step * float(np.linalg.norm(column))
        if _FAR < moved < _RUNAWAY:
            column = self._difference(effects, z, r, place, step * 0.5 * _FAR / moved)
        return column

    def _difference(self, effects: tuple[Effect, ...], z: Array, r: Array, place: int, step: float) -> Array:
        ahead = z.copy()
        ahead[place] += step
        if self._bounded(effects, ahead)[place] < ahead[place]:
            # Beyond a bound nothing changes, which is no derivative.
            step, ahead[place] = -step, z[place] - step
        return (self.stacked(effects, ahead) - r) / step

    def screen(self, effect: Effect, bases: Sequence[Base]) -> tuple[float, Base, Array]:
        """How well an effect could do, by one replay per start: the cost of the problem linearised there.

        Returns: the least cost, the base and the start that give it.
        """
        best: tuple[float, Base, Array] | None = None
        costs = [cost_of(base.r, base.z) for base in bases]
        least = min(costs)
        best_base = bases[costs.index(least)]
        others = [base for base, cost in zip(bases, costs, strict=True) if cost > least + _ALIKE]
        proposed = self._proposed(effect, best_base)
        for base in [*others, best_base]:
            for start in [*self.starts(effect), *proposed]:
                cost = self._promise(effect, base, start)
                if math.isfinite(cost) and (best is None or cost < best[0]):
                    best = cost, base, start
        for base in bases:
            instead = self._instead(effect, base)
            if instead is not None and (best is None or instead[0] < best[0]):
                best = instead
        if best is None:
            return math.inf, bases[0], self.starts(effect)[0]
        return best

    def _instead(self, effect: Effect, base: Base) -> tuple[float, Base, Array] | None:
        """Parameters at which an effect replaces the deviation of a calibrated number, and the cost there.

        Both do the very same, and so little distinguishes them that a linearised problem misses it.

        Returns: None where the effect does another thing, or cannot be as large.
        """
        if len(effect.changes) != 1 or len(effect.parameters) != 1:
            return None
        target = next(iter(effect.changes))
        name, relative = target.removeprefix("*"), target.startswith("*")
        if name not in self._names:
            return None
        place = self._names.index(name)
        size, offset = effect.parameters[0], self._tolerance[place] * base.z[place]
        with np.errstate(divide="ignore", invalid="ignore"):
            start = np.array([_normalised(size, offset / self._centre[place] if relative else offset)])
        if not np.isfinite(start).all() or not math.isclose(
            _normalised(size, _value(size, start[0])), start[0], abs_tol=_SAME
        ):
            return None
        z = base.z.copy()
        z[place] = 0.0
        return cost_of(base.r, np.concatenate([z, start])), base._replace(z=z), start

    def _promise(self, effect: Effect, base: Base, start: Array) -> float:
        """Cost of the problem linearised about a base with an effect at its start; inf if it runs away."""
        z = np.concatenate([base.z, start])
        r = self.stacked((*base.effects, effect), z)
        if not np.isfinite(r).all():
            return math.inf
        columns = base.jacobian
        if not effect.parameters[0].whole and not effect.parameters[0].shape:
            # The first parameter is the size; the replay without the effect gives the derivative.
            columns = np.column_stack([columns, (r - base.r) / start[0]])
        step, cost = _least(columns, r, z)
        count = base.jacobian.shape[1]
        if columns.shape[1] == count:
            return cost
        size = effect.parameters[0]
        kept = _normalised(size, _value(size, z[count] - step[count]))
        if math.isclose(kept, z[count] - step[count], abs_tol=_SAME):
            return cost
        # A size beyond its bounds, as a negative delay, promises what no fit can keep.
        r, z = r + columns[:, count] * (kept - z[count]), np.r_[z[:count], kept, z[count + 1 :]]
        return _least(base.jacobian, r, z)[1]

    def _proposed(self, effect: Effect, base: Base) -> list[Array]:
        """Starts that the runs themselves show, in normalised parameters."""
        if effect.propose is None or not isinstance(self.replay, Seeing):
            return []
        seen = self.replay.seen(self._calibrated(base.z), base.effects, self._theta(base.effects, base.z))
        starts = effect.propose(seen)
        return [
            np.array([_normalised(one, value) for one, value in zip(effect.parameters, start, strict=True)])
            for start in starts
        ]

    def base(self, effects: tuple[Effect, ...], z: Array) -> Base:
        """A point to screen from."""
        r = self.stacked(effects, z)
        return Base(effects, z, r, self.jacobian(effects, z, r, range(len(z))))

    def _limits(self, effects: tuple[Effect, ...]) -> tuple[Array, Array]:
        """Least and largest normalised parameters."""
        parameters = [one for effect in effects for one in effect.parameters]
        low = [_normalised(one, one.low) for one in parameters]
        high = [_normalised(one, one.high) for one in parameters]
        return np.concatenate([self._low, low]), np.concatenate([self._high, high])

    def _bounded(self, effects: tuple[Effect, ...], z: Array) -> Array:
        return np.clip(z, *self._limits(effects))


def _least(columns: Array, r: Array, z: Array) -> tuple[Array, float]:
    """Step to the least cost of a linearised problem, and that cost.

    Args:
        columns: derivatives of the residuals r by the first of the parameters z; others stay.
    """
    # About a model that is about to run away numbers are too large to be squared: it promises nothing.
    with np.errstate(over="ignore", invalid="ignore"):
        hessian = columns.T @ columns + np.eye(columns.shape[1])
        slope = columns.T @ r + z[: columns.shape[1]]
        step = np.linalg.solve(hessian, slope)
        return step, cost_of(r, z) - float(slope @ step)


def _centre(one: Parameter) -> float:
    return one.starts[len(one.starts) // 2]


def _value(one: Parameter, z: float) -> float:
    """A parameter from its normalised value, within its bounds."""
    value = _centre(one) * math.exp(min(one.scale * z, 700.0)) if one.shape else one.scale * z
    return min(max(value, one.low), one.high)


def _normalised(one: Parameter, value: float) -> float:
    """The inverse of `_value`."""
    if not one.shape:
        return value / one.scale
    return math.log(value / _centre(one)) / one.scale if value > 0 else -math.inf
