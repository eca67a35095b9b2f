"""Kinds of effects outside the catalogue. Nothing that weighs candidates may import this module.

Who made the diagnosis knew of these; of those in `outside_fresh`, not.
"""

from __future__ import annotations

import numpy as np

from .hidden import (
    TURN,
    Draw,
    between,
    draws,
    even,
    free,
    integer,
    inverse,
    kinds,
    phase,
    rooted,
    signed,
    sized,
    turns,
    whole,
)  # fmt: skip


def _sway(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {
        "sway": size / between(rng, 800.0, 2500.0),
        "sway_arm": between(rng, 30.0, 100.0),
        "sway_omega": 2.0 * np.pi * between(rng, 5.0, 14.0),
        "sway_xi": between(rng, 0.02, 0.08),
    }


def _fringes(rng: np.random.Generator, size: float) -> dict[str, float]:
    error = between(rng, 0.8, 2.5)
    return {"fringe": size * error, "fringe_span": error * between(rng, 14.0, 35.0)}


def _bit(rng: np.random.Generator, size: float) -> dict[str, float]:
    weight = float(rng.choice([6.4, 12.8, 25.6]))
    return {
        "bit": size * signed(rng) * between(rng, 0.8, 3.0),
        "bit_weight": weight,
        "bit_at": weight * rng.uniform(0.2, 0.8),  # quiet where no force acts
    }


def _calm(rng: np.random.Generator, size: float) -> dict[str, float]:
    # Made for scales, whose display is to stand still.
    lag = size * between(rng, 1.5, 6.0)  # where hardly anything moves [ticks]
    return {"calm": lag / (1.0 + lag), "calm_step": between(rng, 4.0, 15.0)}


def _tribo(rng: np.random.Generator, size: float) -> dict[str, float]:
    # At 20 mm/s it comes to some newtons.
    time = between(rng, 0.05, 0.3)
    return {"tribo": size * signed(rng) * between(rng, 0.5, 1.8) / (0.02 * time), "tribo_time": time}


def _foil(rng: np.random.Generator, size: float) -> dict[str, float]:
    at = between(rng, 4e-4, 1.5e-3)
    return {
        "foil": size * between(rng, 5.0, 18.0),
        "foil_at": at,
        "foil_stretch": at * rng.uniform(0.6, 1.1),
    }


def _gate(rng: np.random.Generator, size: float) -> dict[str, float]:
    return {"gate": min(0.8 * size, 1.0), "gate_step": between(rng, 1.2, 2.5)}


_DRAWS: dict[str, Draw] = {
    "robot.cogging": draws(cogging=sized(1.5e-5, 6e-5), cogging_pitch=free(6e-4, 3e-3)),
    "robot.creep": draws(creep=sized(0.02, 0.08, sign="first"), creep_time=free(0.05, 0.3)),
    "structure.bend": draws(bend=sized(4.0, 15.0, sign="first")),
    "structure.slack": draws(slack=sized(4e-5, 2e-4), slack_force=free(5.0, 20.0)),
    "robot.presliding": draws(dahl=sized(2.0, 6.0), dahl_length=free(3e-5, 3e-4)),
    "robot.integral-action": draws(integral=sized(1.5, 6.0)),
    "robot.one-sided-damping": draws(
        one_sided=sized(0.1, 0.3, sign="first"), one_sided_rate=free(5e-4, 3e-3)
    ),
    "structure.slip": draws(slip=sized(1.5e-6, 6e-6), slip_force=free(8.0, 25.0)),
    "structure.base-sway": _sway,
    "robot.gain-switching": draws(soft_gain=sized(0.2, 0.6, most=1.2), soft_gain_rate=free(3e-3, 1.2e-2)),
    # Grease is stiff in a cold gear.
    "robot.warming-up": draws(cold=sized(0.1, 0.4), cold_time=free(0.25, 1.2)),
    "structure.bolted-joint": draws(joint=sized(6e-7, 2e-6), joint_force=free(8.0, 30.0)),
    # As of a compressor: its speed is no integer fraction of the mains frequency.
    "structure.floor-vibration": draws(floor=sized(1e-5, 4e-5), floor_omega=turns(9.0, 30.0)),
    "robot.weak-pole": draws(
        pole=sized(0.15, 0.5, most=1.2), pole_at=even(-3.5e-3, 3.5e-3), pole_width=free(2e-4, 8e-4)
    ),
    "robot.lost-counts": draws(lost=sized(6e-6, 2.5e-5), lost_rate=free(2.5, 8.0)),
    "robot.loaded-gear": draws(gear=sized(0.012, 0.045), gear_rate=free(1e-3, 4e-3)),
    "structure.taut-cable": draws(taut=sized(250.0, 900.0, sign="first"), taut_from=even(0.0, 2.5e-3)),
    "structure.uneven-thread": draws(
        thread=sized(1e-5, 4e-5), thread_pitch=free(3e-4, 1e-3), thread_phase=phase()
    ),
    "robot.input-shaper": draws(shaper=sized(0.12, 0.4, most=1.2), shaper_time=free(1e-2, 3e-2)),
    "robot.collision-guard": draws(
        guard=sized(0.15, 0.5, most=1.2), guard_force=free(8.0, 25.0), guard_time=free(0.02, 0.08)
    ),
    "structure.growth": draws(growth=sized(8e-5, 3e-4, sign="first"), growth_time=free(0.5, 2.5)),
    "structure.hose": draws(hose=sized(1.0, 3.5), hose_omega=turns(2.0, 6.0), hose_xi=free(0.03, 0.15)),
    "robot.sagging-supply": draws(sag=sized(0.1, 0.4, most=1.2), sag_time=free(0.03, 0.2)),
    # As set by someone who took the frames to stand further out.
    "robot.soft-stop": draws(stop=sized(0.01, 0.04), stop_at=even(4.4e-3, 5.1e-3)),
    "structure.unscrewing": draws(unscrew=sized(4e-7, 1.6e-6)),
    "structure.floating-slide": draws(
        lift=sized(2e-5, 8e-5), lift_rate=free(2e-3, 1e-2), lift_time=free(3e-3, 1.5e-2)
    ),
    "robot.reversal-kick": draws(kick=sized(4.0, 15.0), kick_time=free(8e-3, 3e-2)),
    # What it errs by falls with the square of its bandwidth.
    "robot.tracking-converter": draws(
        resolver=inverse(20.0, 45.0, least=0.02, unit=TURN), resolver_xi=free(0.5, 1.0)
    ),
    "structure.overload-clutch": draws(clutch=sized(7e-7, 2.8e-6), clutch_force=free(15.0, 40.0)),
    "structure.bowing-rod": draws(
        whip=sized(5e-6, 2e-5), whip_omega=turns(6.0, 18.0), whip_xi=free(0.02, 0.1)
    ),
    "robot.warped-brake": draws(brake=sized(0.5, 1.8), brake_pitch=free(1e-3, 5e-3), brake_phase=phase()),
    "robot.slow-loop": draws(loop=sized(6e-4, 1.5e-3, most=1.2)),
    "structure.loose-chuck": draws(chuck=sized(3e-5, 1.2e-4), chuck_force=free(4.0, 15.0)),
    "structure.air-hammer": draws(
        hammer=sized(5e-6, 2e-5), hammer_omega=turns(15.0, 50.0), hammer_force=free(10.0, 40.0)
    ),
    "sensor.clipping": draws(clip=inverse(50.0, 90.0, least=0.05)),
    "sensor.hum": draws(hum=sized(2.0, 6.0), hum_omega=even(48.0, 61.0, unit=TURN)),
    "sensor.heat": draws(heat=sized(0.08, 0.25, sign="first"), heat_time=free(0.5, 2.0)),
    "sensor.hysteresis": draws(hysteresis=sized(0.1, 0.3), hysteresis_width=free(8.0, 25.0)),
    "sensor.spikes": draws(spikes=sized(8.0, 30.0), spike_rate=free(8.0, 40.0)),
    # A piezoelectric sensor holds a static force for some seconds alone.
    "sensor.charge-leak": draws(leak=sized(0.03, 0.12)),
    "sensor.tare": draws(tare=sized(0.5, 1.0), tare_force=free(3.0, 8.0)),
    # The motor's magnets pass an unshielded cable.
    "sensor.motor-pickup": draws(
        pickup=sized(0.7, 2.5), pickup_pitch=free(1.5e-3, 6e-3), pickup_phase=phase()
    ),
    "sensor.excitation-ripple": draws(ripple=sized(0.025, 0.1), ripple_omega=turns(5.0, 25.0)),
    # It guides the rod before the sensor, which so feels its friction in free flight, too.
    "sensor.bushing": draws(bushing=sized(0.4, 1.5), bushing_rate=free(1e-3, 6e-3)),
    "sensor.own-cycle": draws(cycle=sized(1.6e-3, 4.5e-3)),
    "sensor.interpolation": _fringes,
    "sensor.zero-shift": draws(zero=sized(0.5, 1.5)),
    "sensor.two-ranges": draws(range_gain=sized(0.08, 0.25, sign="first"), range_force=free(15.0, 40.0)),
    "sensor.heavy-bit": _bit,
    "sensor.loose-wire": draws(
        wire=sized(1.5, 6.0, sign="first"), wire_rate=free(3.0, 12.0), wire_time=free(4e-3, 2e-2)
    ),
    "sensor.adaptive-filter": _calm,
    # On a rubber washer.
    "sensor.swinging-element": draws(
        ring=sized(0.22, 0.65), ring_omega=turns(35.0, 100.0), ring_xi=free(0.03, 0.12)
    ),
    # A thread reads it that others hold up.
    "sensor.sampling-jitter": draws(sampling=sized(6e-4, 2.4e-3)),
    # Made for microphones.
    "sensor.gain-control": draws(agc=sized(0.05, 0.2), agc_time=free(0.02, 0.15)),
    # As in flow meters, so that they do not count small signals.
    "sensor.low-cut": draws(cut=sized(2.0, 7.0)),
    "sensor.shared-ground": draws(ground=sized(0.8, 3.0, sign="first")),
    "sensor.rubbed-cable": _tribo,
    "sensor.lost-preload": draws(preload=sized(0.025, 0.09, most=1.2), preload_force=free(8.0, 30.0)),
    "sensor.switch-pulse": draws(pulse=sized(2.0, 7.0, sign="first"), pulse_time=free(5e-3, 2.5e-2)),
    "contact.wall-mode": draws(
        wall_mass=inverse(15.0, 50.0, least=0.02, power=1.0), wall_omega=turns(15.0, 45.0)
    ),
    "contact.wall-scatter": draws(wall_scatter=sized(6e-5, 2.5e-4)),
    "contact.loose-plate": draws(
        plate=sized(0.8, 3.0, least=0.02), plate_gap=rooted(1e-4, 5e-4), plate_omega=turns(4.0, 12.0)
    ),
    "contact.squeeze-film": draws(film=sized(50.0, 180.0), film_gap=free(5e-5, 2.5e-4)),
    "contact.one-way-damper": draws(valve=sized(1e4, 4e4)),
    "contact.seating": draws(seat=sized(2e-5, 7e-5), seat_force=free(15.0, 40.0)),
    "contact.magnet": draws(magnet=sized(1.5, 6.0), magnet_gap=free(2e-4, 1e-3)),
    "contact.latch": draws(latch=sized(2.5, 8.0), latch_depth=free(1.5e-4, 4e-4)),
    "contact.scraping": draws(scrape=sized(0.016, 0.06), scrape_time=free(1e-3, 6e-3)),
    "contact.chatter": draws(chatter=sized(0.015, 0.06), chatter_omega=turns(35.0, 120.0)),
    "contact.dented-pad": draws(pad=sized(0.25, 0.9), pad_time=free(0.3, 1.2)),
    "contact.brush": draws(brush=sized(0.8, 3.0), brush_reach=free(5e-4, 2e-3)),
    "contact.foil": _foil,
    "contact.stiffening-paste": draws(thick=sized(0.08, 0.3)),
    "contact.hook-tape": draws(hook=sized(1.5, 6.0), hook_reach=free(1e-4, 5e-4)),
    "contact.uneven-hits": draws(hits=sized(0.03, 0.12)),
    # Within the first contact or the second.
    "contact.breaking-spring": draws(snap=sized(0.08, 0.3, most=1.2), snap_after=free(5.0, 18.0)),
    "contact.filling-seal": draws(vent=sized(2.0, 8.0), vent_time=free(0.04, 0.3)),
    "contact.ratchet": draws(ratchet=sized(3.0, 9.0), ratchet_pitch=free(8e-5, 3e-4)),
    "contact.ejector": draws(ejector=sized(2.0, 7.0), ejector_after=free(1.5e-2, 7e-2)),
    "contact.worked-rubber": draws(worked=sized(0.06, 0.25), worked_time=free(0.3, 2.0)),
    "dynamics.thruster-bursts": draws(
        burst=sized(3.0, 10.0), burst_period=even(0.3, 0.7), burst_length=even(0.03, 0.1)
    ),
    "dynamics.wheel": draws(wheel=sized(2.0, 8.0), wheel_omega=even(3.0, 20.0, unit=TURN)),
    "controller.missed-ticks": draws(missed=sized(0.03, 0.15)),
    "controller.output-limit": draws(output_limit=inverse(45.0, 90.0, least=0.05)),
    "link.stall": draws(stall=sized(6e-3, 2e-2, least=0.1), stall_period=free(0.1, 0.4)),
    "link.reordering": draws(reorder=sized(0.03, 0.12), reorder_ticks=integer(2, 7)),
    "link.clock-resets": draws(reset=sized(1e-3, 4e-3), reset_period=free(0.15, 0.6)),
    "controller.fixed-point": draws(count=sized(1.5e-5, 6e-5)),
    "controller.forgetting": draws(forget=sized(0.1, 0.4)),
    "controller.stale-position": draws(stale=sized(0.3, 1.0)),
    "dynamics.fuel": draws(fuel=sized(0.01, 0.05)),
    "dynamics.dead-band-thrusters": draws(thrust=sized(0.3, 1.5), thrust_speed=free(7e-3, 1.3e-2)),
    "link.corruption": draws(corrupt=sized(4e-5, 1.6e-4), corrupt_rate=free(6.0, 30.0)),
    "link.changed-route": draws(route=sized(2e-4, 8e-4, sign="first")),
    "dynamics.ignored-force": draws(ignored=sized(1.5, 5.0)),
    "dynamics.plume": draws(plume=sized(3.0, 12.0), plume_reach=free(8e-4, 4e-3)),
    "dynamics.coarse-timer": draws(timer=sized(1.2e-4, 4.5e-4)),
    "controller.ramp-in": draws(ramp=sized(3e-3, 1e-2)),
    "controller.outlier-gate": _gate,
    "link.queue": draws(queue=sized(6e-4, 2.5e-3), queue_rate=free(2.0, 8.0), queue_drain=free(0.02, 0.15)),
    "link.busy-in-contact": draws(busy=sized(3e-4, 1.2e-3), busy_force=free(5.0, 25.0)),
    "dynamics.loose-load": draws(
        loose=sized(0.02, 0.08), loose_gap=free(2e-4, 1.5e-3), loose_omega=turns(8.0, 25.0)
    ),
    "dynamics.crew": draws(crew=sized(0.8, 3.0), crew_time=free(0.02, 0.15)),
    "controller.notch": draws(
        notch=sized(0.3, 0.8, most=1.2), notch_omega=turns(25.0, 65.0), notch_width=free(0.3, 1.0)
    ),
    "link.text": draws(text=sized(1e-4, 3.5e-4)),
    "link.increments": draws(increments=sized(5e-3, 2e-2), increments_key=free(0.03, 0.12)),
    "dynamics.spin": draws(spin=sized(0.03, 0.12), spin_omega=turns(0.2, 1.0), spin_phase=phase(np.pi)),
    "dynamics.stuck-valve": draws(
        stuck=sized(1.2, 4.0, sign="first"), stuck_from=even(0.3, 1.5), stuck_time=free(0.3, 1.0)
    ),
    "controller.overrun": draws(overrun=sized(0.1, 0.4, most=1.2)),
    "controller.payload": draws(payload=sized(0.3, 1.2)),
    # What it errs by grows with the square of the time.
    "link.dead-reckoning": draws(bridge=rooted(6e-3, 1.4e-2), bridge_rate=free(4.0, 12.0)),
    "link.send-on-change": draws(change=sized(1.5e-5, 5e-5)),
    "dynamics.post-contact-thrust": draws(
        seek=sized(1.5, 5.0), seek_force=free(8.0, 25.0), seek_time=free(0.05, 0.4)
    ),
    "dynamics.rubbing-hinge": draws(rubbed=sized(0.03, 0.12), rubbed_force=free(0.3, 1.5)),
    "controller.passivity": draws(passive=sized(0.1, 0.4, most=1.2), passive_from=even(0.1, 0.5)),
    "controller.friction-compensation": draws(helped=sized(0.8, 3.0), helped_rate=free(1e-3, 5e-3)),
    "link.frame-slips": draws(frame_slip=sized(2e-4, 8e-4), frame_slip_rate=free(2.0, 8.0)),
    "link.sparse-updates": draws(sparse=sized(1.5e-5, 5e-5)),
    "dynamics.joined-mass": draws(joined=sized(0.03, 0.12), joined_force=free(6.0, 25.0)),
    "dynamics.navigation-fix": draws(fix=sized(2e-4, 8e-4), fix_period=free(0.1, 0.4)),
    "controller.force-integral": draws(summed=sized(0.15, 0.6)),
    "controller.expected-force": draws(blend=sized(0.2, 0.7, most=1.2)),
    "link.time-slots": draws(slot=sized(1.5e-3, 4.5e-3)),
    "link.standby-sender": draws(standby=sized(1.5e-3, 6e-3), standby_every=integer(3, 11)),
    "dynamics.keep-in-box": draws(box=sized(1.0, 3.5), box_edge=free(2e-3, 4.5e-3)),
    "dynamics.smoothed-force": draws(smoothed=sized(8e-4, 3e-3)),
    "controller.bounded-lead": draws(lead_bound=inverse(0.5, 1.6, least=0.02, power=0.7)),
    "controller.debounce": draws(debounce=whole(6.0, 24.0)),
}
# Drawn again at each sample or contact.
_CHANCE = {
    "robot.lost-counts",
    "sensor.spikes",
    "sensor.zero-shift",
    "sensor.loose-wire",
    "sensor.sampling-jitter",
    "contact.wall-scatter",
    "contact.scraping",
    "contact.uneven-hits",
    "controller.missed-ticks",
    "link.reordering",
    "link.corruption",
    "link.queue",
    "dynamics.crew",
    "link.increments",
    "link.dead-reckoning",
    "link.frame-slips",
}

OUTSIDE = kinds(_DRAWS, _CHANCE)
