"""Contacts found in recorded signals, and what is measured of each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..base.arrays import Array


@dataclass(frozen=True)
class Contact:
    """One contact of the rod with a frame.

    Attributes:
        first, last: row indices of the first and last instant with a contact force.
        start_time, end_time: their times [s].
        side: "front" (force on the rod negative) or "rear".
        peak_force: largest absolute force [N].
        velocity_before, velocity_after: free relative velocity of the satellites around the contact [m/s].
        free_before, free_after: row indices of the instants that these are read at.
    """

    first: int
    last: int
    start_time: float
    end_time: float
    side: str
    peak_force: float
    velocity_before: float
    velocity_after: float
    free_before: int
    free_after: int

    @property
    def restitution(self) -> float | None:
        """Coefficient of restitution, Eq. (32), as a ratio; None where the approach speed is zero."""
        return -self.velocity_after / self.velocity_before if self.velocity_before != 0.0 else None


def find_contacts(time: Array, velocity: Array, force: Array, settled: float = 1e-6) -> list[Contact]:
    """Find the completed contacts.

    A contact is a stretch of rows with a force; stretches that follow one another at the same frame belong
    to one contact, since in free flight the rod can only reach the other frame. The free velocity is read
    in the middle of the flight: every delayed or filtered remainder of the last contact has died away
    there, and a controller that predicts has not yet begun to push for the next. So a contact counts as
    complete once the next has begun or, for the last one, once the recording went on at unchanged velocity
    for as long as the contact took.

    Args:
        time: instants, shape (n,) [s].
        velocity: relative velocity of the satellites, shape (n,) [m/s].
        force: contact force on the rod, shape (n,) [N].
        settled: change of the velocity after the last contact, relative to the contact's largest, that still
            counts as none; in space a turning target carries the rod along in free flight.
    Returns: contacts in order of time.
    """
    touching = force != 0.0
    edges = np.flatnonzero(np.diff(touching.astype(np.int8), prepend=0, append=0))
    stretches: list[tuple[int, int, float]] = []
    for first, end in zip(edges[::2], edges[1::2], strict=True):
        last = int(end) - 1
        peak = force[first + int(np.argmax(np.abs(force[first : last + 1])))]
        sign = float(np.sign(peak))
        if stretches and np.sign(stretches[-1][2]) == sign:
            begin, _, earlier = stretches[-1]
            stretches[-1] = (begin, last, max(earlier, float(peak), key=abs))
        else:
            stretches.append((int(first), last, float(peak)))
    contacts = []
    for index, (first, last, peak) in enumerate(stretches):
        before = ((stretches[index - 1][1] if index else 0) + first) // 2
        if index + 1 < len(stretches):
            after = (last + stretches[index + 1][0]) // 2
        elif _has_settled(velocity, first, last, settled):
            after = len(velocity) - 1
        else:
            break
        contacts.append(
            Contact(
                first=first,
                last=last,
                start_time=float(time[first]),
                end_time=float(time[last]),
                side="front" if peak < 0.0 else "rear",
                peak_force=abs(peak),
                velocity_before=float(velocity[before]),
                velocity_after=float(velocity[after]),
                free_before=before,
                free_after=after,
            )
        )
    return contacts


def _has_settled(velocity: Array, first: int, last: int, settled: float) -> bool:
    duration = last - first
    if last + duration >= len(velocity):
        return False
    tail = velocity[last + duration :]
    return bool(np.ptp(tail) <= settled * np.max(np.abs(velocity[first : last + 1])))
