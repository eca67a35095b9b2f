"""What travels: a header and float64 values, little-endian, one datagram each way per communication step."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntFlag

import numpy as np

from ...fmi import Array

# Mark, flags, number of values, sender's session, sequence, time [s], sender's clock [ns], the clock that it
# last received [ns].
_HEADER = struct.Struct("<4sHHQQdQQ")
_MARK = b"OCU1"
# What fits into one UDP datagram over IPv4, beside IP's and UDP's own headers.
LARGEST = (65507 - _HEADER.size) // 8


class Flag(IntFlag):
    """What a datagram says besides its values."""

    NONE = 0
    HELLO = 1  # the sender is there, and has no values yet
    END = 2  # the sender's run is over


@dataclass(frozen=True)
class Datagram:
    """A datagram.

    Attributes:
        session: a number that the sender drew for its run: what an earlier run sent is not taken for it.
        sequence: number of the communication step that ended, from 1; 0 in a hello.
        time: of the sender's simulation, at the beginning of that step [s].
        stamp: the sender's clock when it sent this [ns].
        echo: the latest stamp that the sender had received [ns]; 0: none.
        values: shape (n,).
    """

    flags: Flag
    session: int
    sequence: int
    time: float
    stamp: int
    echo: int
    values: Array


def pack(one: Datagram) -> bytes:
    """The bytes of a datagram."""
    header = _HEADER.pack(
        _MARK, int(one.flags), len(one.values), one.session, one.sequence, one.time, one.stamp, one.echo
    )
    return header + np.ascontiguousarray(one.values, "<f8").tobytes()


def unpack(data: bytes) -> Datagram | None:
    """The datagram of bytes; None for what is none, since anybody may send anything to a port."""
    if len(data) < _HEADER.size or data[:4] != _MARK:
        return None
    _, flags, count, session, sequence, time, stamp, echo = _HEADER.unpack_from(data)
    if len(data) != _HEADER.size + 8 * count or flags > 3:
        return None
    values = np.frombuffer(data, "<f8", count, _HEADER.size).astype(np.float64)
    return Datagram(Flag(flags), session, sequence, time, stamp, echo, values)
