"""Vectors of three numbers and quaternions as tuples, in plain arithmetic that traces to native code.

Quaternions are (w, x, y, z) and turn a body's coordinates into those of the frame they are given in.
"""

from __future__ import annotations

import math

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

# Keeps quotients finite where a refusal is about to come.
TINY = 1e-9


def add(a: Vector, b: Vector) -> Vector:
    """a + b."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def subtract(a: Vector, b: Vector) -> Vector:
    """a - b."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def scale(factor: float, a: Vector) -> Vector:
    """factor a."""
    return (factor * a[0], factor * a[1], factor * a[2])


def mix(x: float, a: Vector, y: float, b: Vector) -> Vector:
    """x a + y b."""
    return (x * a[0] + y * b[0], x * a[1] + y * b[1], x * a[2] + y * b[2])


def dot(a: Vector, b: Vector) -> float:
    """a . b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vector, b: Vector) -> Vector:
    """a x b."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def product(p: Quaternion, q: Quaternion) -> Quaternion:
    """Quaternion product: first q, then p."""
    return (
        p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3],
        p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
        p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1],
        p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0],
    )


def conjugate(q: Quaternion) -> Quaternion:
    """The opposite rotation."""
    return (q[0], -q[1], -q[2], -q[3])


def length(q: Quaternion) -> float:
    """Length of a quaternion [1]."""
    return math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])


def unit(q: Quaternion) -> Quaternion:
    """The quaternion, scaled to length one."""
    size = max(length(q), TINY)
    return (q[0] / size, q[1] / size, q[2] / size, q[3] / size)


def turned(q: Quaternion, v: Vector) -> Vector:
    """R(q) v for a quaternion of length one."""
    twice = cross((q[1], q[2], q[3]), v)
    twice = (2.0 * twice[0], 2.0 * twice[1], 2.0 * twice[2])
    return add(add(v, mix(q[0], twice, 0.0, twice)), cross((q[1], q[2], q[3]), twice))
