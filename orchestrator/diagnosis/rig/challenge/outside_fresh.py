"""Further kinds of effects outside the catalogue, made without knowledge of the diagnosis.

Nothing that weighs candidates may import this module, nor be fitted to what it holds: see `outside` for those
that were known when the diagnosis was made.
"""

from __future__ import annotations

import numpy as np

from .hidden import Hidden, between, signed

__all__ = ["FRESH"]


def _forward(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"forward": size * between(rng, 0.15, 0.5)}


def _idle(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"idle": size * between(rng, 0.9, 3.2)}


def _hunt(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"hunt": size * between(rng, 4e-6, 1.5e-5), "hunt_omega": 2.0 * np.pi * between(rng, 1.2, 5.0)}


def _yaw(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"yaw": size * signed(rng) * between(rng, 8e-6, 3e-5), "yaw_length": between(rng, 5e-5, 3e-4)}


def _ghost(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"ghost": size * signed(rng) * between(rng, 120.0, 450.0)}


def _buffer(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"buffer": size * between(rng, 7e-4, 2.5e-3), "buffer_period": between(rng, 0.08, 0.6)}


def _buzz(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"buzz": size * between(rng, 0.7, 2.5)}


def _clay(rng: np.random.Generator, size: float) -> dict[str, float]:
    # Mounted again for each run.
    return {"clay": size * between(rng, 1.5e-5, 6e-5), "clay_impulse": between(rng, 3.0, 15.0)}


def _rope(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"rope": size * between(rng, 2.0, 7.0), "rope_length": between(rng, 5e-5, 3e-4)}


def _cup(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"cup": size * between(rng, 2.0, 7.0), "cup_reach": between(rng, 8e-5, 4e-4)}


def _tracker(rng: np.random.Generator, size: float) -> dict[str, float]:
    # What it errs by where all speeds up grows with the square of its memory [ticks].
    memory = float(np.sqrt(size)) * between(rng, 2.5, 5.0)
    return {"tracker": memory / (1.0 + memory)}


def _wander(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"wander": size * between(rng, 2e-4, 8e-4), "wander_time": between(rng, 0.06, 0.5)}


def _rezero(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"rezero": size * between(rng, 0.09, 0.35)}


def _corrected(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"corrected": size * between(rng, 20.0, 80.0)}


def _dull(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"dull": min(size, 1.2) * between(rng, 0.4, 0.8)}


def _release(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"release": float(round(size * between(rng, 5.0, 18.0)))}


_ALL = (
    Hidden("robot.feed-forward", _forward),
    Hidden("robot.idle-switches", _idle),
    Hidden("structure.hunting-axis", _hunt),
    Hidden("structure.yawing-slide", _yaw),
    Hidden("sensor.ghost-channel", _ghost),
    Hidden("sensor.filling-buffer", _buffer),
    Hidden("sensor.drive-noise", _buzz, chance=True),
    Hidden("contact.clay", _clay),
    Hidden("contact.wire-rope", _rope),
    Hidden("contact.suction-cup", _cup),
    Hidden("link.tracking-filter", _tracker),
    Hidden("link.wandering-delay", _wander, chance=True),
    Hidden("dynamics.force-rezeroed", _rezero),
    Hidden("dynamics.drift-correction", _corrected),
    Hidden("controller.dull-derivative", _dull),
    Hidden("controller.late-release", _release),
)

FRESH = {one.id: one for one in _ALL}
