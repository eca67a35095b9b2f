"""Inputs to try FMUs with: seeded, band-limited, with steps in between."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...fmi import Array, Kind, Variable

_WAVES = 4
# Whole periods over a trajectory: steps resolve the fastest well.
_FASTEST = 5
# Share of a smooth input's size that jumps, once in the middle third.
_JUMP = 0.3


def stimulus(inputs: Sequence[Variable], steps: int, amplitude: float, seed: int) -> Array:
    """Values of inputs per step, shape (steps, inputs).

    Real inputs leave their start value by `amplitude` times the nominal value at most: a sum of sines of up
    to five periods, and one jump. Whole numbers, items and switches change in steps, and only if the
    amplitude is not zero. What is declared as minimum and maximum is kept.

    Args:
        amplitude: over the nominal value; 0: everything stays at its start.
        seed: each input draws from a stream of its own, so that one more input changes no other.
    """
    rows = np.zeros((steps, len(inputs)))
    phase = np.arange(steps) / steps
    for column, variable in enumerate(inputs):
        random = np.random.default_rng([seed, *variable.name.encode()])
        periods = random.uniform(0.5, _FASTEST, _WAVES)
        offsets = random.uniform(0.0, 2.0 * np.pi, _WAVES)
        wave = np.sin(2.0 * np.pi * periods * phase[:, None] + offsets).sum(axis=1) / _WAVES
        # It begins at the start value: a jump there would be the initialisation's, not the steps'.
        wave = (wave - (wave[0] if steps else 0.0)) / 2.0
        jump = steps * random.uniform(0.34, 0.66)
        wave = (1.0 - _JUMP) * wave + _JUMP * random.choice([-1.0, 1.0]) * (np.arange(steps) >= jump)
        rows[:, column] = _values(variable, wave, amplitude)
    return rows


def _values(variable: Variable, wave: Array, amplitude: float) -> Array:
    start = variable.start if isinstance(variable.start, int | float) else 0
    if variable.kind is Kind.BOOLEAN:
        return np.where(wave < 0.0, not start, start) if amplitude else np.full(len(wave), float(start))
    if variable.kind is Kind.ENUMERATION:
        items = sorted(variable.items.values())
        if not amplitude or not items:
            return np.full(len(wave), float(start or (items[0] if items else 0)))
        return np.array(items, float)[(np.abs(wave) * 3 * len(items)).astype(int) % len(items)]
    low = -np.inf if variable.minimum is None else variable.minimum
    high = np.inf if variable.maximum is None else variable.maximum
    if variable.type.startswith("UInt"):
        low = max(low, 0.0)
    if variable.kind is Kind.REAL:
        return np.clip(start + amplitude * variable.nominal * wave, low, high)
    # Small whole numbers fit every width.
    return np.clip(np.round(start + 5.0 * amplitude * wave), low, high)
