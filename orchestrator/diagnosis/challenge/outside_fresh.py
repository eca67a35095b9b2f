"""More kinds of effects outside the catalogue, made without a look at what diagnoses.

Nothing that weighs candidates may import this module, nor be fitted to what it holds: see `outside` for those
that were known when the diagnosis was made.
"""

from __future__ import annotations

import numpy as np

from .hidden import Hidden, between

__all__ = ["FRESH"]


def _sag(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"sag": min(size, 1.2) * between(rng, 0.1, 0.4), "sag_time": between(rng, 0.03, 0.2)}


def _stop(rng: np.random.Generator, size: float) -> dict[str, float]:
    # As set by someone who took the frames to stand further out.
    return {"stop": size * between(rng, 0.01, 0.04), "stop_at": rng.uniform(4.4e-3, 5.1e-3)}


def _unscrew(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"unscrew": size * between(rng, 4e-7, 1.6e-6)}


def _lift(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {
        "lift": size * between(rng, 2e-5, 8e-5),
        "lift_rate": between(rng, 2e-3, 1e-2),
        "lift_time": between(rng, 3e-3, 1.5e-2),
    }


def _calm(rng: np.random.Generator, size: float) -> dict[str, float]:
    # Made for scales, whose display is to stand still.
    lag = size * between(rng, 1.5, 6.0)  # where hardly anything moves [ticks]
    return {"calm": lag / (1.0 + lag), "calm_step": between(rng, 4.0, 15.0)}


def _ring(rng: np.random.Generator, size: float) -> dict[str, float]:
    # On a rubber washer.
    return {
        "ring": size * between(rng, 0.22, 0.65),
        "ring_omega": 2.0 * np.pi * between(rng, 35.0, 100.0),
        "ring_xi": between(rng, 0.03, 0.12),
    }


def _sampling(rng: np.random.Generator, size: float) -> dict[str, float]:
    # A thread reads it that others hold up.
    return {"sampling": size * between(rng, 6e-4, 2.4e-3)}


def _foil(rng: np.random.Generator, size: float) -> dict[str, float]:
    at = between(rng, 4e-4, 1.5e-3)
    return {
        "foil": size * between(rng, 5.0, 18.0),
        "foil_at": at,
        "foil_stretch": at * rng.uniform(0.6, 1.1),
    }


def _thick(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"thick": size * between(rng, 0.08, 0.3)}


def _hook(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"hook": size * between(rng, 1.5, 6.0), "hook_reach": between(rng, 1e-4, 5e-4)}


def _bridge(rng: np.random.Generator, size: float) -> dict[str, float]:
    # What it errs by grows with the square of the time.
    return {
        "bridge": float(np.sqrt(size)) * between(rng, 6e-3, 1.4e-2),
        "bridge_rate": between(rng, 4.0, 12.0),
    }


def _change(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"change": size * between(rng, 1.5e-5, 5e-5)}


def _seek(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {
        "seek": size * between(rng, 1.5, 5.0),
        "seek_force": between(rng, 8.0, 25.0),
        "seek_time": between(rng, 0.05, 0.4),
    }


def _rubbed(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"rubbed": size * between(rng, 0.03, 0.12), "rubbed_force": between(rng, 0.3, 1.5)}


def _passive(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"passive": min(size, 1.2) * between(rng, 0.1, 0.4), "passive_from": rng.uniform(0.1, 0.5)}


def _helped(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"helped": size * between(rng, 0.8, 3.0), "helped_rate": between(rng, 1e-3, 5e-3)}


_ALL = (
    Hidden("robot.sagging-supply", _sag),
    Hidden("robot.soft-stop", _stop),
    Hidden("structure.unscrewing", _unscrew),
    Hidden("structure.floating-slide", _lift),
    Hidden("sensor.adaptive-filter", _calm),
    Hidden("sensor.swinging-element", _ring),
    Hidden("sensor.sampling-jitter", _sampling, chance=True),
    Hidden("contact.foil", _foil),
    Hidden("contact.stiffening-paste", _thick),
    Hidden("contact.hook-tape", _hook),
    Hidden("link.dead-reckoning", _bridge, chance=True),
    Hidden("link.send-on-change", _change),
    Hidden("dynamics.post-contact-thrust", _seek),
    Hidden("dynamics.rubbing-hinge", _rubbed),
    Hidden("controller.passivity", _passive),
    Hidden("controller.friction-compensation", _helped),
)

FRESH = {one.id: one for one in _ALL}
