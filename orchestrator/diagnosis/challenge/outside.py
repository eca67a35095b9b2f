"""Kinds of effects outside the catalogue. Nothing that weighs candidates may import this module.

Who made the diagnosis knew of these; of those in `outside_fresh`, not.
"""

from __future__ import annotations

import numpy as np

from .hidden import Hidden, between, signed

__all__ = ["OUTSIDE"]


def _clip(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"clip": between(rng, 50.0, 90.0) / max(size, 0.05) ** 0.5}


def _hum(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"hum": size * between(rng, 2.0, 6.0), "hum_omega": 2.0 * np.pi * rng.uniform(48.0, 61.0)}


def _heat(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"heat": size * signed(rng) * between(rng, 0.08, 0.25), "heat_time": between(rng, 0.5, 2.0)}


def _hysteresis(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"hysteresis": size * between(rng, 0.1, 0.3), "hysteresis_width": between(rng, 8.0, 25.0)}


def _spikes(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"spikes": size * between(rng, 8.0, 30.0), "spike_rate": between(rng, 8.0, 40.0)}


def _burst(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {
        "burst": size * between(rng, 3.0, 10.0),
        "burst_period": rng.uniform(0.3, 0.7),
        "burst_length": rng.uniform(0.03, 0.1),
    }


def _wheel(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"wheel": size * between(rng, 2.0, 8.0), "wheel_omega": 2.0 * np.pi * rng.uniform(3.0, 20.0)}


def _cogging(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"cogging": size * between(rng, 1.5e-5, 6e-5), "cogging_pitch": between(rng, 6e-4, 3e-3)}


def _creep(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"creep": size * signed(rng) * between(rng, 0.02, 0.08), "creep_time": between(rng, 0.05, 0.3)}


def _missed(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"missed": size * between(rng, 0.03, 0.15)}


def _output_limit(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"output_limit": between(rng, 45.0, 90.0) / max(size, 0.05) ** 0.5}


def _bend(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"bend": size * signed(rng) * between(rng, 4.0, 15.0)}


def _slack(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"slack": size * between(rng, 4e-5, 2e-4), "slack_force": between(rng, 5.0, 20.0)}


def _wall_mode(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {
        "wall_mass": between(rng, 15.0, 50.0) / max(size, 0.02),
        "wall_omega": 2.0 * np.pi * between(rng, 15.0, 45.0),
    }


def _wall_scatter(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"wall_scatter": size * between(rng, 6e-5, 2.5e-4)}


def _stall(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"stall": max(size, 0.1) * between(rng, 6e-3, 2e-2), "stall_period": between(rng, 0.1, 0.4)}


_ALL = (
    Hidden("sensor.clipping", _clip),
    Hidden("sensor.hum", _hum),
    Hidden("sensor.heat", _heat),
    Hidden("sensor.hysteresis", _hysteresis),
    Hidden("sensor.spikes", _spikes, chance=True),
    Hidden("dynamics.thruster-bursts", _burst),
    Hidden("dynamics.wheel", _wheel),
    Hidden("robot.cogging", _cogging),
    Hidden("robot.creep", _creep),
    Hidden("controller.missed-ticks", _missed, chance=True),
    Hidden("controller.output-limit", _output_limit),
    Hidden("structure.bend", _bend),
    Hidden("structure.slack", _slack),
    Hidden("contact.wall-mode", _wall_mode),
    Hidden("contact.wall-scatter", _wall_scatter, chance=True),
    Hidden("link.stall", _stall),
)

OUTSIDE = {one.id: one for one in _ALL}
