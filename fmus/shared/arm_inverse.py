"""Inverse kinematics of the arm in closed form: eight branches, joint rates, distances to singularities."""

from __future__ import annotations

import math
from typing import NamedTuple

from shared.arm import TURN, Arm, Geometry, Joints
from shared.space import TINY, Quaternion, Vector, add, cross, dot, mix, subtract, turned


class Solution(NamedTuple):
    """Joints for a pose, and how far they are from where there are none.

    Attributes:
        joints: rail [m] and A1 to A6 [rad].
        reach: distance of the wrist's centre from A2 in this branch [m].
        shoulder: distance of the wrist's centre from A1 [m].
        elbow: sine of the angle between upper arm and forearm; 0 when they are in line.
        wrist: sine of A5; 0 when A4 and A6 are in line.
    """

    joints: Joints
    reach: float
    shoulder: float
    elbow: float
    wrist: float


def clamped(value: float, low: float, high: float) -> float:
    """The value, within limits."""
    return min(max(value, low), high)


def away_from_zero(value: float) -> float:
    """The value, or the smallest number of its sign that may be divided by."""
    return math.copysign(max(abs(value), TINY), value)


def nearest_turn(angle: float, reference: float) -> float:
    """The angle plus the whole turns that bring it nearest to a reference [rad]."""
    return angle + TURN * math.floor((reference - angle) / TURN + 0.5)


def distance(a: Joints, b: Joints) -> float:
    """Sum of the squared differences of A1 to A6 [rad2]."""
    total = 0.0
    for x, y in zip(a[1:], b[1:], strict=True):
        total = total + (x - y) * (x - y)
    return total


def nearer(first: Solution, second: Solution, present: Joints) -> Solution:
    """Of two solutions the one whose joints are nearer to the present ones; the first of equals."""
    if distance(second.joints, present) < distance(first.joints, present):
        return second
    return first


def branch(
    geometry: Geometry,
    wrist: Vector,
    orientation: Quaternion,
    rail: float,
    present: Joints,
    way: tuple[bool, bool, bool],
) -> Solution:
    """One branch of the inverse kinematics.

    Args:
        geometry: lengths [m].
        wrist: centre of the wrist in the base frame, the rail's position taken off [m].
        orientation: of the flange in the base frame.
        rail: position of the rail [m].
        present: joints that decide on whole turns.
        way: whether the arm reaches backward over itself, whether the elbow is below the line from A2 to the
            wrist, whether A5 is negative.
    Returns: joints; where the pose cannot be reached, those of the arm stretched or folded towards it.
    """
    backward, low, negative = way
    shoulder = math.hypot(wrist[0], wrist[1])
    theta_1 = math.atan2(wrist[1], wrist[0]) + (math.pi if backward else 0.0)
    forward = (-shoulder if backward else shoulder) - geometry.a_1
    height = wrist[2] - geometry.d_1
    reach = math.hypot(forward, height)
    link = math.hypot(geometry.d_4, geometry.a_3)
    bend = (reach * reach - geometry.a_2 * geometry.a_2 - link * link) / (2.0 * geometry.a_2 * link)
    elbow = math.acos(clamped(bend, -1.0, 1.0)) * (-1.0 if low else 1.0)
    q_3 = elbow + math.atan2(geometry.a_3, geometry.d_4)
    q_2 = math.atan2(-height, forward) - math.atan2(
        link * math.sin(elbow), geometry.a_2 + link * math.cos(elbow)
    )
    heading = (math.cos(theta_1), math.sin(theta_1), 0.0)
    left = (-math.sin(theta_1), math.cos(theta_1), 0.0)
    up = (0.0, 0.0, 1.0)
    forearm = mix(math.cos(q_2 + q_3), heading, -math.sin(q_2 + q_3), up)
    normal = mix(math.sin(q_2 + q_3), heading, math.cos(q_2 + q_3), up)
    approach = turned(orientation, up)
    across, above = dot(approach, left), dot(approach, normal)
    sine = math.hypot(across, above)
    q_4 = -(math.atan2(across, -above) + (math.pi if negative else 0.0))
    q_5 = math.atan2(-sine if negative else sine, dot(approach, forearm))
    # From the axis of A5 as A4 turns it, so that the pose is met in the singularity, too.
    left_4 = mix(math.cos(q_4), left, -math.sin(q_4), normal)
    x, y = turned(orientation, (1.0, 0.0, 0.0)), turned(orientation, (0.0, 1.0, 0.0))
    q_6 = -math.atan2(dot(x, left_4), dot(y, left_4))
    angles = (-theta_1, q_2, q_3, q_4, q_5, q_6)
    near = [nearest_turn(angle, reference) for angle, reference in zip(angles, present[1:], strict=True)]
    return Solution((rail, *near), reach, shoulder, math.sin(elbow), sine)


def branches(
    geometry: Geometry, flange: Vector, orientation: Quaternion, rail: float, present: Joints
) -> list[Solution]:
    """All eight branches for a pose of the flange in the base frame; see `branch`."""
    approach = turned(orientation, (0.0, 0.0, 1.0))
    wrist = subtract(mix(1.0, flange, -geometry.d_6, approach), (rail, 0.0, 0.0))
    return [
        branch(geometry, wrist, orientation, rail, present, (backward, low, negative))
        for backward in (False, True)
        for low in (False, True)
        for negative in (False, True)
    ]


def inverse(
    geometry: Geometry, flange: Vector, orientation: Quaternion, rail: float, present: Joints
) -> Solution:
    """Joints for a pose of the flange in the base frame: of eight branches the one nearest to `present`."""
    found = branches(geometry, flange, orientation, rail, present)
    best = found[0]
    for other in found[1:]:
        best = nearer(best, other, present)
    return best


def joint_rates(parts: Arm, joints: Joints, rail_rate: float, velocity: Vector, angular: Vector) -> Joints:
    """Rates of the joints for a twist of the flange; exact but at a singularity.

    Args:
        parts: of the arm at `joints`.
        joints: rail [m] and A1 to A6 [rad].
        rail_rate: of the rail [m/s].
        velocity: of the wrist's centre in the base frame [m/s].
        angular: angular velocity of the flange in the base frame [rad/s].
    """
    moved = subtract(velocity, (rail_rate, 0.0, 0.0))
    radius = dot(subtract(parts.wrist, parts.column), parts.heading)
    turn = dot(moved, parts.left) / away_from_zero(radius)
    outward, upward = dot(moved, parts.heading), moved[2]
    from_shoulder, from_elbow = (
        subtract(parts.wrist, parts.shoulder),
        subtract(parts.wrist, parts.elbow),
    )
    d_r, d_z = dot(from_shoulder, parts.heading), from_shoulder[2]
    e_r, e_z = dot(from_elbow, parts.heading), from_elbow[2]
    determinant = away_from_zero(d_r * e_z - d_z * e_r)
    rate_2 = -(outward * e_r + upward * e_z) / determinant
    rate_3 = (outward * d_r + upward * d_z) / determinant
    lifted = mix(1.0, (0.0, 0.0, turn), rate_2 + rate_3, parts.left)
    rest = subtract(angular, lifted)
    normal_4 = mix(math.sin(joints[4]), parts.left, math.cos(joints[4]), parts.normal)
    roll = -dot(rest, normal_4) / away_from_zero(math.sin(joints[5]))
    rate_4 = roll * math.cos(joints[5]) - dot(rest, parts.forearm)
    return (rail_rate, -turn, rate_2, rate_3, rate_4, dot(rest, parts.left_4), -roll)


def wrist_velocity(parts: Arm, point: Vector, velocity: Vector, angular: Vector) -> Vector:
    """Velocity of the wrist's centre [m/s] from that of another point of the flange, in the base frame."""
    return add(velocity, cross(angular, subtract(parts.wrist, point)))
