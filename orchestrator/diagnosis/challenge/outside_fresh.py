"""More kinds of effects outside the catalogue, made without a look at what diagnoses.

Nothing that weighs candidates may import this module, nor be fitted to what it holds: see `outside` for those
that were known when the diagnosis was made.
"""

from __future__ import annotations

import numpy as np

from .hidden import Hidden, between, signed

__all__ = ["FRESH"]


def _leak(rng: np.random.Generator, size: float) -> dict[str, float]:
    # A piezoelectric sensor holds a static force for some seconds alone.
    return {"leak": size * between(rng, 0.03, 0.12)}


def _tare(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"tare": size * between(rng, 0.5, 1.0), "tare_force": between(rng, 3.0, 8.0)}


def _presliding(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"dahl": size * between(rng, 2.0, 6.0), "dahl_length": between(rng, 3e-5, 3e-4)}


def _integral(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"integral": size * between(rng, 1.5, 6.0)}


def _one_sided(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {
        "one_sided": size * signed(rng) * between(rng, 0.1, 0.3),
        "one_sided_rate": between(rng, 5e-4, 3e-3),
    }


def _slip(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"slip": size * between(rng, 1.5e-6, 6e-6), "slip_force": between(rng, 8.0, 25.0)}


def _sway(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {
        "sway": size / between(rng, 800.0, 2500.0),
        "sway_arm": between(rng, 30.0, 100.0),
        "sway_omega": 2.0 * np.pi * between(rng, 5.0, 14.0),
        "sway_xi": between(rng, 0.02, 0.08),
    }


def _plate(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {
        "plate": max(size, 0.02) * between(rng, 0.8, 3.0),
        "plate_gap": float(np.sqrt(size)) * between(rng, 1e-4, 5e-4),
        "plate_omega": 2.0 * np.pi * between(rng, 4.0, 12.0),
    }


def _film(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"film": size * between(rng, 50.0, 180.0), "film_gap": between(rng, 5e-5, 2.5e-4)}


def _reordering(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"reorder": size * between(rng, 0.03, 0.12), "reorder_ticks": float(rng.integers(2, 7))}


def _clock_resets(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"reset": size * between(rng, 1e-3, 4e-3), "reset_period": between(rng, 0.15, 0.6)}


def _fixed_point(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"count": size * between(rng, 1.5e-5, 6e-5)}


def _forget(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"forget": size * between(rng, 0.1, 0.4)}


def _stale(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"stale": size * between(rng, 0.3, 1.0)}


def _fuel(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"fuel": size * between(rng, 0.01, 0.05)}


def _dead_band(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"thrust": size * between(rng, 0.3, 1.5), "thrust_speed": between(rng, 7e-3, 1.3e-2)}


_ALL = (
    Hidden("sensor.charge-leak", _leak),
    Hidden("sensor.tare", _tare),
    Hidden("robot.presliding", _presliding),
    Hidden("robot.integral-action", _integral),
    Hidden("robot.one-sided-damping", _one_sided),
    Hidden("structure.slip", _slip),
    Hidden("structure.base-sway", _sway),
    Hidden("contact.loose-plate", _plate),
    Hidden("contact.squeeze-film", _film),
    Hidden("link.reordering", _reordering, chance=True),
    Hidden("link.clock-resets", _clock_resets),
    Hidden("controller.fixed-point", _fixed_point),
    Hidden("controller.forgetting", _forget),
    Hidden("controller.stale-position", _stale),
    Hidden("dynamics.fuel", _fuel),
    Hidden("dynamics.dead-band-thrusters", _dead_band),
)

FRESH = {one.id: one for one in _ALL}
