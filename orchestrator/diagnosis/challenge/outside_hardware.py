"""Kinds of effects outside the catalogue of robot, structure, sensor and contact; see `outside`."""

from __future__ import annotations

import numpy as np

from .hidden import Hidden, between, signed

__all__ = ["HARDWARE_KINDS"]


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


def _cogging(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"cogging": size * between(rng, 1.5e-5, 6e-5), "cogging_pitch": between(rng, 6e-4, 3e-3)}


def _creep(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"creep": size * signed(rng) * between(rng, 0.02, 0.08), "creep_time": between(rng, 0.05, 0.3)}


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


HARDWARE_KINDS = (
    Hidden("sensor.clipping", _clip),
    Hidden("sensor.hum", _hum),
    Hidden("sensor.heat", _heat),
    Hidden("sensor.hysteresis", _hysteresis),
    Hidden("sensor.spikes", _spikes, chance=True),
    Hidden("robot.cogging", _cogging),
    Hidden("robot.creep", _creep),
    Hidden("structure.bend", _bend),
    Hidden("structure.slack", _slack),
    Hidden("contact.wall-mode", _wall_mode),
    Hidden("contact.wall-scatter", _wall_scatter, chance=True),
    Hidden("sensor.charge-leak", _leak),
    Hidden("sensor.tare", _tare),
    Hidden("robot.presliding", _presliding),
    Hidden("robot.integral-action", _integral),
    Hidden("robot.one-sided-damping", _one_sided),
    Hidden("structure.slip", _slip),
    Hidden("structure.base-sway", _sway),
    Hidden("contact.loose-plate", _plate),
    Hidden("contact.squeeze-film", _film),
    Hidden("sensor.motor-pickup", _pickup),
    Hidden("sensor.excitation-ripple", _ripple),
    Hidden("sensor.bushing", _bushing),
    Hidden("robot.gain-switching", _gain_switching),
    Hidden("robot.warming-up", _warming),
    Hidden("structure.bolted-joint", _joint),
    Hidden("structure.floor-vibration", _floor),
    Hidden("contact.one-way-damper", _valve),
    Hidden("contact.seating", _seat),
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
    Hidden("robot.sagging-supply", _sag),
    Hidden("robot.soft-stop", _stop),
    Hidden("structure.unscrewing", _unscrew),
    Hidden("structure.floating-slide", _lift),
    Hidden("sensor.adaptive-filter", _calm),
    Hidden("sensor.swinging-element", _ring),
    Hidden("sensor.sampling-jitter", _sampling, chance=True),
    Hidden("contact.foil", _foil),
    Hidden("contact.stiffening-paste", _thick),
    Hidden("contact.hook-tape", _hook),
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
)
