"""Maximum a posteriori fits of effects, jointly with the calibration, and their evidence."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from .effect import Effect
from .model import CALIBRATED, RigModel
from .study import Array

__all__ = ["Fit", "Fitter"]

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

    @property
    def log_evidence(self) -> float:
        """Laplace's approximation of the logarithm of the evidence, up to what all models share [nats].

        Parameters are normalised by their priors, whose volumes are one.
        """
        return -0.5 * self.cost - 0.5 * self.log_determinant


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

    def fit(self, effects: tuple[Effect, ...], begin: Array | None = None, start: Array | None = None) -> Fit:
        """Fit effects and calibration.

        Args:
            begin: normalised calibration to begin from; zero, the nominal one, by default.
            start: normalised parameters of the effects to begin from.
        """
        count = len(self._names)
        size = count + sum(len(effect.parameters) for effect in effects)
        z = np.zeros(size)
        if begin is not None:
            z[:count] = begin
        if start is not None:
            z[count:] = start
        fixed = [
            count + place
            for place, one in enumerate(one for effect in effects for one in effect.parameters)
            if one.whole
        ]
        free = np.array([place for place in range(size) if place not in fixed])
        r = self._stacked(effects, z)
        cost = r @ r + z @ z
        damping = 1e-3
        jacobian = np.empty((r.size, size))
        for _ in range(_MAX_ITERATIONS):
            jacobian[:] = 0.0
            for place in free:
                step = 0.02 if place < count else 0.01
                ahead = z.copy()
                ahead[place] += step
                jacobian[:, place] = (self._stacked(effects, ahead) - r) / step
            hessian = jacobian.T @ jacobian + np.eye(size)
            slope = jacobian.T @ r + z
            gain = 0.0
            for _ in range(7):
                damped = hessian + damping * np.diag(np.diag(hessian))
                move = np.zeros(size)
                move[free] = -np.linalg.solve(damped[np.ix_(free, free)], slope[free])
                ahead = self._bounded(effects, z + move)
                r_ahead = self._stacked(effects, ahead)
                cost_ahead = r_ahead @ r_ahead + ahead @ ahead
                if cost_ahead < cost:
                    gain = cost - cost_ahead
                    z, r, cost = ahead, r_ahead, cost_ahead
                    damping = max(damping / 10.0, 1e-9)
                    break
                damping *= 10.0
            if gain < _CONVERGED:
                break
        _, log_determinant = np.linalg.slogdet(hessian)
        spread = np.sqrt(np.diag(np.linalg.inv(hessian)))[count:]
        scales = np.array(
            [
                one.scale * (value if one.shape else 1.0)
                for one, value in zip(
                    (one for effect in effects for one in effect.parameters), self._theta(effects, z), strict=True
                )
            ]
        )
        return Fit(
            effects,
            self._calibrated(z),
            self._theta(effects, z),
            dict(zip(self._names, z[:count].tolist(), strict=True)),
            float(cost),
            float(r @ r),
            float(log_determinant),
            tuple(self.residuals(effects, z)),
            spread * scales if len(scales) else np.zeros(0),
        )

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

    def best(self, effect: Effect, base: Sequence[Effect] = (), begin: Array | None = None, head: Array | None = None) -> Fit:
        """The best fit of an effect, on top of others, over all its starts.

        Every start is tried without refitting the calibration, and the two best are fitted.
        """
        effects = (*base, effect)
        count = len(self._names)
        head = np.zeros(0) if head is None else head
        tried = []
        for start in self.starts(effect):
            z = np.concatenate([np.zeros(count) if begin is None else begin, head, start])
            r = self._stacked(effects, z)
            tried.append((float(r @ r), start))
        tried.sort(key=lambda pair: pair[0])
        keep = len(tried) if all(one.whole for one in effect.parameters) and len(tried) <= 2 else 2
        fits = [self.fit(effects, begin, np.concatenate([head, start])) for _, start in tried[:keep]]
        return min(fits, key=lambda one: one.cost)


def _shape_centre(one: object) -> float:
    starts = one.starts  # type: ignore[attr-defined]
    return starts[len(starts) // 2]
