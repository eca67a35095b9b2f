"""Two rigid bodies that float free and push each other: Eqs. (3) to (13) in six degrees of freedom.

A is the service satellite, B the target; sources, frames, signs and misprints: fmus/SatellitePair/README.md.
Matrices are tuples of rows. Only plain arithmetic, since the native form of the FMU is traced from it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from shared.space import Quaternion, Vector, add, conjugate, cross, dot, product, scale, subtract, unit

Matrix = tuple[Vector, Vector, Vector]


class Body(NamedTuple):
    """What of a satellite does not change: mass [kg]; inertia and its inverse in the COG frame [kg.m2]."""

    mass: float
    inertia: Matrix
    inverse: Matrix


class Motion(NamedTuple):
    """Pose and twist, all resolved in the frame that they are given in: [m], [1], [m/s], [rad/s]."""

    position: Vector
    orientation: Quaternion
    velocity: Vector
    angular_velocity: Vector


class Wrench(NamedTuple):
    """Force [N] and torque [N.m] on A about `point` [m], all in B's COG frame, in which they are held."""

    force: Vector
    torque: Vector
    point: Vector


def times(m: Matrix, a: Vector) -> Vector:
    """Matrix times vector."""
    return (dot(m[0], a), dot(m[1], a), dot(m[2], a))


def transposed_times(m: Matrix, a: Vector) -> Vector:
    """Transposed matrix times vector: with a rotation matrix, the vector in body coordinates."""
    return (
        m[0][0] * a[0] + m[1][0] * a[1] + m[2][0] * a[2],
        m[0][1] * a[0] + m[1][1] * a[1] + m[2][1] * a[2],
        m[0][2] * a[0] + m[1][2] * a[1] + m[2][2] * a[2],
    )


def rotation(q: Quaternion) -> Matrix:
    """Rotation matrix R(q) of a unit quaternion: v in the reference frame = R(q) v in body coordinates."""
    w, x, y, z = q
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )


def inverted(m: Matrix) -> Matrix:
    """Inverse of a symmetric matrix, by its cofactors."""
    (a, b, c), (_, d, e), (_, _, f) = m
    aa, bb, cc = d * f - e * e, c * e - b * f, b * e - c * d
    determinant = a * aa + b * bb + c * cc
    dd, ee, ff = a * f - c * c, b * c - a * e, a * d - b * b
    rows = (aa, bb, cc), (bb, dd, ee), (cc, ee, ff)
    return tuple(tuple(entry / determinant for entry in row) for row in rows)  # type: ignore[return-value]


def world_times(m: Matrix, r: Matrix, a: Vector) -> Vector:
    """R m R' a: a body's tensor, as the source's I_O = R I R', times a vector of the global frame."""
    return times(r, times(m, transposed_times(r, a)))


def rates(y: tuple[float, ...], bodies: tuple[Body, Body], start: tuple[Vector, ...], wrench: Wrench) -> Any:
    """Time derivative of what is integrated over a step.

    Newton's and Euler's equations, (6) to (9), for momenta: what A gains, B loses. The wrench (F, M) about
    the sensor's origin r_S, Eqs. (4) and (5), has the moment M + r_S x F about the step's fixed point.

    Args:
        y: positions of A and B from the fixed point [m], their orientations, and the linear [N.s] and
            angular [N.m.s] impulse on A since the step began, the latter about the fixed point; shape (20,).
        start: linear momentum of A and of B, angular momentum of A and of B about the fixed point, all when
            the step began.
    Returns: shape (20,).
    """
    a, b = bodies
    r_a, r_b, impulse, moment = y[0:3], y[3:6], y[14:17], y[17:20]
    q_a, q_b = y[6:10], y[10:14]
    p_a, p_b = add(start[0], impulse), subtract(start[1], impulse)
    r = rotation(q_b)
    omega_a = world_times(a.inverse, rotation(q_a), subtract(add(start[2], moment), cross(r_a, p_a)))
    omega_b = world_times(b.inverse, r, subtract(subtract(start[3], moment), cross(r_b, p_b)))
    force = times(r, wrench.force)
    torque = add(times(r, wrench.torque), cross(add(r_b, times(r, wrench.point)), force))
    turn_a, turn_b = product((0.0, *omega_a), q_a), product((0.0, *omega_b), q_b)
    return (
        *scale(1.0 / a.mass, p_a),
        *scale(1.0 / b.mass, p_b),
        *(0.5 * entry for entry in turn_a),
        *(0.5 * entry for entry in turn_b),
        *force,
        *torque,
    )


def stage(y: tuple[float, ...], step: float, slope: tuple[float, ...]) -> tuple[float, ...]:
    """y + step slope."""
    return tuple(value + step * rate for value, rate in zip(y, slope, strict=True))


def advance(
    bodies: tuple[Body, Body], motions: tuple[Motion, Motion], wrench: Wrench, step_size: float
) -> tuple[Motion, Motion]:
    """Motion of both satellites over a step with a wrench that is constant in B's turning frame.

    The classical Runge-Kutta method of fourth order on positions, orientations and one impulse: B is given
    the opposite of A's, and angular momenta are kept about one point that stays where it is, so the pair's
    linear and angular momentum do not depend on the method's error; they are conserved to rounding.

    Args:
        bodies: A and B.
        motions: of the COG frames of A and B in the global frame when the step begins.
        wrench: on A; B feels the opposite, along the same line.
        step_size: length of the step [s].
    Returns: motions when the step ends.
    """
    a, b = motions
    fixed = b.position
    r_a = subtract(a.position, fixed)
    p_a, p_b = scale(bodies[0].mass, a.velocity), scale(bodies[1].mass, b.velocity)
    spins = tuple(
        world_times(body.inertia, rotation(motion.orientation), motion.angular_velocity)
        for body, motion in zip(bodies, motions, strict=True)
    )
    start = (p_a, p_b, add(spins[0], cross(r_a, p_a)), spins[1])
    y = (*r_a, 0.0, 0.0, 0.0, *a.orientation, *b.orientation, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    k1 = rates(y, bodies, start, wrench)
    k2 = rates(stage(y, 0.5 * step_size, k1), bodies, start, wrench)
    k3 = rates(stage(y, 0.5 * step_size, k2), bodies, start, wrench)
    k4 = rates(stage(y, step_size, k3), bodies, start, wrench)
    slope = tuple((p + 2.0 * (q + r) + s) / 6.0 for p, q, r, s in zip(k1, k2, k3, k4, strict=True))
    y = stage(y, step_size, slope)
    impulse, moment = y[14:17], y[17:20]
    q_a, q_b = unit(y[6:10]), unit(y[10:14])
    spin_a = subtract(add(start[2], moment), cross(y[0:3], add(p_a, impulse)))
    spin_b = subtract(subtract(start[3], moment), cross(y[3:6], subtract(p_b, impulse)))
    return (
        Motion(
            add(fixed, y[0:3]),
            q_a,
            add(a.velocity, scale(1.0 / bodies[0].mass, impulse)),
            world_times(bodies[0].inverse, rotation(q_a), spin_a),
        ),
        Motion(
            add(fixed, y[3:6]),
            q_b,
            subtract(b.velocity, scale(1.0 / bodies[1].mass, impulse)),
            world_times(bodies[1].inverse, rotation(q_b), spin_b),
        ),
    )


def attached(motion: Motion, place: Vector, orientation: Quaternion) -> Motion:
    """Motion of a frame fixed to a body, Eqs. (10) and (11): place and orientation in the COG frame."""
    arm = times(rotation(motion.orientation), place)
    return Motion(
        add(motion.position, arm),
        product(motion.orientation, orientation),
        add(motion.velocity, cross(motion.angular_velocity, arm)),
        motion.angular_velocity,
    )


def relative(of: Motion, to: Motion) -> Motion:
    """Motion of one frame as seen from another, Eqs. (12) and (13).

    Eq. (13) prints T_Ai^-1 T_Bi, which is the opposite; T_Bi^-1 T_Ai is meant, as Eq. (14) needs it. Eq. (12)
    prints v_Ai - v_Bi; the pose of Eq. (13) moves at v_Ai - v_Bi - omega_Bi x (r_Ai - r_Bi).
    """
    r = rotation(to.orientation)
    distance = subtract(of.position, to.position)
    speed = subtract(subtract(of.velocity, to.velocity), cross(to.angular_velocity, distance))
    return Motion(
        transposed_times(r, distance),
        product(conjugate(to.orientation), of.orientation),
        transposed_times(r, speed),
        transposed_times(r, subtract(of.angular_velocity, to.angular_velocity)),
    )


def composed(frame: Motion, within: Motion) -> Motion:
    """The inverse of `relative`: the global motion of what moves as `within` as seen from `frame`."""
    r = rotation(frame.orientation)
    distance = times(r, within.position)
    speed = add(frame.velocity, cross(frame.angular_velocity, distance))
    return Motion(
        add(frame.position, distance),
        product(frame.orientation, within.orientation),
        add(speed, times(r, within.velocity)),
        add(frame.angular_velocity, times(r, within.angular_velocity)),
    )


def detached(motion: Motion, place: Vector, orientation: Quaternion) -> Motion:
    """The inverse of `attached`: motion of the body's COG frame from that of a frame fixed to it."""
    q = product(motion.orientation, conjugate(orientation))
    arm = times(rotation(q), place)
    velocity = subtract(motion.velocity, cross(motion.angular_velocity, arm))
    return Motion(subtract(motion.position, arm), q, velocity, motion.angular_velocity)
