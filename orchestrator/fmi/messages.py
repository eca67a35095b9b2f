"""Messages between an isolated instance and its process: a length, a kind, and bytes.

Calls are rare and pickled; steps are frequent and packed. The process runs code of the FMU with the user's
rights: isolation guards against accidents, not against malice, and pickles are no further risk.
"""

from __future__ import annotations

import os
import struct

CALL, STEP = b"C", b"S"
# Answers: a value, an error, a finished step, a finished step with new log lines.
VALUE, ERROR, DONE, NEWS = b"V", b"E", b"D", b"N"

_HEAD = struct.Struct("<Qc")
# Of a step: index, time, step size, whether inputs follow.
STEP_HEAD = struct.Struct("<qdd?")


def send(descriptor: int, kind: bytes, payload: bytes = b"") -> None:
    """Write a message. Raises: OSError if the other side is gone."""
    data = memoryview(_HEAD.pack(len(payload), kind) + payload)
    while data:
        data = data[os.write(descriptor, data) :]


def receive(descriptor: int) -> tuple[bytes, bytes]:
    """Read a message: its kind and its payload. Raises: EOFError if the other side is gone."""
    length, kind = _HEAD.unpack(_read(descriptor, _HEAD.size))
    return kind, _read(descriptor, length)


def _read(descriptor: int, length: int) -> bytes:
    data = os.read(descriptor, min(length, 1 << 20)) if length else b""
    if len(data) == length:
        return data
    parts = bytearray(data)
    while data and len(parts) < length:
        data = os.read(descriptor, min(length - len(parts), 1 << 20))
        parts += data
    if len(parts) < length:
        raise EOFError
    return bytes(parts)
