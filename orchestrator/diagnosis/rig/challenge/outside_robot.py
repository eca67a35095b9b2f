"""Kinds of effects outside the catalogue of robot and structure; see `outside`."""

from __future__ import annotations

import numpy as np

from .hidden import Hidden, between, signed

__all__ = ["ROBOT_KINDS"]


def _cogging(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"cogging": size * between(rng, 1.5e-5, 6e-5), "cogging_pitch": between(rng, 6e-4, 3e-3)}


def _creep(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"creep": size * signed(rng) * between(rng, 0.02, 0.08), "creep_time": between(rng, 0.05, 0.3)}


def _bend(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"bend": size * signed(rng) * between(rng, 4.0, 15.0)}


def _slack(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"slack": size * between(rng, 4e-5, 2e-4), "slack_force": between(rng, 5.0, 20.0)}


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
    # As of a compressor: its speed is no integer fraction of the mains frequency.
    return {"floor": size * between(rng, 1e-5, 4e-5), "floor_omega": 2.0 * np.pi * between(rng, 9.0, 30.0)}


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


ROBOT_KINDS = (
    Hidden("robot.cogging", _cogging),
    Hidden("robot.creep", _creep),
    Hidden("structure.bend", _bend),
    Hidden("structure.slack", _slack),
    Hidden("robot.presliding", _presliding),
    Hidden("robot.integral-action", _integral),
    Hidden("robot.one-sided-damping", _one_sided),
    Hidden("structure.slip", _slip),
    Hidden("structure.base-sway", _sway),
    Hidden("robot.gain-switching", _gain_switching),
    Hidden("robot.warming-up", _warming),
    Hidden("structure.bolted-joint", _joint),
    Hidden("structure.floor-vibration", _floor),
    Hidden("robot.weak-pole", _pole),
    Hidden("robot.lost-counts", _lost, chance=True),
    Hidden("robot.loaded-gear", _gear),
    Hidden("structure.taut-cable", _taut),
    Hidden("structure.uneven-thread", _thread),
    Hidden("robot.input-shaper", _shaper),
    Hidden("robot.collision-guard", _guard),
    Hidden("structure.growth", _growth),
    Hidden("structure.hose", _hose),
    Hidden("robot.sagging-supply", _sag),
    Hidden("robot.soft-stop", _stop),
    Hidden("structure.unscrewing", _unscrew),
    Hidden("structure.floating-slide", _lift),
    Hidden("robot.reversal-kick", _kick),
    Hidden("robot.tracking-converter", _resolver),
    Hidden("structure.overload-clutch", _clutch),
    Hidden("structure.bowing-rod", _whip),
    Hidden("robot.warped-brake", _brake),
    Hidden("robot.slow-loop", _loop),
    Hidden("structure.loose-chuck", _chuck),
    Hidden("structure.air-hammer", _hammer),
)
