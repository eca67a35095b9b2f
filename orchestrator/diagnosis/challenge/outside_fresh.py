"""More kinds of effects outside the catalogue, made without a look at what diagnoses.

Nothing that weighs candidates may import this module, nor be fitted to what it holds: see `outside` for those
that were known when the diagnosis was made.
"""

from __future__ import annotations

import numpy as np

from .hidden import Hidden, between, signed

__all__ = ["FRESH"]


def _pickup(rng: np.random.Generator, size: float) -> dict[str, float]:
    # The motor's magnets pass an unshielded cable.
    return {
        "pickup": size * between(rng, 0.7, 2.5),
        "pickup_pitch": between(rng, 1.5e-3, 6e-3),
        "pickup_phase": 2.0 * np.pi * rng.random(),
    }


def _ripple(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"ripple": size * between(rng, 0.025, 0.1), "ripple_omega": 2.0 * np.pi * between(rng, 5.0, 25.0)}


def _bushing(rng: np.random.Generator, size: float) -> dict[str, float]:
    # It guides the rod before the sensor, which so feels its friction in free flight, too.
    return {"bushing": size * between(rng, 0.4, 1.5), "bushing_rate": between(rng, 1e-3, 6e-3)}


def _gain_switching(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {
        "soft_gain": min(size, 1.2) * between(rng, 0.2, 0.6),
        "soft_gain_rate": between(rng, 3e-3, 1.2e-2),
    }


def _warming(rng: np.random.Generator, size: float) -> dict[str, float]:
    # Grease is stiff in a cold gear.
    return {"cold": size * between(rng, 0.1, 0.4), "cold_time": between(rng, 0.25, 1.2)}


def _joint(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"joint": size * between(rng, 6e-7, 2e-6), "joint_force": between(rng, 8.0, 30.0)}


def _floor(rng: np.random.Generator, size: float) -> dict[str, float]:
    # As of a compressor: its speed, not a whole fraction of the mains'.
    return {"floor": size * between(rng, 1e-5, 4e-5), "floor_omega": 2.0 * np.pi * between(rng, 9.0, 30.0)}


def _valve(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"valve": size * between(rng, 1e4, 4e4)}


def _seat(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"seat": size * between(rng, 2e-5, 7e-5), "seat_force": between(rng, 15.0, 40.0)}


def _corruption(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"corrupt": size * between(rng, 4e-5, 1.6e-4), "corrupt_rate": between(rng, 6.0, 30.0)}


def _route(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"route": size * signed(rng) * between(rng, 2e-4, 8e-4)}


def _ignored(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"ignored": size * between(rng, 1.5, 5.0)}


def _plume(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"plume": size * between(rng, 3.0, 12.0), "plume_reach": between(rng, 8e-4, 4e-3)}


def _timer(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"timer": size * between(rng, 1.2e-4, 4.5e-4)}


def _ramp(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"ramp": size * between(rng, 3e-3, 1e-2)}


def _gate(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"gate": min(0.8 * size, 1.0), "gate_step": between(rng, 1.2, 2.5)}


_ALL = (
    Hidden("sensor.motor-pickup", _pickup),
    Hidden("sensor.excitation-ripple", _ripple),
    Hidden("sensor.bushing", _bushing),
    Hidden("robot.gain-switching", _gain_switching),
    Hidden("robot.warming-up", _warming),
    Hidden("structure.bolted-joint", _joint),
    Hidden("structure.floor-vibration", _floor),
    Hidden("contact.one-way-damper", _valve),
    Hidden("contact.seating", _seat),
    Hidden("link.corruption", _corruption, chance=True),
    Hidden("link.changed-route", _route),
    Hidden("dynamics.ignored-force", _ignored),
    Hidden("dynamics.plume", _plume),
    Hidden("dynamics.coarse-timer", _timer),
    Hidden("controller.ramp-in", _ramp),
    Hidden("controller.outlier-gate", _gate),
)

FRESH = {one.id: one for one in _ALL}
