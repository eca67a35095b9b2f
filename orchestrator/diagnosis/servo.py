"""The docking rig's servo in closed form."""

from __future__ import annotations

import math

import numpy as np

from .study import Array

__all__ = ["pulse_response"]


def pulse_response(lag: tuple[float, float, float], tick: float, ticks: int) -> Array:
    """Position of the robot at the ticks after a command of 1 m that holds for a tick, shape (ticks,) [1].

    Args:
        lag: see `Seen`; tick: of the software [s].
    """
    omega, xi, delay = lag
    root = omega * math.sqrt(max(1.0 - xi * xi, 1e-6))
    since = np.maximum(tick * np.arange(ticks + 1) - delay, 0.0)
    held = np.exp(-xi * omega * since) * (np.cos(root * since) + xi * omega / root * np.sin(root * since))
    return -np.diff(held)
