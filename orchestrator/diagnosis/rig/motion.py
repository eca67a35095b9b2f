"""Contacts and phases of motion in a run's log, detected in the measured force."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from .rig import IN_CONTACT
from .study import Array, Run, Study

# The rig's stop: runs that leave this way end there [m].
STOP = 0.08

# Force that counts as a push, in standard deviations of the sensor's noise, and where its flanks end.
_PUSH, _FLANK = 10.0, 5.0
# Flight that parts two contacts, and what a window holds of it before and after at most [ticks].
_APART, _BEFORE, _AFTER = 20, 60, 40
# The robot reaches the wall before the delayed sensor reading [ticks].
_ONSET = 5


class Phase(IntEnum):
    """Phases of motion; onset is the first few milliseconds of a contact, compression ends at its peak."""

    FLIGHT = 0
    ONSET = 1
    COMPRESSION = 2
    RESTITUTION = 3


@dataclass(frozen=True)
class Contact:
    """A contact and the flight around it, in ticks.

    Attributes:
        begin, end: of the window with the flight before and after; `end` is excluded.
        first, last: with a push; peak: of the force.
    """

    begin: int
    first: int
    peak: int
    last: int
    end: int


def contacts(study: Study, run: Run) -> list[Contact]:
    """Completed contacts of a run, in order of time; their windows do not overlap.

    Pushes less than 20 ticks apart, as in a chattering release, count as one. A sensor that does not come
    back to rest, as with hysteresis, parts none: then it counts where the robot is beyond the frames.
    (`docking.contacts` reads signals without noise, where any force is a contact.)
    """
    noise = max(study.nominal["force_noise"].value, study.nominal["force_resolution"].value)
    # The reading at rest: contacts may take up most of a run, but not three quarters.
    size = np.abs(run["sensor_force"])
    rest = np.median(run["sensor_force"][size <= np.quantile(size, 0.25)])
    force = np.abs(run["sensor_force"] - rest)
    pushes, flanks = max(_PUSH * noise, IN_CONTACT), max(_FLANK * noise, 0.5 * IN_CONTACT)
    found = _windows(force, force > pushes, force > flanks)
    if found:
        return found
    position = run["encoder_position"]
    front, rear = (study.nominal[name].value for name in ("front_wall", "rear_wall"))
    beyond = (position > front) | (position < rear)
    return _windows(force, beyond, beyond)


def _windows(force: Array, pushes: Array, flanks: Array) -> list[Contact]:
    """Contacts from where the rod pushes for certain, and where it may; all of shape (n,)."""
    ticks = np.flatnonzero(pushes)
    if not ticks.size:
        return []
    spans = []
    for part in np.split(ticks, np.flatnonzero(np.diff(ticks) > _APART) + 1):
        first, last = int(part[0]), int(part[-1])
        while first > 0 and flanks[first - 1]:
            first -= 1
        while last + 1 < len(force) and flanks[last + 1]:
            last += 1
        spans.append((first, int(part[np.argmax(force[part])]), last))
    found = []
    edge = 0
    for number, (first, peak, last) in enumerate(spans):
        after = spans[number + 1][0] if number + 1 < len(spans) else len(force)
        end = min(last + 1 + _AFTER, (last + 1 + after) // 2 if number + 1 < len(spans) else after)
        begin = max(first - _BEFORE, edge)
        if first - begin >= _ONSET and end - last > _ONSET:
            found.append(Contact(begin, first, peak, last, end))
        edge = end
    return found


def phases(study: Study, run: Run) -> np.ndarray:
    """Phase of each tick, by `Phase`, shape (n,)."""
    found = np.full(len(run), int(Phase.FLIGHT))
    for one in contacts(study, run):
        found[one.first : one.peak + 1] = Phase.COMPRESSION
        found[one.first - _ONSET : one.first + _ONSET] = Phase.ONSET
        found[one.peak + 1 : one.last + 1] = Phase.RESTITUTION
    return found


def stopped_at(position: Array) -> int:
    """First tick at which a position [m], shape (n,), is at the rig's stop; n if it stays within."""
    beyond = np.flatnonzero(~(np.abs(position) < STOP))
    return int(beyond[0]) if beyond.size else len(position)
