"""Sizes of logs as they are read: files that expand too far are refused before they fill the memory."""

from __future__ import annotations

import gzip
import io
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ...fmi.archive import LARGEST_EXPANSION

# Of what is read, whatever the size of the file: a text, which takes long to read, and numbers in binary.
SMALLEST_TEXT, SMALLEST_NUMBERS = 16 * 2**20, 256 * 2**20
MOST_COLUMNS = 100_000
_PIECE = 2**20
# Of MAT files of version 5: their header [B], and the type of an element that is compressed.
_MAT_HEADER, _COMPRESSED = 128, 15


class LogError(ValueError):
    """A log that cannot be read; says why, and what would help."""


def check_size(size: int, packed: int, smallest: int = SMALLEST_NUMBERS) -> None:
    """Judge a log by what it expands to.

    Args:
        size: of what is read [B]; packed: of the file, or of its part that `size` comes from [B].
        smallest: what is read of any file [B].
    Raises: LogError.
    """
    if size > max(smallest, LARGEST_EXPANSION * packed):
        raise LogError(
            f"refused, its {packed} bytes expand to {size} or more; at most {LARGEST_EXPANSION} times the "
            f"file, or {smallest} bytes, are accepted. If it is right, store it as plain CSV"
        )


def check_columns(count: int) -> None:
    """Judge a table by the number of its columns. Raises: LogError."""
    if count > MOST_COLUMNS:
        raise LogError(f"refused, it has {count} columns; at most {MOST_COLUMNS} are accepted")


def gunzipped(path: Path) -> bytes:
    """Content of a file packed by gzip. Raises: LogError if it expands too far."""
    pieces, size = [], 0
    with path.open("rb") as packed, gzip.GzipFile(fileobj=packed) as stream:
        while piece := stream.read(_PIECE):
            pieces.append(piece)
            size += len(piece)
            check_size(size, packed.tell(), SMALLEST_TEXT)
    return b"".join(pieces)


def check_mat(path: Path) -> None:
    """Judge a MAT file of version 5 by what its compressed elements expand to. Raises: LogError."""
    size, packed = 0, path.stat().st_size
    for element in _compressed(path):
        unpacker, rest = zlib.decompressobj(), element
        while rest and (piece := unpacker.decompress(rest, _PIECE)):
            size, rest = size + len(piece), unpacker.unconsumed_tail
            check_size(size, packed)


def _compressed(path: Path) -> Iterator[bytes]:
    """The compressed elements of a MAT file; none of other versions."""
    with path.open("rb") as file:
        order = {b"IM": "<", b"MI": ">"}.get(file.read(_MAT_HEADER)[-2:])
        while order is not None and len(tag := file.read(8)) == 8:
            kind, size = struct.unpack(f"{order}II", tag)
            if kind == _COMPRESSED:
                yield file.read(size)
            else:
                file.seek(size, 1)


def check_mcap(path: Path) -> None:
    """Judge an MCAP file by what its chunks expand to, not by what they state. Raises: LogError."""
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader

    size, packed = 0, path.stat().st_size
    with path.open("rb") as stream:
        for record in StreamReader(stream, emit_chunks=True, record_size_limit=packed).records:
            for piece in _unpacked(record) if isinstance(record, Chunk) else ():
                size += len(piece)
                check_size(size, packed)


def _unpacked(chunk: Any) -> Iterator[bytes]:
    """The content of a chunk of an MCAP file, piece by piece."""
    if chunk.compression == "zstd":
        import zstandard

        yield from zstandard.ZstdDecompressor().read_to_iter(chunk.data, write_size=_PIECE)
    elif chunk.compression == "lz4":
        import lz4.frame

        with lz4.frame.open(io.BytesIO(chunk.data)) as stream:
            while piece := stream.read(_PIECE):
                yield piece
    else:
        yield chunk.data
