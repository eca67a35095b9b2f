"""Recorded vectors and poses of a run in six degrees of freedom."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from ..base.arrays import Array
from .frames import Motion, attached

if TYPE_CHECKING:
    from ..results.recorders import Results

from .options import POSE


def stacked(results: Results, name: str, size: int = 3) -> Array:
    """A recorded array signal, shape (n, size)."""
    return np.column_stack([results[f"{name}[{index}]"] for index in range(1, size + 1)])


def pose(results: Results, instance: str, suffix: str = "") -> Motion:
    """Recorded pose and twist of an instance, n rows."""
    return Motion.of(*(stacked(results, f"{instance}.{name}{suffix}", size) for name, size in POSE.items()))


def tip_velocity(results: Results, instance: str, tip: Array) -> Array:
    """Velocity of the rod tip in O_t, shape (n, 3) [m/s]; `tip` is its place in O_u, shape (3,) [m]."""
    return attached(pose(results, instance), tip, Rotation.identity()).velocity
