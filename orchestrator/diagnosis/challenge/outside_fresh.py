"""More kinds of effects outside the catalogue, made without a look at what diagnoses.

Nothing that weighs candidates may import this module, nor be fitted to what it holds: see `outside` for those
that were known when the diagnosis was made.
"""

from __future__ import annotations

import numpy as np

from .hidden import Hidden, between, signed

__all__ = ["FRESH"]


def _brake(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {
        "brake": size * between(rng, 0.5, 1.8),
        "brake_pitch": between(rng, 1e-3, 5e-3),
        "brake_phase": 2.0 * np.pi * rng.random(),
    }


def _loop(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"loop": min(size, 1.2) * between(rng, 6e-4, 1.5e-3)}


def _chuck(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"chuck": size * between(rng, 3e-5, 1.2e-4), "chuck_force": between(rng, 4.0, 15.0)}


def _hammer(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {
        "hammer": size * between(rng, 5e-6, 2e-5),
        "hammer_omega": 2.0 * np.pi * between(rng, 15.0, 50.0),
        "hammer_force": between(rng, 10.0, 40.0),
    }


def _tribo(rng: np.random.Generator, size: float) -> dict[str, float]:
    # At 20 mm/s it comes to some newtons.
    time = between(rng, 0.05, 0.3)
    return {"tribo": size * signed(rng) * between(rng, 0.5, 1.8) / (0.02 * time), "tribo_time": time}


def _preload(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"preload": min(size, 1.2) * between(rng, 0.025, 0.09), "preload_force": between(rng, 8.0, 30.0)}


def _pulse(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"pulse": size * signed(rng) * between(rng, 2.0, 7.0), "pulse_time": between(rng, 5e-3, 2.5e-2)}


def _ratchet(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"ratchet": size * between(rng, 3.0, 9.0), "ratchet_pitch": between(rng, 8e-5, 3e-4)}


def _ejector(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"ejector": size * between(rng, 2.0, 7.0), "ejector_after": between(rng, 1.5e-2, 7e-2)}


def _worked(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"worked": size * between(rng, 0.06, 0.25), "worked_time": between(rng, 0.3, 2.0)}


def _slots(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"slot": size * between(rng, 1.5e-3, 4.5e-3)}


def _standby(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"standby": size * between(rng, 1.5e-3, 6e-3), "standby_every": float(rng.integers(3, 11))}


def _box(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"box": size * between(rng, 1.0, 3.5), "box_edge": between(rng, 2e-3, 4.5e-3)}


def _smoothed(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"smoothed": size * between(rng, 8e-4, 3e-3)}


def _bound(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"lead_bound": between(rng, 0.5, 1.6) / max(size, 0.02) ** 0.7}


def _debounce(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"debounce": float(round(size * between(rng, 6.0, 24.0)))}


_ALL = (
    Hidden("robot.warped-brake", _brake),
    Hidden("robot.slow-loop", _loop),
    Hidden("structure.loose-chuck", _chuck),
    Hidden("structure.air-hammer", _hammer),
    Hidden("sensor.rubbed-cable", _tribo),
    Hidden("sensor.lost-preload", _preload),
    Hidden("sensor.switch-pulse", _pulse),
    Hidden("contact.ratchet", _ratchet),
    Hidden("contact.ejector", _ejector),
    Hidden("contact.worked-rubber", _worked),
    Hidden("link.time-slots", _slots),
    Hidden("link.standby-sender", _standby),
    Hidden("dynamics.keep-in-box", _box),
    Hidden("dynamics.smoothed-force", _smoothed),
    Hidden("controller.bounded-lead", _bound),
    Hidden("controller.debounce", _debounce),
)

FRESH = {one.id: one for one in _ALL}
