"""Vectors of three numbers and unit quaternions, in plain arithmetic."""

from __future__ import annotations

from typing import Any, NamedTuple


class Vector(NamedTuple):
    """A vector in space; adds, and scales with a number."""

    x: float
    y: float
    z: float

    def __add__(self, other: Any) -> Vector:
        return Vector(self.x + other.x, self.y + other.y, self.z + other.z)

    def __sub__(self, other: Vector) -> Vector:
        return Vector(self.x - other.x, self.y - other.y, self.z - other.z)

    def __mul__(self, factor: Any) -> Vector:
        return Vector(self.x * factor, self.y * factor, self.z * factor)

    __rmul__ = __mul__

    def __truediv__(self, divisor: float) -> Vector:
        return Vector(self.x / divisor, self.y / divisor, self.z / divisor)


class Quaternion(NamedTuple):
    """An orientation, scalar first: v_reference = R(q) v_body."""

    w: float
    x: float
    y: float
    z: float


ZERO = Vector(0.0, 0.0, 0.0)
UPRIGHT = Quaternion(1.0, 0.0, 0.0, 0.0)


def dot(a: Vector, b: Vector) -> float:
    """Scalar product."""
    return a.x * b.x + a.y * b.y + a.z * b.z


def cross(a: Vector, b: Vector) -> Vector:
    """Vector product."""
    return Vector(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)


def norm_squared(q: Quaternion) -> float:
    """Squared length of a quaternion."""
    return q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z


def turned(q: Quaternion, v: Vector) -> Vector:
    """R(q) v; the quaternion counts as if it were scaled to unit length."""
    part = Vector(q.x, q.y, q.z)
    return (
        part * (2.0 * dot(part, v)) + v * (q.w * q.w - dot(part, part)) + cross(part, v) * (2.0 * q.w)
    ) / norm_squared(q)


def turned_back(q: Quaternion, v: Vector) -> Vector:
    """R(q)^-1 v."""
    return turned(Quaternion(q.w, -q.x, -q.y, -q.z), v)
