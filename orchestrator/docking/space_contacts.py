"""Contacts of a run in six degrees of freedom, seen along the surface normal."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import Polynomial

from .contacts import Contact, find_contacts
from .options import SpaceOptions
from .space_signals import Array, stacked, tip_velocity

if TYPE_CHECKING:
    from ..results.recorders import Results

# Of a free flight: there every remainder of the last contact has died away, and no prediction has begun.
_MIDDLE = (0.25, 0.75)


@dataclass(frozen=True)
class SpaceContacts:
    """Contacts of a run, seen along the surface normal.

    Attributes:
        velocity: of the satellite's rod tip along the way to the front surface, shape (n,) [m/s].
        force: contact force on the rod along the same way, shape (n,) [N]; negative at the front frame.
        found: the completed contacts. Their velocities are those of the free flights around them where the
            contact begins and ends: the target turns, so that even in free flight the velocity seen from it
            changes (by 0.5 % between the middle of a flight and its end in `docking-6d`).
    """

    velocity: Array
    force: Array
    found: list[Contact]

    @classmethod
    def of(cls, results: Results, options: SpaceOptions) -> SpaceContacts:
        """Find the contacts of a run."""
        way = -_normal(results, options)
        velocity = tip_velocity(results, options.satellites, _vector(results, options.contact, "tip")) @ way
        force = stacked(results, f"{options.contact}.force") @ way
        found = find_contacts(results.time, velocity, force, settled=math.inf)
        whole, before = [], 0
        for one in found:
            later = np.flatnonzero(force[one.last + 1 :])
            # The flight after the last contact may be cut off by the recording: its latter half counts then.
            end = one.last + 1 + int(later[0]) if later.size else 2 * len(velocity) - one.last
            speeds = (
                _in_flight(results.time, velocity, before, one.first, one.first),
                _in_flight(results.time, velocity, one.last, end, one.last),
            )
            whole.append(replace(one, velocity_before=speeds[0], velocity_after=speeds[1]))
            before = one.last
        return cls(velocity, force, whole)


def _in_flight(time: Array, velocity: Array, begin: int, end: int, row: int) -> float:
    """Velocity [m/s] at a row, from a parabola through the middle of the free flight between two rows."""
    low, high = (begin + round(part * (end - begin)) for part in _MIDDLE)
    rows = slice(low, min(high, len(time) - 1) + 1)
    degree = min(2, rows.stop - rows.start - 1)
    return float(Polynomial.fit(time[rows], velocity[rows], degree)(time[row]))


def _vector(results: Results, instance: str, name: str, size: int = 3) -> Array:
    return np.array([results.parameters[f"{instance}.{name}[{index}]"] for index in range(1, size + 1)])


def _normal(results: Results, options: SpaceOptions) -> Array:
    normal = _vector(results, options.contact, "normal")
    return normal / np.linalg.norm(normal)
