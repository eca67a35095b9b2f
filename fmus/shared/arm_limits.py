"""What an arm cannot do: reach, singularities, stops, rates, jumps of the command; each told with numbers."""

from __future__ import annotations

import math
from typing import Any

from shared.arm import AXES, JOINT_UNITS, RATE_UNITS, Geometry, Joints
from shared.arm_inverse import Solution
from shared.arm_ports import DEGREE, not_finite, problem


def _degrees(rail: float, *angles: float) -> tuple[float, ...]:
    return (rail, *(angle * DEGREE for angle in angles))


# The arm's as its maker gives them (README of ArmInverse); the rail's are chosen.
LIMITS = {
    "joint_lower": (
        _degrees(-1.5, -185.0, -140.0, -120.0, -350.0, -125.0, -350.0),
        JOINT_UNITS,
        "Lower stops of the rail and A1 to A6",
    ),
    "joint_upper": (
        _degrees(1.5, 185.0, -5.0, 155.0, 350.0, 125.0, 350.0),
        JOINT_UNITS,
        "Upper stops of the rail and A1 to A6",
    ),
    "joint_rate_limit": (
        _degrees(1.5, 123.0, 115.0, 112.0, 179.0, 172.0, 219.0),
        RATE_UNITS,
        "Largest rates of the rail and A1 to A6",
    ),
}
MARGINS = {
    "shoulder_margin": (0.05, "m", "Least distance of the wrist's centre from A1"),
    "elbow_margin": (0.05, "1", "Least sine of the angle between upper arm and forearm"),
    "wrist_margin": (0.05, "1", "Least sine of A5"),
}


def wrong_limits(slave: Any) -> str:
    """What is wrong with limits and margins."""
    text = ""
    for name, units in (("joint_lower", "m or rad"), ("joint_upper", "m or rad")):
        text = text + not_finite(name, getattr(slave, name), units)
    for index, axis in enumerate(AXES):
        low, high, unit = slave.joint_lower[index], slave.joint_upper[index], JOINT_UNITS[index]
        text = text + problem(
            low < high,
            f"joint_lower[{index + 1}], of {axis}, is {low:.6g} {unit}; allowed: below joint_upper"
            f"[{index + 1}], {high:.6g} {unit}",
        )
        rate = slave.joint_rate_limit[index]
        text = text + problem(
            rate > 0.0,
            f"joint_rate_limit[{index + 1}], of {axis}, is {rate!r} {RATE_UNITS[index]}; allowed: above 0",
        )
    for name, (_, unit, _) in MARGINS.items():
        value = getattr(slave, name)
        text = text + problem(value > 0.0, f"{name} is {value!r} {unit}; allowed: above 0")
    return text


def singularities(slave: Any, geometry: Geometry, found: Solution) -> str:
    """A sentence if the pose cannot be reached, and one for each singularity that is too near."""
    link = math.hypot(geometry.d_4, geometry.a_3)
    low, high = abs(geometry.a_2 - link), geometry.a_2 + link
    reached = (found.reach >= low) & (found.reach <= high)
    text = problem(
        reached,
        f"out of reach: the wrist's centre would be {found.reach:.6g} m from A2; allowed: {low:.6g} m to "
        f"{high:.6g} m. Move target_position or rail_position, or let the rail carry more by rail_share",
    )
    text = text + problem(
        found.shoulder >= slave.shoulder_margin,
        f"shoulder singularity: the wrist's centre is {found.shoulder:.6g} m from A1; allowed: "
        f"{slave.shoulder_margin:.6g} m (shoulder_margin) or more. Move target_position or rail_position",
    )
    stretched = abs(found.elbow)
    text = text + problem(
        (stretched >= slave.elbow_margin) | ((found.reach < low) | (found.reach > high)),
        f"elbow singularity: upper arm and forearm are in line but for an angle of sine {stretched:.6g}; "
        f"allowed: {slave.elbow_margin:.6g} (elbow_margin) or more. Move target_position or rail_position",
    )
    return text + problem(
        found.wrist >= slave.wrist_margin,
        f"wrist singularity: A4 and A6 are in line but for an angle, A5, of sine {found.wrist:.6g}; allowed: "
        f"{slave.wrist_margin:.6g} (wrist_margin) or more. Move target_position up or down, or turn the tool",
    )


def stops(slave: Any, joints: Joints, rates: Joints) -> str:
    """A sentence for each joint beyond a stop and each faster than it can be."""
    text = ""
    for index, axis in enumerate(AXES):
        value, low, high = joints[index], slave.joint_lower[index], slave.joint_upper[index]
        unit, rate, most = JOINT_UNITS[index], abs(rates[index]), slave.joint_rate_limit[index]
        text = text + problem(
            (value >= low) & (value <= high),
            f"{axis} would stand at {value:.6g} {unit}; allowed: {low:.6g} {unit} to {high:.6g} {unit}. "
            "Move target_position or rail_position, or start in another branch (present)",
        )
        text = text + problem(
            rate <= most,
            f"{axis} would move at {rate:.6g} {RATE_UNITS[index]}; allowed: up to {most:.6g} "
            f"{RATE_UNITS[index]}. Command it slower, or keep further from singularities",
        )
    return text


def jumps(slave: Any, before: Joints, joints: Joints, step_size: float) -> str:
    """A sentence for each joint that would have to go further in a step than its rate allows."""
    text = ""
    for index, axis in enumerate(AXES):
        way, most = abs(joints[index] - before[index]), slave.joint_rate_limit[index] * step_size
        text = text + problem(
            (way <= most) | (step_size <= 0.0),
            f"{axis} would have to go {way:.6g} {JOINT_UNITS[index]} within {step_size:.6g} s; allowed: "
            f"{most:.6g} {JOINT_UNITS[index]}. The command jumps, or the branch ends here",
        )
    return text
