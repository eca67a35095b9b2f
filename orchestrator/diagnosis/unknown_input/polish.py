"""Replay runs, and polish numbers by least squares of the simulation error.

A filter corrects its states at each sample, so that a law that is only nearly right looks worse than it is.
An answer is judged by the simulation error. Here it is made as small as the numbers allow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from .evaluation import Inserted
from .open_run import sensitive
from .places import Runs

Array = NDArray[np.float64]
WORST = 1e5  # residuals over the noise are cut off there, where a simulation runs away
_STEEPEST = 1e100  # derivatives are cut off there
# Periods of a tone in a run, and share of the residual's power that is one.
_PERIODS, _TONE = 5, 0.3
_STEP = 1e-5  # of finite differences, over the size of a number


@dataclass(frozen=True)
class Polished:
    """Numbers that simulate the runs best.

    Attributes:
        constants: parameters, then the laws' numbers. covariance: of them, for residuals of their size.
        starts: start states of each run.
        remains: root mean square of the residual over the noise. samples: compared values.
        length: samples after which the residual forgets itself; 1 for white noise.
        strain: sum of squares of the parameters' changes over their tolerances.
    """

    constants: Array
    covariance: Array
    starts: list[Array]
    remains: float
    samples: int
    length: float
    strain: float = 0.0


class Replays:
    """Runs as simulated with laws, as a function of numbers.

    Args:
        samples: of each run, from its begin; None: all. starts: start states; by default the study's.
    """

    def __init__(
        self, runs: Runs, laws: Sequence[Inserted], samples: int | None = None,
        starts: Sequence[Array] | None = None,
    ) -> None:  # fmt: skip
        self.runs, self.laws, self.model = runs, list(laws), runs.model
        self.settled = self.model.study.settled
        end = None if samples is None else self.settled + samples
        self.data = [(ext[:end], held, logged[:end]) for ext, held, logged, _ in runs.data]
        self.masks = [~np.isnan(logged[self.settled :]) for *_, logged in self.data]
        self.starts = [one[3] for one in runs.data] if starts is None else list(starts)
        self.hidden = sum(one.states for one in laws)
        self.scale = runs.scale[: len(self.model.states)]
        # At communication points holds jump with their numbers, which stay where a fit begins.
        ends = len(self.model.nominal) + np.cumsum([0, *(one.numbers for one in laws)])
        self.still = [
            j for one, first, end in zip(laws, ends, ends[1:], strict=False)
            if one.delay == "held" and not self.model.filters for j in range(first, end)
        ]  # fmt: skip

    def found(self, index: int, start: Array, constants: Array) -> Array:
        """Compared signals of one run as simulated, shape (samples, compared)."""
        ext, held, _ = self.data[index]
        z = np.concatenate([start, self.runs.hidden(index, self.laws, start, constants), constants])
        return self.runs.simulated(ext, held, z, self.laws)[0]

    def left(self, index: int, start: Array, constants: Array) -> Array:
        """The residual of one run over the noise, shape (compared values,)."""
        return self.compared(index, self.found(index, start, constants))

    def compared(self, index: int, found: Array) -> Array:
        """The residual of a simulated run."""
        logged = self.data[index][2]
        left = np.clip(found - logged, -WORST * self.model.noise, WORST * self.model.noise)
        return np.nan_to_num((left / self.model.noise)[self.settled :][self.masks[index]], nan=WORST)

    def residual(self, constants: Array, starts: Sequence[Array] | None = None) -> Array:
        """The residuals of all runs, one after the other."""
        begin = self.starts if starts is None else starts
        return np.concatenate([self.left(k, begin[k], constants) for k in range(len(self.data))])

    def tone(self, constants: Array) -> float:
        """Frequency of the residual [rad/s], 0 if it is no tone: if little of it lies near one frequency."""
        interval, most = self.model.study.interval, max(len(one[2]) for one in self.data)
        size = 1 << (8 * most).bit_length()
        power = np.zeros(size // 2 + 1)
        for k, (_, _, logged) in enumerate(self.data):
            left = (self.found(k, self.starts[k], constants) - logged)[self.settled :] / self.model.noise
            left = np.nan_to_num(np.clip(left, -WORST, WORST))
            left = (left - left.mean(axis=0)) * np.hanning(len(left))[:, None]
            power += (np.abs(np.fft.rfft(left, size, axis=0)) ** 2).sum(axis=1)
        # Between two bins of the run's own length, and above a few periods.
        width = 2 * size // most
        power[: _PERIODS * size // most] = 0.0
        peak = int(np.argmax(power))
        near = float(power[max(0, peak - width) : peak + width + 1].sum())
        return 2.0 * np.pi * peak / (size * interval) if near > _TONE * float(power.sum()) > 0.0 else 0.0

    def sizes(self, constants: Array) -> Array:
        """By how much constants may change: tolerances, and the numbers themselves."""
        numbers = np.abs(constants[len(self.model.nominal) :])
        return np.concatenate([np.maximum(self.model.tolerance, 1e-12), np.where(numbers > 0, numbers, 1e-9)])

    def deviations(self, constants: Array, starts: Sequence[Array]) -> Array:
        """Of parameters and start states from the study's, over tolerances and spreads."""
        count = len(self.model.nominal)
        away = [(constants[:count] - self.model.nominal) / self.sizes(constants)[:count]]
        away += [(own - one[3]) / self.scale for own, one in zip(starts, self.runs.data, strict=True)]
        return np.concatenate(away)

    def bounds(self, residual: Array, constants: Array) -> tuple[float, Array, Array]:
        """How a fit weighs residuals against tolerances.

        Returns: factor of the residuals, see `_weight`; derivatives of the deviations of parameters and start
            states by all that is fitted, over their sizes; these deviations.
        """
        deviations = self.deviations(constants, self.starts)
        parameters, count = len(self.model.nominal), len(constants)
        width = count + len(deviations) - parameters
        bounded = np.r_[np.arange(parameters), np.arange(count, width)]
        return _weight(residual, correlation_length(residual)), np.eye(width)[bounded], deviations

    def sensitivity(
        self, constants: Array, starts: Sequence[Array] | None = None, sizes: Array | None = None,
        fixed: bool = False, exact: bool = False, known: Array | None = None,
    ) -> Array:  # fmt: skip
        """Derivatives of the residual, shape (values, constants + runs * states), per size of each.

        Args:
            exact: by differences of simulations, which see every corner of a law, not by Jacobians.
            known: earlier derivatives; where differences are taken, only those by laws' numbers are renewed.
        """
        begin = self.starts if starts is None else list(starts)
        sizes = self.sizes(constants) if sizes is None else sizes
        nx, nc = len(self.scale), 0 if fixed else len(constants)
        if self.model.filters and not exact:
            return self._along(constants, begin, sizes, nc)
        base = [self.left(k, begin[k], constants) for k in range(len(begin))]
        ends = np.cumsum([0, *map(len, base)])
        found = np.zeros((ends[-1], nc + nx * len(begin))) if known is None else known.copy()
        renewed = range(nc + nx) if known is None else range(len(self.model.nominal), nc)
        for j in renewed:
            if j < nc and j in self.still:
                continue
            moved, shift = constants.copy(), np.zeros(nx)
            if j < nc:
                step = _STEP * max(1.0, abs(constants[j] / sizes[j]))
                moved[j] += step * sizes[j]
            else:
                step = _STEP
                shift[j - nc] = step * self.scale[j - nc]
            for k in range(len(begin)):
                at = j if j < nc else nc + k * nx + j - nc
                found[ends[k] : ends[k + 1], at] = (self.left(k, begin[k] + shift, moved) - base[k]) / step
        return found

    def _along(self, constants: Array, begin: Sequence[Array], sizes: Array, nc: int) -> Array:
        """The same by the system's Jacobians along the runs."""
        nx, first = len(self.scale), len(self.scale) + self.hidden
        tiny = np.concatenate([self.scale, self.runs.hidden_scale(self.laws), sizes])
        parts = []
        for k, (ext, held, _) in enumerate(self.data):
            own = self.runs.hidden(k, self.laws, begin[k], constants)
            z = np.concatenate([begin[k], own, constants])
            made = sensitive(self.model, ext, held, z, tiny, self.runs.sub_of(self.laws), self.laws)
            part = np.zeros((int(self.masks[k].sum()), nc + nx * len(begin)))
            with np.errstate(over="ignore"):  # where a simulation runs away
                made = (made / self.model.noise[:, None])[self.settled :][self.masks[k]]
                part[:, :nc] = made[:, first : first + nc] * sizes[:nc]
                part[:, nc + k * nx : nc + (k + 1) * nx] = made[:, :nx] * self.scale
            parts.append(part)
        # Squares must stay finite.
        return np.clip(np.nan_to_num(np.vstack(parts), posinf=0.0, neginf=0.0), -_STEEPEST, _STEEPEST)


def polished(
    runs: Runs, laws: Sequence[Inserted], constants: Array, starts: Sequence[Array] | None = None, *,
    trials: int = 12, fixed: bool = False, samples: int | None = None, exact: bool = False,
) -> Polished:  # fmt: skip
    """Fit parameters, the laws' numbers and the start states of all runs to the logs.

    Args:
        constants: where the fit begins: parameters, then numbers. starts: start states of each run.
        trials: steps of the fit. fixed: whether the constants stay, and start states alone are fitted.
        samples: of each run, from its begin, that the fit looks at; None: all.
        exact: see `Replays.sensitivity`.
    """
    replays = Replays(runs, laws, samples, starts)
    model, size = runs.model, replays.sizes(constants)
    nx, np_, nc = len(model.states), len(model.nominal), 0 if fixed else len(constants)
    scales = np.concatenate([size[:nc], *([replays.scale] * len(replays.starts))])
    begin = np.concatenate([constants[:nc], *replays.starts]) / scales
    free = np.concatenate([np.arange(0 if fixed else np_), np.arange(nc, len(begin))])
    limits = np.full(len(begin), -np.inf), np.full(len(begin), np.inf)
    if not fixed:
        limits[0][:np_], limits[1][:np_] = model.least / size[:np_], model.most / size[:np_]
    now = replays.residual(constants)

    def apart(theta: Array) -> tuple[Array, list[Array]]:
        whole = constants if fixed else theta[:nc] * scales[:nc]
        return whole, [theta[nc + k * nx : nc + (k + 1) * nx] * replays.scale for k in range(len(runs.data))]

    # What is missing is no white noise: in the end, the residual's size and its length in time weigh logs
    # against tolerances. At first the logs count more, so that the fit is free to move.
    for length in (1.0, None):
        weight = _weight(now, correlation_length(now) if length is None else length)

        def function(theta: Array, weight: float = weight) -> Array:
            away = replays.deviations(*apart(theta))[np_ if fixed else 0 :]
            return np.concatenate([weight * replays.residual(*apart(theta)), away])

        known: list[Array] = []

        def jacobian(theta: Array, weight: float = weight, known: list[Array] = known) -> Array:
            bounds = np.eye(len(theta))[free]
            # Differences cost a simulation each. Parameters stay within tolerances, laws may move far.
            before = known[-1] if known and laws and not exact else None
            known[:] = [replays.sensitivity(*apart(theta), size, fixed, exact, before)]
            return np.vstack([weight * known[0], bounds])

        fit = partial(
            least_squares, function, jac=jacobian, max_nfev=trials, xtol=1e-5, ftol=1e-4, x_scale="jac"
        )
        with np.errstate(all="ignore"):  # where all that is tried runs away, or changes nothing
            best = fit(begin)
            inside = np.clip(best.x, *limits)
            if not np.array_equal(inside, best.x):
                # Few fits leave what the FMU allows; without bounds, the others take fewer steps.
                best = fit(np.clip(begin, *limits), bounds=limits)
        now, begin = best.fun[: len(now)] / weight, best.x
        if fixed or weight**2 >= 1.0 / 1.5:
            break
    covariance = _covariance(best.jac, size[:nc])
    found, own = apart(best.x)
    if samples is not None:
        now = Replays(runs, laws, starts=own).residual(found)
    strain = float((replays.deviations(found, own)[:np_] ** 2).sum())
    remains, length = float(np.sqrt(np.mean(now**2))), correlation_length(now)
    return Polished(found, covariance, own, remains, len(now), length, strain)


def _weight(residual: Array, length: float) -> float:
    """Factor of residuals, beside tolerances, by the residual's size and its length in time.

    What is missing is no white noise.
    """
    return float(1.0 / np.sqrt(max(1.0, float(np.mean(residual**2)) * length)))


def _covariance(jacobian: Array, size: Array) -> Array:
    """Of the first numbers, in units of their size; infinite where the derivatives are beyond all bounds."""
    with np.errstate(over="ignore", invalid="ignore"):
        try:
            unit = np.linalg.pinv(jacobian.T @ jacobian, rcond=1e-14)[: len(size), : len(size)]
        except np.linalg.LinAlgError:
            unit = np.diag(np.full(len(size), np.inf))
        return np.nan_to_num(unit * np.outer(size, size))


def correlation_length(left: Array) -> float:
    """Integrated correlation time of a residual, in samples, up to its first change of sign."""
    centred = left - left.mean()
    count = min(len(left), 1 << 16)
    power = np.abs(np.fft.rfft(centred[:count], 2 * count)) ** 2
    correlation = np.fft.irfft(power)[: count // 2]
    if not correlation[0] > 0.0:
        return 1.0
    correlation = correlation / correlation[0]
    below = np.flatnonzero(correlation <= 0.0)
    return float(max(1.0, 2.0 * correlation[: below[0] if len(below) else None].sum() - 1.0))
