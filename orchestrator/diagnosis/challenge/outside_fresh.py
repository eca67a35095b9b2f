"""More kinds of effects outside the catalogue, made without a look at what diagnoses.

Nothing that weighs candidates may import this module, nor be fitted to what it holds: see `outside` for those
that were known when the diagnosis was made.
"""

from __future__ import annotations

import numpy as np

from .hidden import Hidden, between, signed

__all__ = ["FRESH"]


def _shaper(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"shaper": min(size, 1.2) * between(rng, 0.12, 0.4), "shaper_time": between(rng, 1e-2, 3e-2)}


def _guard(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {
        "guard": min(size, 1.2) * between(rng, 0.15, 0.5),
        "guard_force": between(rng, 8.0, 25.0),
        "guard_time": between(rng, 0.02, 0.08),
    }


def _growth(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"growth": size * signed(rng) * between(rng, 8e-5, 3e-4), "growth_time": between(rng, 0.5, 2.5)}


def _hose(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {
        "hose": size * between(rng, 1.0, 3.5),
        "hose_omega": 2.0 * np.pi * between(rng, 2.0, 6.0),
        "hose_xi": between(rng, 0.03, 0.15),
    }


def _ranges(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {
        "range_gain": size * signed(rng) * between(rng, 0.08, 0.25),
        "range_force": between(rng, 15.0, 40.0),
    }


def _bit(rng: np.random.Generator, size: float) -> dict[str, float]:
    weight = float(rng.choice([6.4, 12.8, 25.6]))
    return {
        "bit": size * signed(rng) * between(rng, 0.8, 3.0),
        "bit_weight": weight,
        "bit_at": weight * rng.uniform(0.2, 0.8),  # quiet where no force acts
    }


def _wire(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {
        "wire": size * signed(rng) * between(rng, 1.5, 6.0),
        "wire_rate": between(rng, 3.0, 12.0),
        "wire_time": between(rng, 4e-3, 2e-2),
    }


def _chatter(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {
        "chatter": size * between(rng, 0.015, 0.06),
        "chatter_omega": 2.0 * np.pi * between(rng, 35.0, 120.0),
    }


def _pad(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"pad": size * between(rng, 0.25, 0.9), "pad_time": between(rng, 0.3, 1.2)}


def _brush(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"brush": size * between(rng, 0.8, 3.0), "brush_reach": between(rng, 5e-4, 2e-3)}


def _text(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"text": size * between(rng, 1e-4, 3.5e-4)}


def _increments(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"increments": size * between(rng, 5e-3, 2e-2), "increments_key": between(rng, 0.03, 0.12)}


def _spin(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {
        "spin": size * between(rng, 0.03, 0.12),
        "spin_omega": 2.0 * np.pi * between(rng, 0.2, 1.0),
        "spin_phase": np.pi * rng.random(),
    }


def _stuck(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {
        "stuck": size * signed(rng) * between(rng, 1.2, 4.0),
        "stuck_from": rng.uniform(0.3, 1.5),
        "stuck_time": between(rng, 0.3, 1.0),
    }


def _overrun(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"overrun": min(size, 1.2) * between(rng, 0.1, 0.4)}


def _payload(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"payload": size * between(rng, 0.3, 1.2)}


_ALL = (
    Hidden("robot.input-shaper", _shaper),
    Hidden("robot.collision-guard", _guard),
    Hidden("structure.growth", _growth),
    Hidden("structure.hose", _hose),
    Hidden("sensor.two-ranges", _ranges),
    Hidden("sensor.heavy-bit", _bit),
    Hidden("sensor.loose-wire", _wire, chance=True),
    Hidden("contact.chatter", _chatter),
    Hidden("contact.dented-pad", _pad),
    Hidden("contact.brush", _brush),
    Hidden("link.text", _text),
    Hidden("link.increments", _increments, chance=True),
    Hidden("dynamics.spin", _spin),
    Hidden("dynamics.stuck-valve", _stuck),
    Hidden("controller.overrun", _overrun),
    Hidden("controller.payload", _payload),
)

FRESH = {one.id: one for one in _ALL}
