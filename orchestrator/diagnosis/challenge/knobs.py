"""The numbers that make up a real rig: calibrated ones, hidden effects and roughness; zero is "absent"."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

__all__ = ["CALIBRATED", "KNOBS", "knobs"]

# Calibrated numbers as case.yaml names them, and the knob that each sets.
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

# Knob: its unit. Those of drawn series (noise, arrivals, bursts) are turned into series before a run.
KNOBS = {
    "omega": "rad/s",
    "xi": "1",
    "tau": "s",
    "k": "N/m",
    "c": "N.s/m",
    "front": "m",
    "rear": "m",
    "tau_s": "s",
    "cutoff": "rad/s",
    "bias": "N",
    # link
    "hold": "1",
    "skew": "1",
    "loss": "1",
    "jitter": "s",
    "stall": "s",
    "stall_period": "s",
    "reorder": "1",
    "reorder_ticks": "1",
    "reset": "s",
    "reset_period": "s",
    "corrupt": "m",
    "corrupt_rate": "1/s",
    "route": "s",
    # robot
    "rate_limit": "m/s",
    "acceleration_limit": "m/s2",
    "backlash": "m",
    "coulomb": "m/s2",
    "stribeck": "1",
    "stribeck_rate": "m/s",
    "resonance": "1",
    "resonance_omega": "rad/s",
    "resonance_xi": "1",
    "command_step": "m",
    "command_phase": "m",
    "load": "m/(s2.N)",
    "cogging": "m",
    "cogging_pitch": "m",
    "creep": "1",
    "creep_time": "s",
    "dahl": "m/s2",
    "dahl_length": "m",
    "integral": "1/s",
    "one_sided": "1",
    "one_sided_rate": "m/s",
    "soft_gain": "1",
    "soft_gain_rate": "m/s",
    "cold": "1",
    "cold_time": "s",
    # structure
    "compliance": "m/N",
    "scale": "1",
    "offset": "m",
    "bend": "1/m",
    "slack": "m",
    "slack_force": "N",
    "slip": "m/(N.s)",
    "slip_force": "N",
    "sway": "1/kg",
    "sway_arm": "kg",
    "sway_omega": "rad/s",
    "sway_xi": "1",
    "joint": "m/N",
    "joint_force": "N",
    "floor": "m",
    "floor_omega": "rad/s",
    # sensor
    "filter_time": "s",
    "drift": "N/s",
    "gain": "1",
    "coloured": "N",
    "coloured_keep": "1",
    "force_step": "N",
    "dropout": "1",
    "tool": "kg",
    "clip": "N",
    "hum": "N",
    "hum_omega": "rad/s",
    "heat": "1",
    "heat_time": "s",
    "hysteresis": "1",
    "hysteresis_width": "N",
    "spikes": "N",
    "spike_rate": "1/s",
    "leak": "1/s",
    "tare": "1",
    "tare_force": "N",
    "pickup": "N",
    "pickup_pitch": "m",
    "pickup_phase": "rad",
    "ripple": "1",
    "ripple_omega": "rad/s",
    "bushing": "N",
    "bushing_rate": "m/s",
    # contact
    "hertz": "1",
    "cubic": "1",
    "crossley": "N.s/m2",
    "adhesion": "N",
    "adhesion_range": "m",
    "plasticity": "1",
    "friction": "1",
    "friction_rate": "m/s",
    "second": "1",
    "second_depth": "m",
    "asymmetry": "1",
    "softening": "1/s",
    "maxwell": "1",
    "maxwell_time": "s",
    "onset": "m",
    "wall_mass": "kg",
    "wall_omega": "rad/s",
    "wall_scatter": "m",
    "plate": "kg",
    "plate_gap": "m",
    "plate_omega": "rad/s",
    "film": "N.s/m",
    "film_gap": "m",
    "valve": "N.s2/m2",
    "seat": "m",
    "seat_force": "N",
    # dynamics
    "mass": "1",
    "mass_offset": "m",
    "gravity": "m/s2",
    "cable": "N/m",
    "drag": "N.s/m",
    "appendage": "1",
    "appendage_omega": "rad/s",
    "appendage_xi": "1",
    "burst": "N",
    "burst_period": "s",
    "burst_length": "s",
    "wheel": "N",
    "wheel_omega": "rad/s",
    "fuel": "1/s",
    "thrust": "N",
    "thrust_speed": "m/s",
    "ignored": "N",
    "plume": "N",
    "plume_reach": "m",
    "timer": "s",
    # controller
    "lead": "s",
    "stiffness_gain": "1",
    "missed": "1",
    "output_limit": "N",
    "count": "m",
    "forget": "1/s",
    "stale": "1",
    "ramp": "s",
    "gate": "1",
    "gate_step": "N",
    # roughness alone
    "encoder_wave": "m",
    "encoder_pitch": "m",
    "force_curve": "1/N",
    "noise_scale": "1",
    "colour": "N",
    "colour_keep": "1",
}

_RECORD = np.dtype([(name, np.float64) for name in KNOBS])


def knobs(values: Mapping[str, float]) -> np.void:
    """A record that machine code reads by name; what is not given is zero.

    Raises: KeyError for a name that is no knob.
    """
    record = np.zeros(1, _RECORD)
    for name, value in values.items():
        if name not in KNOBS:
            raise KeyError(f"{name} is no knob of the rig")
        record[name] = value
    return record[0]
