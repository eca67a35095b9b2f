"""How much the logs of a case could tell of its hidden effects at best, from the rig that made them."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from .draw import NOISE, ROUGHNESS, RUNS, Case, run_series, tolerances
from .knobs import CALIBRATED
from .rig import FORCE_RESOLUTION, POSITION_RESOLUTION, TICK, Array, drive

__all__ = ["visibility"]

_FORCE_DIGITS, _STIFFNESS_DIGITS, _VELOCITY_DIGITS = 1e-4, 0.1, 1e-9
# Samples of which a spectrum is taken, and frequencies over which it is averaged.
_WINDOW, _BAND = 64, 8
_STEP = 0.1  # of a tolerance or a usual size, for differences
_ROUNDS = 5


def visibility(
    case: Case, logs: list[Array], without: Mapping[str, float] | None = None, chance: bool = False
) -> float:
    """Log evidence [nats] for the hidden effects over none, for one who knew their exact size.

    Each block is driven by the logged inputs with and without the effects, with the same chance. With d the
    difference of what is measured over its noise, and z what calibrated numbers may stray over their
    tolerances, and roughness over its usual size, the evidence is half the least d'd + z'z: what either may
    explain does not count. Of an effect that draws anew at each sample nobody knows the draws, but the
    spectrum at best: with m the power of what is left of d over that of the noise, it tells m - ln(1 + m) at
    each frequency (Whittle, J. R. Stat. Soc. B 15, 1953).

    Args:
        logs: of the case, by `RUNS`; the training runs are used.
        without: knobs of the rig to compare with; by default those without any hidden effect.
        chance: whether the effects draw.
    """
    aim = _measured(case, logs, case.values)
    rest = case.plain if without is None else without
    sigma = tolerances(case.lab)
    usual = {knob: sigma[name] for name, knob in CALIBRATED.items() if sigma[name] > 0.0} | ROUGHNESS

    def strayed(z: Array) -> Array:
        moves = zip(usual.items(), z.tolist(), strict=True)
        moved = {knob: rest[knob] + size * by for (knob, size), by in moves}
        return np.concatenate(_measured(case, logs, {**rest, **moved}))

    target, here = np.concatenate(aim), np.zeros(len(usual))
    plain = strayed(here)
    steps = _STEP * np.eye(len(usual))
    jacobian = np.stack([(strayed(step) - plain) / _STEP for step in steps], axis=1)
    inner = np.eye(len(usual)) + jacobian.T @ jacobian
    best, left = math.inf, target - plain
    difference = left
    for _ in range(_ROUNDS):  # Gauss-Newton, derivatives kept
        cost = 0.5 * float(difference @ difference + here @ here)
        if not cost < best:
            break
        best, left = cost, difference
        here = here + np.linalg.solve(inner, jacobian.T @ difference - here)
        difference = target - strayed(here)
    if not chance:
        return best
    return sum(map(_told_by_spectrum, np.split(left, np.cumsum([len(one) for one in aim])[:-1])))


def _told_by_spectrum(difference: Array) -> float:
    """See `visibility`; the power is taken over windows and bands."""
    windows = difference[: len(difference) // _WINDOW * _WINDOW].reshape(-1, _WINDOW)
    power = np.abs(np.fft.rfft(windows, axis=1)[:, : _WINDOW // 2]) ** 2 / _WINDOW
    m = power.reshape(len(windows), -1, _BAND).mean(axis=2)
    return float(_BAND * np.sum(m - np.log1p(m)))


def _measured(case: Case, logs: list[Array], values: Mapping[str, float]) -> list[Array]:
    train = [index for index, plan in enumerate(RUNS) if plan.role == "train"]
    return [part for index in train for part in _blocks(case, index, logs[index], values)]


def _blocks(case: Case, index: int, logged: Array, values: Mapping[str, float]) -> list[Array]:
    """What the blocks give of a run, over the noise of each channel."""
    plan = RUNS[index]
    out = drive(case.lab, values, plan.mass, plan.speed, logged, run_series(case, index, values))
    n = out.shape[1]
    force = np.hypot(NOISE[1], FORCE_RESOLUTION / np.sqrt(12.0))
    velocity = np.hypot(_VELOCITY_DIGITS / np.sqrt(6.0), TICK / plan.mass * _FORCE_DIGITS / np.sqrt(12.0))
    return [
        out[1, : n - 1] / velocity,
        out[2] / np.hypot(NOISE[0], POSITION_RESOLUTION / np.sqrt(12.0)),
        out[3] / force,
        # Rounded inputs pass through the controller's differences: not all of its digits count.
        out[4] / np.hypot(3.0 * _FORCE_DIGITS, 0.02 * FORCE_RESOLUTION),
        out[5] / np.hypot(3.0 * _STIFFNESS_DIGITS, 0.02 * FORCE_RESOLUTION / 5e-4),
    ]
