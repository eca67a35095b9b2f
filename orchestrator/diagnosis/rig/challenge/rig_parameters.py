"""Parameters of a real rig: calibrated ones, hidden effects and roughness; zero is "absent"."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

# Calibrated numbers as case.yaml names them, and the parameter that each sets.
CALIBRATED = {
    "natural_frequency": "omega",
    "damping_ratio": "xi",
    "response_delay": "tau",
    "contact_stiffness": "k",
    "contact_damping": "c",
    "front_wall": "front",
    "rear_wall": "rear",
    "sensor_delay": "tau_s",
    "sensor_cutoff": "cutoff",
    "force_bias": "bias",
}

# Names and units. Parameters of drawn series (noise, arrivals, bursts) are turned into series before a run.
_PARAMETERS = {
    "calibrated": """
        omega rad/s, xi 1, tau s, k N/m, c N.s/m, front m, rear m, tau_s s, cutoff rad/s, bias N""",
    "link": """
        hold 1, skew 1, loss 1, jitter s, stall s, stall_period s, reorder 1, reorder_ticks 1, reset s,
        reset_period s, corrupt m, corrupt_rate 1/s, route s, queue s, queue_rate 1/s, queue_drain 1,
        busy s, busy_force N, text s, increments 1, increments_key s, bridge s, bridge_rate 1/s, change m,
        frame_slip s, frame_slip_rate 1/s, sparse m, slot s, standby s, standby_every 1, tracker 1,
        wander s, wander_time s""",
    "robot": """
        rate_limit m/s, acceleration_limit m/s2, backlash m, coulomb m/s2, stribeck 1, stribeck_rate m/s,
        resonance 1, resonance_omega rad/s, resonance_xi 1, command_step m, command_phase m, load m/(s2.N),
        cogging m, cogging_pitch m, creep 1, creep_time s, dahl m/s2, dahl_length m, integral 1/s,
        one_sided 1, one_sided_rate m/s, soft_gain 1, soft_gain_rate m/s, cold 1, cold_time s, pole 1,
        pole_at m, pole_width m, lost m, lost_rate 1/s, gear m/(s2.N), gear_rate m/s, shaper 1,
        shaper_time s, guard 1, guard_force N, guard_time s, sag 1, sag_time s, stop 1, stop_at m,
        kick m/s2, kick_time s, resolver rad/s, resolver_xi 1, brake m/s2, brake_pitch m, brake_phase rad,
        loop s, forward 1, idle m/s2""",
    "structure": """
        compliance m/N, scale 1, offset m, bend 1/m, slack m, slack_force N, slip m/(N.s), slip_force N,
        sway 1/kg, sway_arm kg, sway_omega rad/s, sway_xi 1, joint m/N, joint_force N, floor m,
        floor_omega rad/s, taut N/m, taut_from m, thread m, thread_pitch m, thread_phase rad, growth m,
        growth_time s, hose kg, hose_omega rad/s, hose_xi 1, unscrew m/(N.s), lift m, lift_rate m/s,
        lift_time s, clutch m/N, clutch_force N, whip m, whip_omega rad/s, whip_xi 1, chuck m,
        chuck_force N, hammer m, hammer_omega rad/s, hammer_force N, hunt m, hunt_omega rad/s, yaw m,
        yaw_length m""",
    "sensor": """
        filter_time s, drift N/s, gain 1, coloured N, coloured_keep 1, force_step N, dropout 1, tool kg,
        clip N, hum N, hum_omega rad/s, heat 1, heat_time s, hysteresis 1, hysteresis_width N, spikes N,
        spike_rate 1/s, leak 1/s, tare 1, tare_force N, pickup N, pickup_pitch m, pickup_phase rad,
        ripple 1, ripple_omega rad/s, bushing N, bushing_rate m/s, cycle s, fringe N, fringe_span N, zero N,
        range_gain 1, range_force N, bit N, bit_weight N, bit_at N, wire N, wire_rate 1/s, wire_time s,
        calm 1, calm_step N, ring 1, ring_omega rad/s, ring_xi 1, sampling s, agc 1, agc_time s, cut N,
        ground N, tribo N/m, tribo_time s, preload 1, preload_force N, pulse N, pulse_time s, ghost N/m,
        buffer s, buffer_period s, buzz N""",
    "contact": """
        hertz 1, cubic 1, crossley N.s/m2, adhesion N, adhesion_range m, plasticity 1, friction 1,
        friction_rate m/s, second 1, second_depth m, asymmetry 1, softening 1/s, maxwell 1, maxwell_time s,
        onset m, wall_mass kg, wall_omega rad/s, wall_scatter m, plate kg, plate_gap m, plate_omega rad/s,
        film N.s/m, film_gap m, valve N.s2/m2, seat m, seat_force N, magnet N, magnet_gap m, latch N,
        latch_depth m, scrape 1, scrape_time s, chatter 1, chatter_omega rad/s, pad 1, pad_time s, brush N,
        brush_reach m, foil N, foil_at m, foil_stretch m, thick 1, hook N, hook_reach m, hits 1, snap 1,
        snap_after N.s, vent N, vent_time s, ratchet N, ratchet_pitch m, ejector N, ejector_after s,
        worked 1, worked_time s, clay m, clay_impulse N.s, rope N, rope_length m, cup N, cup_reach m""",
    "dynamics": """
        mass 1, mass_offset m, gravity m/s2, cable N/m, drag N.s/m, appendage 1, appendage_omega rad/s,
        appendage_xi 1, burst N, burst_period s, burst_length s, wheel N, wheel_omega rad/s, fuel 1/s,
        thrust N, thrust_speed m/s, ignored N, plume N, plume_reach m, timer s, loose 1, loose_gap m,
        loose_omega rad/s, crew N, crew_time s, spin 1, spin_omega rad/s, spin_phase rad, stuck N,
        stuck_from s, stuck_time s, seek N, seek_force N, seek_time s, rubbed 1, rubbed_force N, joined 1,
        joined_force N, fix m/s, fix_period s, box N, box_edge m, smoothed s, rezero 1/s, corrected 1/s2""",
    "controller": """
        lead s, stiffness_gain 1, missed 1, output_limit N, count m, forget 1/s, stale 1, ramp s, gate 1,
        gate_step N, notch 1, notch_omega rad/s, notch_width 1, overrun 1, payload kg, passive 1,
        passive_from 1, helped N, helped_rate m/s, summed 1/s, blend 1, lead_bound N, debounce 1, dull 1,
        release 1""",
    "roughness alone": """
        encoder_wave m, encoder_pitch m, force_curve 1/N, noise_scale 1, colour N, colour_keep 1""",
}
RIG_PARAMETERS: dict[str, str] = dict(
    part.split(maxsplit=1) for listed in _PARAMETERS.values() for part in " ".join(listed.split()).split(", ")
)

_RECORD = np.dtype([(name, np.float64) for name in RIG_PARAMETERS])


def rig_parameters(values: Mapping[str, float]) -> np.void:
    """A record that machine code reads by name; what is not given is zero.

    Raises: KeyError for a name that is no parameter.
    """
    record = np.zeros(1, _RECORD)
    for name, value in values.items():
        if name not in RIG_PARAMETERS:
            raise KeyError(f"{name} is no parameter of the rig")
        record[name] = value
    return record[0]
