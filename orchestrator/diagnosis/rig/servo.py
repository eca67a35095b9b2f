"""The docking rig's servo in closed form."""

from __future__ import annotations

import cmath

import numpy as np

from .study import Array


def pulse_response(lag: tuple[float, float, float], tick: float, ticks: int) -> Array:
    """Position of the robot at the ticks after a command of 1 m that holds for a tick, shape (ticks,) [1].

    Args:
        lag: see `Seen`; tick: of the software [s].
    """
    omega, xi, delay = lag
    # Both roots of the servo; where they are one, a pair that differs from it by less than shows.
    apart = 1.0 - xi * xi
    root = cmath.sqrt(apart if abs(apart) > 1e-6 else 1e-6)
    first, second = omega * (-xi + 1j * root), omega * (-xi - 1j * root)
    since = np.maximum(tick * np.arange(ticks + 1) - delay, 0.0)
    held = (first * np.exp(second * since) - second * np.exp(first * since)) / (first - second)
    return -np.diff(held.real)
