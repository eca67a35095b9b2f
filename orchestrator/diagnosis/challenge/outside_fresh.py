"""More kinds of effects outside the catalogue, made without a look at what diagnoses.

Nothing that weighs candidates may import this module, nor be fitted to what it holds: see `outside` for those
that were known when the diagnosis was made.
"""

from __future__ import annotations

import numpy as np

from .hidden import Hidden, between, signed

__all__ = ["FRESH"]


def _kick(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"kick": size * between(rng, 4.0, 15.0), "kick_time": between(rng, 8e-3, 3e-2)}


def _resolver(rng: np.random.Generator, size: float) -> dict[str, float]:
    # What it errs by falls with the square of its bandwidth.
    return {
        "resolver": 2.0 * np.pi * between(rng, 20.0, 45.0) / max(size, 0.02) ** 0.5,
        "resolver_xi": between(rng, 0.5, 1.0),
    }


def _clutch(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"clutch": size * between(rng, 7e-7, 2.8e-6), "clutch_force": between(rng, 15.0, 40.0)}


def _whip(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {
        "whip": size * between(rng, 5e-6, 2e-5),
        "whip_omega": 2.0 * np.pi * between(rng, 6.0, 18.0),
        "whip_xi": between(rng, 0.02, 0.1),
    }


def _agc(rng: np.random.Generator, size: float) -> dict[str, float]:
    # Made for microphones.
    return {"agc": size * between(rng, 0.05, 0.2), "agc_time": between(rng, 0.02, 0.15)}


def _cut(rng: np.random.Generator, size: float) -> dict[str, float]:
    # As flow meters have it, lest they count what is nothing.
    return {"cut": size * between(rng, 2.0, 7.0)}


def _ground(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"ground": size * signed(rng) * between(rng, 0.8, 3.0)}


def _hits(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"hits": size * between(rng, 0.03, 0.12)}


def _snap(rng: np.random.Generator, size: float) -> dict[str, float]:
    # Within the first contact or the second.
    return {"snap": min(size, 1.2) * between(rng, 0.08, 0.3), "snap_after": between(rng, 5.0, 18.0)}


def _vent(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"vent": size * between(rng, 2.0, 8.0), "vent_time": between(rng, 0.04, 0.3)}


def _frame_slips(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"frame_slip": size * between(rng, 2e-4, 8e-4), "frame_slip_rate": between(rng, 2.0, 8.0)}


def _sparse(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"sparse": size * between(rng, 1.5e-5, 5e-5)}


def _joined(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"joined": size * between(rng, 0.03, 0.12), "joined_force": between(rng, 6.0, 25.0)}


def _fix(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"fix": size * between(rng, 2e-4, 8e-4), "fix_period": between(rng, 0.1, 0.4)}


def _summed(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"summed": size * between(rng, 0.15, 0.6)}


def _blend(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"blend": min(size, 1.2) * between(rng, 0.2, 0.7)}


_ALL = (
    Hidden("robot.reversal-kick", _kick),
    Hidden("robot.tracking-converter", _resolver),
    Hidden("structure.overload-clutch", _clutch),
    Hidden("structure.bowing-rod", _whip),
    Hidden("sensor.gain-control", _agc),
    Hidden("sensor.low-cut", _cut),
    Hidden("sensor.shared-ground", _ground),
    Hidden("contact.uneven-hits", _hits, chance=True),
    Hidden("contact.breaking-spring", _snap),
    Hidden("contact.filling-seal", _vent),
    Hidden("link.frame-slips", _frame_slips, chance=True),
    Hidden("link.sparse-updates", _sparse),
    Hidden("dynamics.joined-mass", _joined),
    Hidden("dynamics.navigation-fix", _fix),
    Hidden("controller.force-integral", _summed),
    Hidden("controller.expected-force", _blend),
)

FRESH = {one.id: one for one in _ALL}
