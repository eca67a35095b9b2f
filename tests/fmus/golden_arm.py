"""Golden signals of the arm's FMUs; golden.py takes them up."""

from __future__ import annotations

import math

STEP = 5e-4
ROWS = 201
AXES = range(1, 8)


def named(name: str, size: int) -> tuple[str, ...]:
    """Names of an array's elements."""
    return tuple(f"{name}[{index}]" for index in range(1, size + 1))


POSE = {
    "position": (3, "m"),
    "orientation": (4, "1"),
    "velocity": (3, "m/s"),
    "angular_velocity": (3, "rad/s"),
}
_POSE = tuple(element for name, (size, _) in POSE.items() for element in named(name, size))
_JOINTS = {f"joint_{what}[{axis}]": ("m" if axis == 1 else "rad") + per
           for what, per in (("position", ""), ("velocity", "/s")) for axis in AXES}  # fmt: skip
UNITS = {**{name: unit for name, (_, unit) in POSE.items()}, **_JOINTS}
INPUTS = {"ArmInverse": _POSE, "ArmForward": tuple(_JOINTS)}
OUTPUTS = {
    "ArmInverse": {
        f"joint_{what}[{axis}]": (1e-12, ("m" if axis == 1 else "rad") + per)
        for what, per in (("command", ""), ("rate_command", "/s"))
        for axis in AXES
    },
    "ArmForward": {
        element: (1e-12, unit) for name, (size, unit) in POSE.items() for element in named(name, size)
    },
}
# Nothing aligned: the target turned about z, the tool to the side, the rail carrying part.
_FRAMES = {
    "target_position[2]": 0.3,
    "target_orientation[1]": 0.96,
    "target_orientation[4]": 0.28,
    "tool_position[1]": 0.05,
}
START = {
    "ArmInverse": {**_FRAMES, "rail_position": 0.1, "rail_share": 0.4},
    "ArmForward": _FRAMES,
}
OTHER = {"ArmInverse": {"target_position[3]": 1.2}, "ArmForward": {"d_6": 0.2}}


def inputs(name: str) -> list[dict[str, float]]:
    """A closed path, so that it can be gone through again and again.

    ArmInverse: 1 mm along each axis and 2 mrad about each. ArmForward: 0.1 m and 0.1 rad in the joints.
    """
    rows = []
    for number in range(ROWS):
        omega = 2.0 * math.pi / ((ROWS - 1) * STEP)
        phases = [omega * number * STEP + 0.7 * axis for axis in range(7)]
        place = [math.sin(phase) - math.sin(0.7 * axis) for axis, phase in enumerate(phases)]
        speed = [omega * math.cos(phase) for phase in phases]
        row = {"time": number * STEP}
        if name == "ArmForward":
            start = (0.0, 0.2, -1.7, 2.2, 0.3, -0.5, 0.4)
            row |= {f"joint_position[{axis}]": start[axis - 1] + 0.1 * place[axis - 1] for axis in AXES}
            row |= {f"joint_velocity[{axis}]": 0.1 * speed[axis - 1] for axis in AXES}
        else:
            half = [1e-3 * place[axis] for axis in (3, 4, 5)]
            row |= {f"position[{axis + 1}]": 1e-3 * place[axis] for axis in range(3)}
            turn = (math.sqrt(1.0 - sum(one * one for one in half)), *half)
            row |= {f"orientation[{axis + 1}]": turn[axis] for axis in range(4)}
            row |= {f"velocity[{axis + 1}]": 1e-3 * speed[axis] for axis in range(3)}
            row |= {f"angular_velocity[{axis + 1}]": 2e-3 * speed[axis + 3] for axis in range(3)}
        rows.append(row)
    return rows
