"""How much the logs of a case could tell of its hidden effects at best, from the rig that made them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .draw import NOISE, RUNS, Case, run_series, tolerances
from .knobs import CALIBRATED
from .rig import FORCE_RESOLUTION, POSITION_RESOLUTION, TICK, Array, drive

__all__ = ["visibility"]

_FORCE_DIGITS, _STIFFNESS_DIGITS, _VELOCITY_DIGITS = 1e-4, 0.1, 1e-9
_STEP = 0.1  # of a tolerance, for differences


def visibility(case: Case, logs: list[Array], without: Mapping[str, float] | None = None) -> float:
    """Log evidence [nats] for the hidden effects over none, for one who knew their exact size.

    Each block is driven by the logged inputs with and without the effects, with the same chance. With d the
    difference of what is measured over its noise, and J its derivatives by calibrated numbers over their
    tolerances, the evidence is d'(I + J J')^-1 d/2: what the calibration may explain does not count.

    Args:
        logs: of the case, by `RUNS`; the training runs are used.
        without: knobs of the rig to compare with; by default those without any hidden effect.
    """
    with_effects = _measured(case, logs, case.values)
    difference = with_effects - _measured(case, logs, case.plain if without is None else without)
    sigma = tolerances(case.lab)
    columns = []
    for name, knob in CALIBRATED.items():
        if sigma[name] > 0.0:
            moved = {**case.values, knob: case.values[knob] + _STEP * sigma[name]}
            columns.append((_measured(case, logs, moved) - with_effects) / _STEP)
    jacobian = np.stack(columns, axis=1)
    explained = jacobian.T @ difference
    inner = np.eye(len(columns)) + jacobian.T @ jacobian
    total = 0.5 * (difference @ difference - explained @ np.linalg.solve(inner, explained))
    return float(max(total, 0.0))


def _measured(case: Case, logs: list[Array], values: Mapping[str, float]) -> Array:
    train = [index for index, plan in enumerate(RUNS) if plan.role == "train"]
    return np.concatenate([_blocks(case, index, logs[index], values) for index in train])


def _blocks(case: Case, index: int, logged: Array, values: Mapping[str, float]) -> Array:
    """What the blocks give of a run, over the noise of each channel."""
    plan = RUNS[index]
    out = drive(case.lab, values, plan.mass, plan.speed, logged, run_series(case, index, values))
    n = out.shape[1]
    force = np.hypot(NOISE[1], FORCE_RESOLUTION / np.sqrt(12.0))
    velocity = np.hypot(_VELOCITY_DIGITS / np.sqrt(6.0), TICK / plan.mass * _FORCE_DIGITS / np.sqrt(12.0))
    parts = [
        out[1, : n - 1] / velocity,
        out[2] / np.hypot(NOISE[0], POSITION_RESOLUTION / np.sqrt(12.0)),
        out[3] / force,
        # Rounded inputs pass through the controller's differences: not all of its digits count.
        out[4] / np.hypot(3.0 * _FORCE_DIGITS, 0.02 * FORCE_RESOLUTION),
        out[5] / np.hypot(3.0 * _STIFFNESS_DIGITS, 0.02 * FORCE_RESOLUTION / 5e-4),
    ]
    return np.concatenate(parts)
