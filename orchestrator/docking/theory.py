"""The ideal contact: a free mass on a spring-damper that only pushes, without delay or lag."""

from __future__ import annotations

import math


def contact_frequency(stiffness: float, mass: float) -> float:
    """Frequency of the contact oscillation [Hz], Eq. (31): f = sqrt(k_d/m_e)/(2 pi).

    Args:
        stiffness: contact stiffness k_d [N/m], > 0.
        mass: effective mass m_e [kg], > 0.
    Raises: ValueError if either is not positive.
    """
    _require_positive(stiffness, mass)
    return math.sqrt(stiffness / mass) / (2.0 * math.pi)


def ideal_restitution(stiffness: float, damping: float, mass: float) -> float:
    """Coefficient of restitution of the ideal contact, which ends where the force falls to zero.

    With zeta = c/(2 sqrt(k m)), the force m x'' returns to zero at omega_d t = 2 arccos(zeta), which gives
    CoR = exp(-2 zeta arccos(zeta)/sqrt(1 - zeta^2)); beyond critical damping arccos turns into arcosh.
    The frame is left before the penetration is back at zero, so this is above exp(-pi zeta/sqrt(1 - zeta^2)).

    Args:
        stiffness: k [N/m], > 0.
        damping: c [N.s/m], >= 0.
        mass: effective mass [kg], > 0.
    Raises: ValueError if an argument is out of range.
    """
    zeta = _damping_ratio(stiffness, damping, mass)
    return math.exp(-zeta * _end_phase_over_frequency(zeta))


def ideal_peak_force(stiffness: float, damping: float, mass: float, speed: float) -> float:
    """Largest force of the ideal contact [N]: v sqrt(k m) without damping.

    The force m v omega exp(-zeta omega t) sin(omega_d t + 2 phi)/cos(phi), phi = arcsin(zeta), is
    largest at omega_d t = pi/2 - 3 phi, or at onset (c v) where that is negative (zeta > 1/2).

    Args:
        stiffness: k [N/m], > 0.
        damping: c [N.s/m], >= 0.
        mass: effective mass [kg], > 0.
        speed: approach speed [m/s]; its sign does not matter.
    Raises: ValueError if an argument is out of range.
    """
    zeta = _damping_ratio(stiffness, damping, mass)
    if zeta >= 0.5:
        return damping * abs(speed)
    phase = (math.pi / 2.0 - 3.0 * math.asin(zeta)) / math.sqrt(1.0 - zeta * zeta)
    return abs(speed) * math.sqrt(stiffness * mass) * math.exp(-zeta * phase)


def _damping_ratio(stiffness: float, damping: float, mass: float) -> float:
    _require_positive(stiffness, mass)
    if not damping >= 0.0:
        raise ValueError(f"damping must not be negative, got {damping!r} N.s/m")
    return damping / (2.0 * math.sqrt(stiffness * mass))


def _require_positive(stiffness: float, mass: float) -> None:
    if not stiffness > 0.0:
        raise ValueError(f"stiffness must be positive, got {stiffness!r} N/m")
    if not mass > 0.0:
        raise ValueError(f"mass must be positive, got {mass!r} kg")


def _end_phase_over_frequency(zeta: float) -> float:
    """omega_n times the duration of the contact."""
    gap = 1.0 - zeta
    if abs(gap) < 1e-8:
        return 2.0  # limit of both branches, whose quotients are 0/0 here
    if gap > 0.0:
        return 2.0 * math.acos(zeta) / math.sqrt(1.0 - zeta * zeta)
    return 2.0 * math.acosh(zeta) / math.sqrt(zeta * zeta - 1.0)
