"""Columns on disk while they are being recorded: an Arrow IPC stream, readable up to its last block.

A block is one message, written by one call, so that a process that is killed leaves whole blocks and at most
one that is cut off. Any reader of Arrow streams (pandas, polars, R, Julia) reads such a file, too.
"""

from __future__ import annotations

import mmap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import DTypeLike, NDArray

if TYPE_CHECKING:
    import pyarrow as pa

Array = NDArray[Any]
_END = b"\xff\xff\xff\xff\0\0\0\0"  # how an Arrow stream ends
# Blocks of a multiple of so many rows fill whole 64-byte words in every type, flags included.
_EVEN = 512
# A reader gives back the memory of the file that it has looked at after about so much of it [B].
_RELEASED_EVERY = 4 << 20
# Columns that are read ahead take no more memory than this [B].
_AHEAD = 32 << 20


class StreamWriter:
    """A file that columns are appended to."""

    def __init__(
        self,
        file: Path | BinaryIO,
        columns: Mapping[str, DTypeLike],
        units: Mapping[str, str],
        metadata: Mapping[str, str] | None = None,
    ) -> None:
        """
        Args:
            file: a path, or an unbuffered binary file open for writing and reading. What was at the path is
                removed, not overwritten: results that were read from it may still map its memory.
            columns: type of each column: float64, int64 or bool.
            units: of the columns that have one.
            metadata: texts that the file carries.
        Raises: OSError if the file cannot be written.
        """
        # Imported late: it takes longer than a short run.
        import pyarrow as pa

        self._types = [np.dtype(kind) for kind in columns.values()]
        fields = [
            pa.field(name, pa.from_numpy_dtype(kind), nullable=False, metadata={"unit": units.get(name, "")})
            for (name, kind) in columns.items()
        ]
        self._schema = pa.schema(fields, metadata=dict(metadata or {}))
        self._named = isinstance(file, Path)
        if isinstance(file, Path):
            file.unlink(missing_ok=True)
            file = file.open("xb+", buffering=0)
        self.file = file
        self.rows = 0
        self._broken = False
        self._rows_of_frame, self._frame = 0, np.empty(0, np.uint8)
        self._slots: list[NDArray[np.uint8]] = []
        self._put(self._schema.serialize())

    def write(self, first: Array, others: Array | Sequence[Array]) -> None:
        """Append rows, in one block.

        Args:
            first: the first column, shape (n,).
            others: shape (k - 1, n), in any layout; whole numbers and flags as floats, too.
        Raises: OSError if they cannot be written; what was written before stays readable.
        """
        count, columns = len(first), (first, *others)
        if not count:
            return
        if count % _EVEN or not self._framed(count):
            made = [typed(one, kind) for one, kind in zip(columns, self._types, strict=True)]
            self._put(self._batch(made))
        else:
            # A tenth of what pyarrow takes to put the same bytes together.
            for column, kind, slot in zip(columns, self._types, self._slots, strict=True):
                if kind == np.bool_:
                    slot[:] = np.packbits(column != 0.0, bitorder="little")
                else:
                    slot.view(kind)[:] = typed(column, kind)
            self._put(self._frame.data)
        self.rows += count

    def _batch(self, columns: Sequence[Array]) -> pa.Buffer:
        import pyarrow as pa

        arrays = [arrow_column(one) for one in columns]
        return pa.RecordBatch.from_arrays(arrays, schema=self._schema).serialize()

    def _framed(self, count: int) -> bool:
        """Have a message of so many rows at hand, to be filled in; whether that can be."""
        import pyarrow as pa

        if count != self._rows_of_frame:
            message = self._batch([np.zeros(count, kind) for kind in self._types])
            sizes = [count // 8 if kind == np.bool_ else count * kind.itemsize for kind in self._types]
            if pa.ipc.read_message(message).body.size != sum(sizes):
                return False
            self._frame = np.frombuffer(message, np.uint8).copy()
            ends = (len(self._frame) - sum(sizes) + np.cumsum([0, *sizes])).tolist()
            self._slots = [self._frame[begin:end] for begin, end in pairwise(ends)]
            self._rows_of_frame = count
        return True

    def _put(self, data: Any) -> None:
        if self._broken:
            return
        self._broken = True  # after half a block nothing may follow
        view = memoryview(data).cast("B")
        while len(view):
            view = view[self.file.write(view) :]
        self._broken = False

    def close(self) -> None:
        """Mark the end. A file that was given, not named, stays open."""
        if not self.file.closed:
            self._put(_END)
            if self._named:
                self.file.close()


def typed(column: Array, kind: np.dtype[Any]) -> Array:
    """A column of floats as one of flags, or of whole numbers within the range of their type.

    The largest whole number of 64 bits is, as a float, one more than the type holds: it is brought back.
    """
    if kind == np.bool_:
        return column != 0.0
    if kind.kind not in "iu" or column.dtype.kind != "f":
        return np.ascontiguousarray(column, kind)
    largest = np.iinfo(kind).max
    beyond = column >= float(largest)
    if not beyond.any():
        return np.ascontiguousarray(column, kind)
    whole = np.where(beyond, 0.0, column).astype(kind)
    whole[beyond] = largest
    return whole


class StreamedColumns(Mapping[str, Array]):
    """The columns of such a file, each read when it is asked for, and forgotten when nobody holds it.

    A pass over the file costs in proportion to its width, however few columns it reads. So columns that are
    asked for one after another are read ahead: twice as many in each pass, up to a fixed size in memory.

    Attributes:
        rows: of the complete blocks in the file.
        units, types: of the columns.
        metadata: texts that the file carries.
    """

    def __init__(self, file: Path | BinaryIO) -> None:
        """
        Args:
            file: a path or an open binary file. A last block that is cut off is left out.
        Raises: OSError or ValueError if it cannot be read.
        """
        if isinstance(file, Path):
            with file.open("rb") as opened:
                self._memory = _mapped(opened)
        else:
            self._memory = _mapped(file)
        schema = self._reader(None).schema
        self._names = tuple(schema.names)
        self.units = {one.name: (one.metadata or {}).get(b"unit", b"").decode() for one in schema}
        self.metadata = {key.decode(): text.decode() for key, text in (schema.metadata or {}).items()}
        self.types = {name: _numpy_type(schema.field(name)) for name in self._names}
        self._number = {name: number for number, name in enumerate(self._names)}
        self._held: WeakValueDictionary[str, Array] = WeakValueDictionary()
        # Columns that were read ahead, the number of the next one to read, how many the last pass read.
        self._ahead: dict[str, Array] = {}
        self._next, self._latest = 0, 0
        self.rows = sum(batch.num_rows for batch in self._batches([0]))

    def __getitem__(self, name: str) -> Array:
        column = self._held.get(name)
        if column is None:
            column = self._ahead.pop(name, None)
        if column is None:
            column = self._read(self._number[name])
        self._held[name] = column
        return column

    def _read(self, number: int) -> Array:
        """A column by its number; those behind it are read ahead where the reads are in order."""
        wanted = 2 * self._latest if number == self._next else 1
        count = max(min(wanted, _AHEAD // (8 * max(self.rows, 1)), len(self._names) - number), 1)
        columns = self.several(self._names[number : number + count])
        self._next, self._latest = number + count, count
        column = columns.pop(self._names[number])
        self._ahead = columns
        return column

    def several(self, names: Iterable[str]) -> dict[str, Array]:
        """Columns by name, in one pass over the file. Raises: KeyError for one that there is not."""
        # The reader gives columns in the file's order.
        numbers = sorted(self._number[name] for name in dict.fromkeys(names))
        chosen = [self._names[number] for number in numbers]
        columns = [np.empty(self.rows, self.types[name]) for name in chosen]
        end = 0
        for batch in self._batches(numbers):
            begin, end = end, end + batch.num_rows
            for column, part in zip(columns, batch.columns, strict=True):
                column[begin:end] = numpy_column(part)
        return dict(zip(chosen, columns, strict=True))

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def blocks(self) -> Iterator[pa.RecordBatch]:
        """All columns, block by block as they were written."""
        return self._batches(None)

    def _reader(self, numbers: Sequence[int] | None) -> pa.RecordBatchStreamReader:
        import pyarrow as pa

        chosen = {} if numbers is None else {"included_fields": numbers}
        return pa.ipc.open_stream(pa.py_buffer(self._memory), options=pa.ipc.IpcReadOptions(**chosen))

    def _batches(self, numbers: Sequence[int] | None) -> Iterator[pa.RecordBatch]:
        import pyarrow as pa

        reader, seen = self._reader(numbers), 0
        while True:
            try:
                batch = reader.read_next_batch()
            except StopIteration:
                break
            except (pa.ArrowInvalid, OSError):  # what a killed run left of its last block
                break
            seen += 8 * batch.num_rows * len(self._names)
            yield batch
            if seen >= _RELEASED_EVERY:
                self._release()
                seen = 0
        self._release()

    def _release(self) -> None:
        """Count the file's pages no longer as this process's memory; they come back when they are touched."""
        if hasattr(self._memory, "madvise"):
            self._memory.madvise(mmap.MADV_DONTNEED)


def arrow_column(values: Array) -> pa.Array:
    """A column of numbers or flags, shape (n,). `pa.array` would import pandas, which is slow."""
    import pyarrow as pa

    flags = values.dtype == np.bool_
    data = np.packbits(values, bitorder="little") if flags else np.ascontiguousarray(values)
    kind = pa.from_numpy_dtype(values.dtype)
    return pa.Array.from_buffers(kind, len(values), [None, pa.py_buffer(data)])


def numpy_column(column: pa.Array) -> Array:
    """Numbers or flags of a column, shape (n,). See `arrow_column`."""
    if column.null_count:
        return column.to_numpy(zero_copy_only=False)
    data, begin, end = column.buffers()[1], column.offset, column.offset + len(column)
    kind = _numpy_type(column)
    if kind == np.bool_:
        return np.unpackbits(np.frombuffer(data, np.uint8), count=end, bitorder="little")[begin:].view(
            np.bool_
        )
    return np.frombuffer(data, kind, count=end)[begin:]


def _numpy_type(field: pa.Field | pa.Array) -> np.dtype[Any]:
    name = str(field.type)
    return np.dtype({"float": "float32", "halffloat": "float16"}.get(name, name))


def _mapped(file: BinaryIO) -> mmap.mmap:
    return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
