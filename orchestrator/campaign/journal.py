"""Runs as they come in: a file of records that a kill at any moment leaves readable."""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from time import monotonic

# Mark, length of the text, length of the bytes, check sum of both.
_HEAD = struct.Struct("<4sQQI")
_MARK = b"run1"
_SECONDS_PER_SYNC = 1.0


class Journal:
    """A file that records are appended to.

    Each is written by one call, so that a killed process leaves at most one that is cut off; once a second
    the file is brought to the disk, so that a machine that loses power loses at most about that much.

    Attributes:
        size: of the complete records in it [B].
        count: of the records in it.
    """

    def __init__(self, path: Path) -> None:
        """Raises: OSError if the file exists or cannot be made."""
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o644)
        self.path = path
        self.size = self.count = 0
        self._synced = monotonic()

    def append(self, text: bytes, data: bytes = b"") -> None:
        """Add a record. Raises: OSError if it cannot be written whole; those before it are kept."""
        check = zlib.crc32(data, zlib.crc32(text))
        record = memoryview(_HEAD.pack(_MARK, len(text), len(data), check) + text + data)
        written = 0
        try:
            while written < len(record):
                written += os.write(self._file, record[written:])
        except OSError:
            # Back as well: written behind a gap, nothing that comes later would be read.
            os.lseek(self._file, self.size, os.SEEK_SET)
            os.ftruncate(self._file, self.size)
            raise
        self.size += len(record)
        self.count += 1
        if monotonic() - self._synced > _SECONDS_PER_SYNC:
            self.sync()

    def sync(self) -> None:
        """Bring the file to the disk. Raises: OSError."""
        os.fsync(self._file)
        self._synced = monotonic()

    def close(self) -> None:
        """Close the file; nothing of it is lost if that happens twice."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1


def read_journal(path: Path) -> Iterator[tuple[bytes, bytes]]:
    """The complete records of a journal, also of one that is being written: text and bytes of each."""
    with path.open("rb") as file:
        while True:
            head = file.read(_HEAD.size)
            if len(head) < _HEAD.size:
                return
            mark, text_size, data_size, check = _HEAD.unpack(head)
            if mark != _MARK or text_size + data_size > os.fstat(file.fileno()).st_size:
                return  # sizes that are no sizes are not read
            text, data = file.read(text_size), file.read(data_size)
            if len(text) < text_size or len(data) < data_size or zlib.crc32(data, zlib.crc32(text)) != check:
                return
            yield text, data
