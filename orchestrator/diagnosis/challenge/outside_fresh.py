"""More kinds of effects outside the catalogue, made without a look at what diagnoses.

Nothing that weighs candidates may import this module, nor be fitted to what it holds: see `outside` for those
that were known when the diagnosis was made.
"""

from __future__ import annotations

import numpy as np

from .hidden import Hidden, between, signed

__all__ = ["FRESH"]


def _own_cycle(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"cycle": size * between(rng, 1.6e-3, 4.5e-3)}


def _fringes(rng: np.random.Generator, size: float) -> dict[str, float]:
    error = between(rng, 0.8, 2.5)
    return {"fringe": size * error, "fringe_span": error * between(rng, 14.0, 35.0)}


def _zero(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"zero": size * between(rng, 0.5, 1.5)}


def _pole(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {
        "pole": min(size, 1.2) * between(rng, 0.15, 0.5),
        "pole_at": rng.uniform(-3.5e-3, 3.5e-3),
        "pole_width": between(rng, 2e-4, 8e-4),
    }


def _lost(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"lost": size * between(rng, 6e-6, 2.5e-5), "lost_rate": between(rng, 2.5, 8.0)}


def _gear(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"gear": size * between(rng, 0.012, 0.045), "gear_rate": between(rng, 1e-3, 4e-3)}


def _taut(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"taut": size * signed(rng) * between(rng, 250.0, 900.0), "taut_from": rng.uniform(0.0, 2.5e-3)}


def _thread(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {
        "thread": size * between(rng, 1e-5, 4e-5),
        "thread_pitch": between(rng, 3e-4, 1e-3),
        "thread_phase": 2.0 * np.pi * rng.random(),
    }


def _magnet(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"magnet": size * between(rng, 1.5, 6.0), "magnet_gap": between(rng, 2e-4, 1e-3)}


def _latch(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"latch": size * between(rng, 2.5, 8.0), "latch_depth": between(rng, 1.5e-4, 4e-4)}


def _scrape(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"scrape": size * between(rng, 0.016, 0.06), "scrape_time": between(rng, 1e-3, 6e-3)}


def _queue(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {
        "queue": size * between(rng, 6e-4, 2.5e-3),
        "queue_rate": between(rng, 2.0, 8.0),
        "queue_drain": between(rng, 0.02, 0.15),
    }


def _busy(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"busy": size * between(rng, 3e-4, 1.2e-3), "busy_force": between(rng, 5.0, 25.0)}


def _loose(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {
        "loose": size * between(rng, 0.02, 0.08),
        "loose_gap": between(rng, 2e-4, 1.5e-3),
        "loose_omega": 2.0 * np.pi * between(rng, 8.0, 25.0),
    }


def _crew(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"crew": size * between(rng, 0.8, 3.0), "crew_time": between(rng, 0.02, 0.15)}


def _notch(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {
        "notch": min(size, 1.2) * between(rng, 0.3, 0.8),
        "notch_omega": 2.0 * np.pi * between(rng, 25.0, 65.0),
        "notch_width": between(rng, 0.3, 1.0),
    }


_ALL = (
    Hidden("sensor.own-cycle", _own_cycle),
    Hidden("sensor.interpolation", _fringes),
    Hidden("sensor.zero-shift", _zero, chance=True),
    Hidden("robot.weak-pole", _pole),
    Hidden("robot.lost-counts", _lost, chance=True),
    Hidden("robot.loaded-gear", _gear),
    Hidden("structure.taut-cable", _taut),
    Hidden("structure.uneven-thread", _thread),
    Hidden("contact.magnet", _magnet),
    Hidden("contact.latch", _latch),
    Hidden("contact.scraping", _scrape, chance=True),
    Hidden("link.queue", _queue, chance=True),
    Hidden("link.busy-in-contact", _busy),
    Hidden("dynamics.loose-load", _loose),
    Hidden("dynamics.crew", _crew, chance=True),
    Hidden("controller.notch", _notch),
)

FRESH = {one.id: one for one in _ALL}
