"""Golden signals of the controller in space and of the sensor's noise; golden.py takes them up."""

from __future__ import annotations

import numpy as np
from golden_arm import named
from scipy.spatial.transform import Rotation

STEP = 5e-4
_POSE = {"position": 3, "orientation": 4, "velocity": 3, "angular_velocity": 3}
INPUTS = {
    "WrenchController": (
        *named("measured_force", 3),
        *named("measured_torque", 3),
        *(
            one
            for kind in ("", "desired_")
            for name, size in _POSE.items()
            for one in named(kind + name, size)
        ),
    ),
    "SensorNoise": (),
}
# As for the controller on a line.
OUTPUTS = {
    "WrenchController": {
        **dict.fromkeys(named("force", 3), (1e-4, "N")),
        **dict.fromkeys(named("torque", 3), (1e-4, "N.m")),
        **dict.fromkeys(named("normal", 3), (1e-10, "1")),
        "stiffness_estimate": (1e-1, "N/m"),
        "damping_estimate": (1e-3, "N.s/m"),
        "contact_state": (0, "1"),
        "energy_error": (1e-8, "J"),
    },
    "SensorNoise": {
        **dict.fromkeys(named("force_noise", 3), (1e-14, "N")),
        **dict.fromkeys(named("torque_noise", 3), (1e-14, "N.m")),
    },
}
START = {
    # The sensor turned and off the target's frame, the rod tip off the satellite's.
    "WrenchController": {
        "tau_s": 1e-3,
        "tip[1]": 0.3,
        "tip[2]": -0.05,
        "sensor_position[2]": 0.2,
        "sensor_orientation[1]": 0.8,
        "sensor_orientation[3]": 0.6,
    },
    "SensorNoise": {"seed": 7, "sample_period": 1e-3, "force_sigma": 1.0, "torque_sigma": 0.05},
}
OTHER = {"WrenchController": {"sample_period": 1e-3, "tip[1]": 0.0}, "SensorNoise": {"seed": 8}}
UNITS = {
    **{"measured_torque": "N.m", "orientation": "1", "desired_orientation": "1"},
    **dict.fromkeys(("angular_velocity", "desired_angular_velocity"), "rad/s"),
}


def inputs(name: str, line: list[dict[str, float]]) -> list[dict[str, float]]:
    """Rows of inputs; the controller's are those on a line along an oblique axis, the rod turned and sliding.

    Args:
        line: inputs of the controller on a line.
    """
    if name == "SensorNoise":
        return [{"time": i * STEP} for i in range(201)]
    start = START[name]
    tip = np.array([start["tip[1]"], start["tip[2]"], 0.0])
    to_sensor = Rotation.from_quat([0.0, 0.6, 0.0, 0.8]).inv()
    turn = Rotation.from_rotvec([0.02, -0.03, 0.1])
    x, y, z, w = turn.as_quat()
    tilt = Rotation.from_euler("yz", [20.0, -30.0], degrees=True)
    axis, slide = tilt.apply([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    rows = []
    for row in line:
        force = row["measured_force"] * axis
        places = {
            kind: row[f"{kind}position"] * axis + (0.01 + 0.02 * row["time"]) * slide
            for kind in ("", "desired_")
        }
        moment = np.cross(places[""] - [0.0, 0.2, 0.0], force)
        values = [*to_sensor.apply(force), *to_sensor.apply(moment)]
        for kind, place in places.items():
            values += [*(place - turn.apply(tip)), w, x, y, z]
            values += [*(row[f"{kind}velocity"] * axis + 0.02 * slide), 0.0, 0.0, 0.0]
        rows.append({"time": row["time"], **dict(zip(INPUTS[name], map(float, values), strict=True))})
    return rows
