"""Kinds of effects outside the catalogue of the contact; see `outside`."""

from __future__ import annotations

import numpy as np

from .hidden import Hidden, between

__all__ = ["CONTACT_KINDS"]


def _wall_mode(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {
        "wall_mass": between(rng, 15.0, 50.0) / max(size, 0.02),
        "wall_omega": 2.0 * np.pi * between(rng, 15.0, 45.0),
    }


def _wall_scatter(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"wall_scatter": size * between(rng, 6e-5, 2.5e-4)}


def _plate(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {
        "plate": max(size, 0.02) * between(rng, 0.8, 3.0),
        "plate_gap": float(np.sqrt(size)) * between(rng, 1e-4, 5e-4),
        "plate_omega": 2.0 * np.pi * between(rng, 4.0, 12.0),
    }


def _film(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"film": size * between(rng, 50.0, 180.0), "film_gap": between(rng, 5e-5, 2.5e-4)}


def _valve(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"valve": size * between(rng, 1e4, 4e4)}


def _seat(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"seat": size * between(rng, 2e-5, 7e-5), "seat_force": between(rng, 15.0, 40.0)}


def _magnet(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"magnet": size * between(rng, 1.5, 6.0), "magnet_gap": between(rng, 2e-4, 1e-3)}


def _latch(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"latch": size * between(rng, 2.5, 8.0), "latch_depth": between(rng, 1.5e-4, 4e-4)}


def _scrape(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"scrape": size * between(rng, 0.016, 0.06), "scrape_time": between(rng, 1e-3, 6e-3)}


def _chatter(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {
        "chatter": size * between(rng, 0.015, 0.06),
        "chatter_omega": 2.0 * np.pi * between(rng, 35.0, 120.0),
    }


def _pad(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"pad": size * between(rng, 0.25, 0.9), "pad_time": between(rng, 0.3, 1.2)}


def _brush(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"brush": size * between(rng, 0.8, 3.0), "brush_reach": between(rng, 5e-4, 2e-3)}


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


def _hits(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"hits": size * between(rng, 0.03, 0.12)}


def _snap(rng: np.random.Generator, size: float) -> dict[str, float]:
    # Within the first contact or the second.
    return {"snap": min(size, 1.2) * between(rng, 0.08, 0.3), "snap_after": between(rng, 5.0, 18.0)}


def _vent(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"vent": size * between(rng, 2.0, 8.0), "vent_time": between(rng, 0.04, 0.3)}


def _ratchet(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"ratchet": size * between(rng, 3.0, 9.0), "ratchet_pitch": between(rng, 8e-5, 3e-4)}


def _ejector(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"ejector": size * between(rng, 2.0, 7.0), "ejector_after": between(rng, 1.5e-2, 7e-2)}


def _worked(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"worked": size * between(rng, 0.06, 0.25), "worked_time": between(rng, 0.3, 2.0)}


CONTACT_KINDS = (
    Hidden("contact.wall-mode", _wall_mode),
    Hidden("contact.wall-scatter", _wall_scatter, chance=True),
    Hidden("contact.loose-plate", _plate),
    Hidden("contact.squeeze-film", _film),
    Hidden("contact.one-way-damper", _valve),
    Hidden("contact.seating", _seat),
    Hidden("contact.magnet", _magnet),
    Hidden("contact.latch", _latch),
    Hidden("contact.scraping", _scrape, chance=True),
    Hidden("contact.chatter", _chatter),
    Hidden("contact.dented-pad", _pad),
    Hidden("contact.brush", _brush),
    Hidden("contact.foil", _foil),
    Hidden("contact.stiffening-paste", _thick),
    Hidden("contact.hook-tape", _hook),
    Hidden("contact.uneven-hits", _hits, chance=True),
    Hidden("contact.breaking-spring", _snap),
    Hidden("contact.filling-seal", _vent),
    Hidden("contact.ratchet", _ratchet),
    Hidden("contact.ejector", _ejector),
    Hidden("contact.worked-rubber", _worked),
)
