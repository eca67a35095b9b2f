"""Kinds of effects outside the catalogue of the link and of both programs; see `outside`."""

from __future__ import annotations

import numpy as np

from .hidden import Hidden, between, signed

__all__ = ["SOFTWARE_KINDS"]


def _burst(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {
        "burst": size * between(rng, 3.0, 10.0),
        "burst_period": rng.uniform(0.3, 0.7),
        "burst_length": rng.uniform(0.03, 0.1),
    }


def _wheel(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"wheel": size * between(rng, 2.0, 8.0), "wheel_omega": 2.0 * np.pi * rng.uniform(3.0, 20.0)}


def _missed(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"missed": size * between(rng, 0.03, 0.15)}


def _output_limit(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"output_limit": between(rng, 45.0, 90.0) / max(size, 0.05) ** 0.5}


def _stall(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"stall": max(size, 0.1) * between(rng, 6e-3, 2e-2), "stall_period": between(rng, 0.1, 0.4)}


def _reordering(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"reorder": size * between(rng, 0.03, 0.12), "reorder_ticks": float(rng.integers(2, 7))}


def _clock_resets(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"reset": size * between(rng, 1e-3, 4e-3), "reset_period": between(rng, 0.15, 0.6)}


def _fixed_point(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"count": size * between(rng, 1.5e-5, 6e-5)}


def _forget(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"forget": size * between(rng, 0.1, 0.4)}


def _stale(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"stale": size * between(rng, 0.3, 1.0)}


def _fuel(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"fuel": size * between(rng, 0.01, 0.05)}


def _dead_band(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"thrust": size * between(rng, 0.3, 1.5), "thrust_speed": between(rng, 7e-3, 1.3e-2)}


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


def _bridge(rng: np.random.Generator, size: float) -> dict[str, float]:
    # What it errs by grows with the square of the time.
    return {
        "bridge": float(np.sqrt(size)) * between(rng, 6e-3, 1.4e-2),
        "bridge_rate": between(rng, 4.0, 12.0),
    }


def _change(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"change": size * between(rng, 1.5e-5, 5e-5)}


def _seek(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {
        "seek": size * between(rng, 1.5, 5.0),
        "seek_force": between(rng, 8.0, 25.0),
        "seek_time": between(rng, 0.05, 0.4),
    }


def _rubbed(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"rubbed": size * between(rng, 0.03, 0.12), "rubbed_force": between(rng, 0.3, 1.5)}


def _passive(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"passive": min(size, 1.2) * between(rng, 0.1, 0.4), "passive_from": rng.uniform(0.1, 0.5)}


def _helped(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"helped": size * between(rng, 0.8, 3.0), "helped_rate": between(rng, 1e-3, 5e-3)}


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


SOFTWARE_KINDS = (
    Hidden("dynamics.thruster-bursts", _burst),
    Hidden("dynamics.wheel", _wheel),
    Hidden("controller.missed-ticks", _missed, chance=True),
    Hidden("controller.output-limit", _output_limit),
    Hidden("link.stall", _stall),
    Hidden("link.reordering", _reordering, chance=True),
    Hidden("link.clock-resets", _clock_resets),
    Hidden("controller.fixed-point", _fixed_point),
    Hidden("controller.forgetting", _forget),
    Hidden("controller.stale-position", _stale),
    Hidden("dynamics.fuel", _fuel),
    Hidden("dynamics.dead-band-thrusters", _dead_band),
    Hidden("link.corruption", _corruption, chance=True),
    Hidden("link.changed-route", _route),
    Hidden("dynamics.ignored-force", _ignored),
    Hidden("dynamics.plume", _plume),
    Hidden("dynamics.coarse-timer", _timer),
    Hidden("controller.ramp-in", _ramp),
    Hidden("controller.outlier-gate", _gate),
    Hidden("link.queue", _queue, chance=True),
    Hidden("link.busy-in-contact", _busy),
    Hidden("dynamics.loose-load", _loose),
    Hidden("dynamics.crew", _crew, chance=True),
    Hidden("controller.notch", _notch),
    Hidden("link.text", _text),
    Hidden("link.increments", _increments, chance=True),
    Hidden("dynamics.spin", _spin),
    Hidden("dynamics.stuck-valve", _stuck),
    Hidden("controller.overrun", _overrun),
    Hidden("controller.payload", _payload),
    Hidden("link.dead-reckoning", _bridge, chance=True),
    Hidden("link.send-on-change", _change),
    Hidden("dynamics.post-contact-thrust", _seek),
    Hidden("dynamics.rubbing-hinge", _rubbed),
    Hidden("controller.passivity", _passive),
    Hidden("controller.friction-compensation", _helped),
    Hidden("link.frame-slips", _frame_slips, chance=True),
    Hidden("link.sparse-updates", _sparse),
    Hidden("dynamics.joined-mass", _joined),
    Hidden("dynamics.navigation-fix", _fix),
    Hidden("controller.force-integral", _summed),
    Hidden("controller.expected-force", _blend),
    Hidden("link.time-slots", _slots),
    Hidden("link.standby-sender", _standby),
    Hidden("dynamics.keep-in-box", _box),
    Hidden("dynamics.smoothed-force", _smoothed),
    Hidden("controller.bounded-lead", _bound),
    Hidden("controller.debounce", _debounce),
)
