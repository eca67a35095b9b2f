"""Maximum a posteriori fits of effects, jointly with the calibration, and their evidence."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np

from .effect import Effect
from .model import CALIBRATED, RigModel
from .study import Array

__all__ = ["Base", "Fit", "Fitter"]

_MAX_ITERATIONS = 12
# A fit has converged when the cost falls by less.
_CONVERGED = 0.05


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
        residuals: normalised, per run and channel: encoder, force.
        sigma: standard deviations of theta.
        z: all parameters, normalised by their priors.
    """

    effects: tuple[Effect, ...]
    calibrated: dict[str, float]
    theta: Array
    deviation: dict[str, float]
    cost: float
    chi2: float
    log_determinant: float
    residuals: tuple[tuple[Array, Array], ...]
    sigma: Array
    z: Array

    @property
    def log_evidence(self) -> float:
        """Laplace's approximation of the logarithm of the evidence, up to what all models share [nats].

        Parameters are normalised by their priors, whose volumes are one.
        """
        return -0.5 * self.cost - 0.5 * self.log_determinant


class Base(NamedTuple):
    """A point about which effects are screened.

    Attributes:
        z: normalised parameters; r: stacked residuals there; jacobian: their derivatives.
    """

    effects: tuple[Effect, ...]
    z: Array
    r: Array
    jacobian: Array


class Fitter:
    """Fits effects to the replayed runs of a model.

    Args:
        inflation: by which squared residuals are divided: autocorrelated residuals, and what no model holds,
            carry less information than their number.
    """

    def __init__(self, model: RigModel, inflation: float = 1.0) -> None:
        self.model = model
        self.inflation = inflation
        nominal = model.study.nominal
        self._names = tuple(name for name in CALIBRATED if nominal[name].tolerance > 0)
        self._centre = np.array([nominal[name].value for name in self._names])
        self._tolerance = np.array([nominal[name].tolerance for name in self._names])
        self._noise = (
            math.hypot(nominal["encoder_noise"].value, nominal["encoder_resolution"].value / math.sqrt(12.0)),
            math.hypot(nominal["force_noise"].value, nominal["force_resolution"].value / math.sqrt(12.0)),
        )

    # Normalised parameters: the calibration in tolerances, then the effects' in prior scales.

    def _theta(self, effects: tuple[Effect, ...], z: Array) -> Array:
        first = len(self._names)
        theta = []
        for effect in effects:
            for one in effect.parameters:
                value = _shape_centre(one) * math.exp(one.scale * z[first]) if one.shape else one.scale * z[first]
                theta.append(min(max(value, one.low), one.high))
                first += 1
        return np.array(theta)

    def _calibrated(self, z: Array) -> dict[str, float]:
        values = self._centre + self._tolerance * z[: len(self._names)]
        return dict(zip(self._names, values.tolist(), strict=True))

    def residuals(self, effects: tuple[Effect, ...], z: Array) -> list[tuple[Array, Array]]:
        """Normalised residuals of encoder and force, per run."""
        calibrated, theta = self._calibrated(z), self._theta(effects, z)
        found = []
        for index, run in enumerate(self.model.runs):
            out = self.model.replay(index, calibrated, effects, theta)
            found.append(
                (
                    (run["encoder_position"] - out[2]) / self._noise[0],
                    (run["sensor_force"] - out[3]) / self._noise[1],
                )
            )
        return found

    def _stacked(self, effects: tuple[Effect, ...], z: Array) -> Array:
        scale = 1.0 / math.sqrt(self.inflation)
        return scale * np.concatenate([part for pair in self.residuals(effects, z) for part in pair])

    def starts(self, effect: Effect) -> list[Array]:
        """Where fits of an effect begin, in normalised parameters."""
        choices = []
        for one in effect.parameters:
            if one.whole:
                choices.append([value / one.scale for value in range(int(one.low), int(one.high) + 1)])
            elif one.shape:
                centre = _shape_centre(one)
                choices.append([math.log(value / centre) / one.scale for value in one.starts])
            else:
                choices.append([value / one.scale for value in one.starts] or [0.05])
        return [np.array(start) for start in product(*choices)]

    def fit(
        self,
        effects: tuple[Effect, ...],
        begin: Array | None = None,
        start: Array | None = None,
        known: Array | None = None,
    ) -> Fit:
        """Fit effects and calibration.

        Args:
            begin: normalised calibration to begin from; zero, the nominal one, by default.
            start: normalised parameters of the effects to begin from.
            known: derivatives of the stacked residuals by the calibration where the fit begins, if at hand,
                shape (residuals, calibrated).
        """
        count = len(self._names)
        parameters = [one for effect in effects for one in effect.parameters]
        z = np.zeros(count + len(parameters))
        if begin is not None:
            z[:count] = begin
        if start is not None:
            z[count:] = start
        free = np.array([place for place in range(len(z)) if place < count or not parameters[place - count].whole])
        r = self._stacked(effects, z)
        cost = _cost(r, z)
        jacobian = self.jacobian(effects, z, r, range(len(z)) if known is None else range(count, len(z)))
        if known is not None:
            jacobian[:, :count] = known
        fresh, damping = known is None, 1e-3
        for _ in range(_MAX_ITERATIONS):
            hessian = jacobian.T @ jacobian + np.eye(len(z))
            slope = jacobian.T @ r + z
            gain = 0.0
            for _ in range(6):
                damped = hessian + damping * np.diag(np.diag(hessian))
                ahead = z.copy()
                ahead[free] -= np.linalg.solve(damped[np.ix_(free, free)], slope[free])
                ahead = self._bounded(effects, ahead)
                r_ahead = self._stacked(effects, ahead)
                cost_ahead = _cost(r_ahead, ahead)
                if cost_ahead < cost:
                    move = ahead - z
                    # Broyden's update: the derivatives along the step just taken are known.
                    jacobian += np.outer(r_ahead - r - jacobian @ move, move / (move @ move))
                    gain, fresh = cost - cost_ahead, False
                    z, r, cost = ahead, r_ahead, cost_ahead
                    damping = max(damping / 10.0, 1e-9)
                    break
                damping *= 10.0
            if gain < max(_CONVERGED, 2e-4 * cost):
                if fresh or gain >= _CONVERGED and gain < 1e-3:
                    break
                jacobian, fresh, damping = self.jacobian(effects, z, r, range(len(z))), True, 1e-3
                if gain < _CONVERGED and self._predicted(jacobian, r, z, free) < _CONVERGED:
                    break
        hessian = jacobian.T @ jacobian + np.eye(len(z))
        _, log_determinant = np.linalg.slogdet(hessian)
        theta = self._theta(effects, z)
        scales = [one.scale * (value if one.shape else 1.0) for one, value in zip(parameters, theta, strict=True)]
        return Fit(
            effects,
            self._calibrated(z),
            theta,
            dict(zip(self._names, z[:count].tolist(), strict=True)),
            float(cost),
            float(r @ r),
            float(log_determinant),
            tuple(self.residuals(effects, z)),
            np.sqrt(np.diag(np.linalg.inv(hessian)))[count:] * np.array(scales),
            z,
        )

    def jacobian(self, effects: tuple[Effect, ...], z: Array, r: Array, places: Iterable[int]) -> Array:
        """Derivatives of the stacked residuals by normalised parameters, by differences; others are zero."""
        found = np.zeros((r.size, len(z)), order="F")
        for place in places:
            ahead = z.copy()
            ahead[place] += 0.02
            found[:, place] = (self._stacked(effects, ahead) - r) / 0.02
        return found

    @staticmethod
    def _predicted(jacobian: Array, r: Array, z: Array, free: Array) -> float:
        """By how much a step to the minimum of the linearised problem would lower the cost."""
        hessian = (jacobian.T @ jacobian + np.eye(len(z)))[np.ix_(free, free)]
        slope = (jacobian.T @ r + z)[free]
        return float(slope @ np.linalg.solve(hessian, slope))

    def screen(self, effect: Effect, bases: Sequence[Base]) -> tuple[float, Base, Array]:
        """How well an effect could do, from one replay per start: the cost of the problem linearised about it.

        Returns: the least cost, the base and the start that give it.
        """
        count = len(self._names)
        best: tuple[float, Base, Array] | None = None
        for base in bases:
            effects = (*base.effects, effect)
            for start in self.starts(effect):
                z = np.concatenate([base.z, start])
                r = self._stacked(effects, z)
                if not np.isfinite(r).all():
                    continue
                columns = base.jacobian
                offset = z.copy()
                if not effect.parameters[0].whole and not effect.parameters[0].shape:
                    # The first parameter is the size; the replay without the effect gives the derivative.
                    amplitude = (r - base.r) / start[0]
                    columns = np.column_stack([columns, amplitude])
                    offset = z[: columns.shape[1]]
                hessian = columns.T @ columns + np.eye(columns.shape[1])
                offset = offset[: columns.shape[1]]
                slope = columns.T @ r + offset
                cost = _cost(r, z) - float(slope @ np.linalg.solve(hessian, slope))
                if best is None or cost < best[0]:
                    best = cost, base, start
        if best is None:
            return math.inf, bases[0], self.starts(effect)[0]
        assert count <= best[1].z.size
        return best

    def base(self, effects: tuple[Effect, ...], z: Array) -> Base:
        """A point to screen from."""
        r = self._stacked(effects, z)
        return Base(effects, z, r, self.jacobian(effects, z, r, range(len(z))))

    def _bounded(self, effects: tuple[Effect, ...], z: Array) -> Array:
        place = len(self._names)
        for effect in effects:
            for one in effect.parameters:
                low, high = one.low, one.high
                if one.shape:
                    centre = _shape_centre(one)
                    low = math.log(max(low, 1e-300) / centre) * 1.0
                    high = math.log(high / centre)
                z[place] = min(max(z[place], low / one.scale), high / one.scale)
                place += 1
        return z



def _cost(r: Array, z: Array) -> float:
    with np.errstate(over="ignore", invalid="ignore"):
        cost = float(r @ r + z @ z)
    return cost if math.isfinite(cost) else math.inf


def _shape_centre(one: object) -> float:
    starts = one.starts  # type: ignore[attr-defined]
    return starts[len(starts) // 2]
