"""Kinematics of a six-axis arm with a spherical wrist on a linear rail; packed into every FMU of the arm.

Base frame: at the foot of the arm when the rail stands at 0 m, x along the rail and along the arm stretched
forward, z up. Joints: the rail [m], then A1 to A6 [rad], zero and positive sense as the manufacturer counts
them: A1 turns about -z, A2, A3 and A5 about y, A4 and A6 about -x of the stretched arm. D-H table, sources:
fmus/ArmInverse/README.md. Only plain arithmetic, since the native forms of the FMUs are traced from it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from shared.space import Quaternion, Vector, add, conjugate, cross, mix, product, subtract, turned, unit

Joints = tuple[float, float, float, float, float, float, float]

AXES = ("rail", "A1", "A2", "A3", "A4", "A5", "A6")
JOINT_UNITS = ("m", *("rad",) * 6)
RATE_UNITS = ("m/s", *("rad/s",) * 6)
TURN = 2.0 * math.pi
# How far the length of a quaternion may be from one; it is scaled to one.
ORIENTATION_TOLERANCE = 1e-3


class Geometry(NamedTuple):
    """Lengths of the D-H table [m]."""

    d_1: float = 0.675
    a_1: float = 0.350
    a_2: float = 1.150
    a_3: float = -0.041
    d_4: float = 1.200
    d_6: float = 0.215


class Frames(NamedTuple):
    """Where the frames of the docking experiment stand.

    Attributes:
        target_position, target_orientation: of O_t in the base frame [m], [1].
        tool_position, tool_orientation: of O_u in the flange frame [m], [1].
    """

    target_position: Vector
    target_orientation: Quaternion
    tool_position: Vector
    tool_orientation: Quaternion


class Arm(NamedTuple):
    """The unit vectors and points that a set of joints gives, in the base frame.

    Attributes:
        heading, left: horizontal directions of the arm's plane and across it.
        forearm, normal: along A4 away from the base, and upwards across it in the arm's plane.
        left_4, approach: axis of A5; z axis of the flange.
        column, shoulder, elbow, wrist, flange: points on A1, A2, A3, the wrist's centre, the flange [m].
    """

    heading: Vector
    left: Vector
    forearm: Vector
    normal: Vector
    left_4: Vector
    approach: Vector
    column: Vector
    shoulder: Vector
    elbow: Vector
    wrist: Vector
    flange: Vector


def about(axis: int, angle: float) -> Quaternion:
    """Turn by an angle [rad] about x (1), y (2) or z (3)."""
    c, s = math.cos(0.5 * angle), math.sin(0.5 * angle)
    return (c, s if axis == 1 else 0.0, s if axis == 2 else 0.0, s if axis == 3 else 0.0)


def arm(geometry: Geometry, joints: Joints) -> Arm:
    """Where the parts of the arm are.

    Args:
        geometry: lengths [m].
        joints: rail [m] and A1 to A6 [rad].
    """
    rail, q_1, q_2, q_3, q_4, q_5, _ = joints
    heading = (math.cos(q_1), -math.sin(q_1), 0.0)
    left = (math.sin(q_1), math.cos(q_1), 0.0)
    up = (0.0, 0.0, 1.0)
    upper = mix(math.cos(q_2), heading, -math.sin(q_2), up)
    forearm = mix(math.cos(q_2 + q_3), heading, -math.sin(q_2 + q_3), up)
    normal = mix(math.sin(q_2 + q_3), heading, math.cos(q_2 + q_3), up)
    left_4 = mix(math.cos(q_4), left, -math.sin(q_4), normal)
    normal_4 = mix(math.sin(q_4), left, math.cos(q_4), normal)
    approach = mix(math.cos(q_5), forearm, -math.sin(q_5), normal_4)
    column = (rail, 0.0, geometry.d_1)
    shoulder = add(column, mix(geometry.a_1, heading, 0.0, up))
    elbow = add(shoulder, mix(geometry.a_2, upper, 0.0, up))
    wrist = add(elbow, mix(geometry.a_3, normal, geometry.d_4, forearm))
    flange = add(wrist, mix(geometry.d_6, approach, 0.0, up))
    return Arm(heading, left, forearm, normal, left_4, approach, column, shoulder, elbow, wrist, flange)


def flange_orientation(joints: Joints) -> Quaternion:
    """Orientation of the flange frame, z away from the arm, in the base frame."""
    shoulder = product(about(3, -joints[1]), about(2, joints[2] + joints[3]))
    wrist = product(product(about(1, -joints[4]), about(2, joints[5])), about(1, -joints[6]))
    return product(product(shoulder, wrist), about(2, 0.5 * math.pi))


def tool(geometry: Geometry, frames: Frames, joints: Joints) -> tuple[Vector, Quaternion]:
    """Position [m] and orientation of O_u in the base frame."""
    orientation = flange_orientation(joints)
    position = add(arm(geometry, joints).flange, turned(orientation, frames.tool_position))
    return position, product(orientation, unit(frames.tool_orientation))


def jacobian(geometry: Geometry, joints: Joints, point: Vector) -> tuple[tuple[Vector, Vector], ...]:
    """Velocity of a point of the flange, and angular velocity, per rate of each joint, in the base frame.

    Args:
        geometry: lengths [m].
        joints: rail [m] and A1 to A6 [rad].
        point: of the flange, in the base frame [m].
    Returns: seven pairs, the columns of the geometric Jacobian: (1, 0) for the rail, (axis x arm, axis) for
        the others.
    """
    parts = arm(geometry, joints)
    down = (0.0, 0.0, -1.0)
    back = (-parts.forearm[0], -parts.forearm[1], -parts.forearm[2])
    inward = (-parts.approach[0], -parts.approach[1], -parts.approach[2])
    turning = (
        (down, parts.column),
        (parts.left, parts.shoulder),
        (parts.left, parts.elbow),
        (back, parts.wrist),
        (parts.left_4, parts.wrist),
        (inward, parts.wrist),
    )
    return (
        ((1.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        *((cross(axis, subtract(point, place)), axis) for axis, place in turning),
    )


def twist(geometry: Geometry, joints: Joints, rates: Joints, point: Vector) -> tuple[Vector, Vector]:
    """Velocity [m/s] of a point of the flange and angular velocity [rad/s], in the base frame."""
    linear, angular = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for rate, (column, axis) in zip(rates, jacobian(geometry, joints, point), strict=True):
        linear, angular = mix(1.0, linear, rate, column), mix(1.0, angular, rate, axis)
    return linear, angular


def in_target(
    frames: Frames, position: Vector, orientation: Quaternion, velocity: Vector, angular_velocity: Vector
) -> tuple[Vector, Quaternion, Vector, Vector]:
    """Pose and twist of O_u in O_t from those in the base frame, Eqs. (14) and (15); O_t is at rest."""
    back = conjugate(unit(frames.target_orientation))
    relative = product(back, orientation)
    # Of the two quaternions of a turn, the one nearer to no turn: a consumer may take its logarithm.
    sign = math.copysign(1.0, relative[0])
    return (
        turned(back, subtract(position, frames.target_position)),
        (sign * relative[0], sign * relative[1], sign * relative[2], sign * relative[3]),
        turned(back, velocity),
        turned(back, angular_velocity),
    )


def in_base(
    frames: Frames, position: Vector, orientation: Quaternion, velocity: Vector, angular_velocity: Vector
) -> tuple[Vector, Quaternion, Vector, Vector]:
    """Pose and twist of O_u in the base frame from those in O_t, Eqs. (14) and (16)."""
    there = unit(frames.target_orientation)
    return (
        add(frames.target_position, turned(there, position)),
        product(there, unit(orientation)),
        turned(there, velocity),
        turned(there, angular_velocity),
    )
