"""Kinds of effects outside the catalogue of the sensor; see `outside`."""

from __future__ import annotations

import numpy as np

from .hidden import Hidden, between, signed

__all__ = ["SENSOR_KINDS"]


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


def _leak(rng: np.random.Generator, size: float) -> dict[str, float]:
    # A piezoelectric sensor holds a static force for some seconds alone.
    return {"leak": size * between(rng, 0.03, 0.12)}


def _tare(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"tare": size * between(rng, 0.5, 1.0), "tare_force": between(rng, 3.0, 8.0)}


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


def _own_cycle(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"cycle": size * between(rng, 1.6e-3, 4.5e-3)}


def _fringes(rng: np.random.Generator, size: float) -> dict[str, float]:
    error = between(rng, 0.8, 2.5)
    return {"fringe": size * error, "fringe_span": error * between(rng, 14.0, 35.0)}


def _zero(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"zero": size * between(rng, 0.5, 1.5)}


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


def _agc(rng: np.random.Generator, size: float) -> dict[str, float]:
    # Made for microphones.
    return {"agc": size * between(rng, 0.05, 0.2), "agc_time": between(rng, 0.02, 0.15)}


def _cut(rng: np.random.Generator, size: float) -> dict[str, float]:
    # As in flow meters, so that they do not count small signals.
    return {"cut": size * between(rng, 2.0, 7.0)}


def _ground(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"ground": size * signed(rng) * between(rng, 0.8, 3.0)}


def _tribo(rng: np.random.Generator, size: float) -> dict[str, float]:
    # At 20 mm/s it comes to some newtons.
    time = between(rng, 0.05, 0.3)
    return {"tribo": size * signed(rng) * between(rng, 0.5, 1.8) / (0.02 * time), "tribo_time": time}


def _preload(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"preload": min(size, 1.2) * between(rng, 0.025, 0.09), "preload_force": between(rng, 8.0, 30.0)}


def _pulse(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"pulse": size * signed(rng) * between(rng, 2.0, 7.0), "pulse_time": between(rng, 5e-3, 2.5e-2)}


SENSOR_KINDS = (
    Hidden("sensor.clipping", _clip),
    Hidden("sensor.hum", _hum),
    Hidden("sensor.heat", _heat),
    Hidden("sensor.hysteresis", _hysteresis),
    Hidden("sensor.spikes", _spikes, chance=True),
    Hidden("sensor.charge-leak", _leak),
    Hidden("sensor.tare", _tare),
    Hidden("sensor.motor-pickup", _pickup),
    Hidden("sensor.excitation-ripple", _ripple),
    Hidden("sensor.bushing", _bushing),
    Hidden("sensor.own-cycle", _own_cycle),
    Hidden("sensor.interpolation", _fringes),
    Hidden("sensor.zero-shift", _zero, chance=True),
    Hidden("sensor.two-ranges", _ranges),
    Hidden("sensor.heavy-bit", _bit),
    Hidden("sensor.loose-wire", _wire, chance=True),
    Hidden("sensor.adaptive-filter", _calm),
    Hidden("sensor.swinging-element", _ring),
    Hidden("sensor.sampling-jitter", _sampling, chance=True),
    Hidden("sensor.gain-control", _agc),
    Hidden("sensor.low-cut", _cut),
    Hidden("sensor.shared-ground", _ground),
    Hidden("sensor.rubbed-cable", _tribo),
    Hidden("sensor.lost-preload", _preload),
    Hidden("sensor.switch-pulse", _pulse),
)
