"""What is wrong with masses, inertia tensors and orientations of bodies: whether, and as a sentence.

Both are told at once: the native form of an FMU asks at run time.
"""

from __future__ import annotations

import math

from shared.free_bodies import Matrix
from shared.space import Quaternion, length

# Numbers written with seven digits pass, a quaternion that was meant otherwise does not.
LENGTH_TOLERANCE = 1e-6
# Of the trace: what is left when a tensor is turned into another frame in double precision, with room.
INERTIA_TOLERANCE = 1e-9


def inertia_problem(name: str, m: Matrix) -> tuple[bool, str]:
    """What is wrong with an inertia tensor [kg.m2], whether and as a sentence."""
    (a, b, c), (d, e, f), (g, h, i) = m
    allowed = INERTIA_TOLERANCE * (abs(a) + abs(e) + abs(i))
    if not (max(abs(b - d), abs(c - g), abs(f - h)) <= allowed):
        return True, (
            f"{name} is not symmetric: [1,2], [1,3], [2,3] are {b!r}, {c!r}, {f!r} kg.m2 and [2,1], [3,1], "
            f"[3,2] are {d!r}, {g!r}, {h!r} kg.m2; give both of a pair the same value"
        )
    trace = a + e + i
    if not _positive_definite(a, b, c, e, f, i):
        return True, (
            f"{name} is not positive definite: diagonal {a!r}, {e!r}, {i!r} kg.m2, [1,2], [1,3], [2,3] "
            f"{b!r}, {c!r}, {f!r} kg.m2; its three principal moments have to be above 0 kg.m2"
        )
    # Principal values of trace/2 E - I are half the excess of two principal moments over the third.
    half = (0.5 + INERTIA_TOLERANCE) * trace
    if not _positive_definite(half - a, -b, -c, half - e, -f, half - i):
        return True, (
            f"{name} violates the triangle inequality: diagonal {a!r}, {e!r}, {i!r} kg.m2, [1,2], [1,3], "
            f"[2,3] {b!r}, {c!r}, {f!r} kg.m2; no principal moment of a body is above the sum of the "
            "other two"
        )
    return False, ""


def _positive_definite(a: float, b: float, c: float, d: float, e: float, f: float) -> bool:
    """Whether ((a, b, c), (b, d, e), (c, e, f)) has positive leading minors."""
    minor = a * d - b * b
    determinant = a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d)
    return (a > 0.0) & (minor > 0.0) & (determinant > 0.0)


def length_problem(name: str, q: Quaternion) -> tuple[bool, str]:
    """What is wrong with a quaternion, whether and as a sentence."""
    size = length(q)
    if abs(size - 1.0) <= LENGTH_TOLERANCE:
        return False, ""
    return True, (
        f"{name} has the length {size!r}; allowed: 1 within {LENGTH_TOLERANCE!r}; divide its elements "
        f"{q[0]!r}, {q[1]!r}, {q[2]!r}, {q[3]!r} by it"
    )


def mass_problem(name: str, mass: float) -> tuple[bool, str]:
    """What is wrong with a mass, whether and as a sentence."""
    if math.isfinite(mass) & (mass > 0.0):
        return False, ""
    return True, f"{name} is {mass!r} kg; a finite mass above 0 kg is needed"


def appended(wrong: bool, bad: bool, sentence: str) -> str:
    """What a list of problems grows by; the native form asks at run time whether it does."""
    if not bad:
        return ""
    if wrong:
        return "; " + sentence
    return sentence


def finite_problem(name: str, unit: str, values: tuple[float, ...]) -> tuple[bool, str]:
    """What of a tuple is no finite number, whether and as a sentence."""
    sound = True
    for value in values:
        sound = sound & math.isfinite(value)
    if sound:
        return False, ""
    given = ", ".join(repr(value) for value in values)
    return True, f"{name} is {given} {unit}; finite numbers are needed"
