"""Logs of rigs and robots: CSV, Parquet, MAT, HDF5, MCAP and ROS bags, as named signals.

Tables have one time for all columns; recordings of messages have the time of each message. A number in a
message is named by its topic and its path, as in `/joint_states.position[0]`.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...base.arrays import Array
from ...base.errors import needs
from ...base.units import known_unit
from .log_sizes import LogError, check_columns, check_mat, check_mcap, check_size, gunzipped

_NUMBER = re.compile(r"[+-]?(\d+[.,]?\d*|[.,]\d+)([eE][+-]?\d+)?")


@dataclass(frozen=True)
class Signal:
    """A logged signal.

    Attributes:
        values: shape (n,).
        unit: as the log names it; "" if it does not.
        time: of each value [s], of recordings of messages; None in tables.
        written: what stands in each row, of columns that do not hold numbers only; None for others.
        line: of the file in which the first row stands; None where it is not known.
        flaw: why the signal cannot be taken although it is there; "" if it can.
    """

    values: Array
    unit: str = ""
    time: Array | None = None
    written: Sequence[Any] | None = None
    line: int | None = None
    flaw: str = ""


def read_log(path: Path) -> dict[str, Signal]:
    """All numeric signals of a log, by name. Raises: LogError if it cannot be read."""
    suffix = "".join(path.suffixes[-2:]) if path.suffix == ".gz" else path.suffix
    reader = _rosbag if path.is_dir() else _READERS.get(suffix.lower())
    if reader is None:
        raise LogError(f"no reader for {suffix or 'a file without suffix'}; there are {', '.join(_READERS)}")
    try:
        return reader(path)
    except LogError:
        raise
    except ImportError as error:
        raise LogError(needs(error.name or str(error))) from None
    except Exception as error:  # whatever a reader trips over in a damaged file
        if path.is_dir():
            what = f"is a folder, and no ROS bag ({error}); name a file, of {', '.join(_READERS)}"
            raise LogError(what) from None
        raise LogError(f"cannot be read: {error}") from None


def name_and_unit(header: str) -> tuple[str, str]:
    """Name and unit of a header like `force [N]`; `opening [1]` has the unit 1, `q[1]` is an element.

    What stands in parentheses counts if it is a unit, as in `force (N)`; `pressure (absolute)` has none.
    """
    match = re.fullmatch(r"\s*(.+?)(?:\s*\[([^\[\]]*[^\[\]\d][^\[\]]*)\]|\s+\[(1)\])\s*", header)
    if match:
        return match[1], match[2] or match[3]
    match = re.fullmatch(r"\s*(.+?)\s+\(([^()]*[^()\d\s][^()]*)\)\s*", header)
    if match and known_unit(match[2]) is not None:
        return match[1], match[2]
    return header.strip(), ""


def _table(table: Any, line: int | None = None) -> dict[str, Signal]:
    """Columns of a table, the first row of which stands in a line of the file."""
    import pyarrow as pa

    found: dict[str, Signal] = {}
    for header, field, column in zip(table.column_names, table.schema, table.columns, strict=True):
        name, unit = name_and_unit(header)
        kept = field.metadata or {}
        unit = unit or kept.get(b"unit", b"").decode()
        if name in found:
            flaw = f"several columns are called {name}; give each a name of its own in the log's header"
            found[name] = replace(found[name], flaw=flaw)
        elif pa.types.is_timestamp(field.type):
            found[name] = Signal(_since_first(column), "s", line=line)
        elif pa.types.is_integer(field.type) or pa.types.is_floating(field.type):
            found[name] = Signal(column.to_numpy().astype(float), unit, line=line)
        else:
            # Text and dates are no numbers; a signal with a word in it is still one, and reported as such.
            written = column.to_pylist()
            values = np.array([_number(one) for one in written], float)
            found[name] = Signal(values, unit, written=written, line=line)
    return found


def _since_first(stamps: Any) -> Array:
    """Dates with times as seconds since the first of them: since any epoch digits would be lost."""
    values = stamps.to_numpy().astype("datetime64[ns]")
    if not len(values):
        return np.zeros(0)
    since = (values - values[0]) / np.timedelta64(1, "s")
    return np.where(np.isnat(values), math.nan, since)


def _number(value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        return math.nan


def _csv(path: Path) -> dict[str, Signal]:
    import pyarrow.csv

    raw = gunzipped(path) if path.suffix == ".gz" else path.read_bytes()
    first = raw.partition(b"\n")[0]
    # Units hold commas as little as names do: the most frequent one in the header separates the columns.
    delimiter = max(",;\t", key=lambda one: first.count(one.encode()))
    check_columns(1 + first.count(delimiter.encode()))
    names = [
        name_and_unit(one.strip('"'))[0] for one in first.decode(errors="replace").strip().split(delimiter)
    ]
    if names and all(_NUMBER.fullmatch(one) for one in names):
        first = ", ".join(names[:4])
        raise LogError(
            f"has numbers in its first line ({first}); write the columns' names there: `force [N],...`"
        )
    options = pyarrow.csv.ParseOptions(delimiter=delimiter)
    try:
        table = pyarrow.csv.read_csv(pyarrow.BufferReader(raw), parse_options=options)
    except pyarrow.ArrowInvalid as error:
        hint = ""
        if delimiter == "," and re.search(r"\d,\d+,", str(error)):
            hint = "; if its numbers have decimal commas, separate the columns by ; and write points"
        raise LogError(f"cannot be read: {error}{hint}") from None
    if not len(table):
        raise LogError("holds a header, and no rows below it")
    # Empty lines are skipped, and quoted text may hold ends of lines. Row numbers then differ from lines.
    plain = b'"' not in raw and len(table) == raw.rstrip().count(b"\n")
    return _table(table, 2 if plain else None)


def _parquet(path: Path) -> dict[str, Signal]:
    import pyarrow.parquet

    with pyarrow.parquet.ParquetFile(path) as file:
        check_columns(file.metadata.num_columns)
        check_size(8 * file.metadata.num_rows * file.metadata.num_columns, path.stat().st_size)
        return _table(file.read())


def _mat(path: Path) -> dict[str, Signal]:
    from scipy.io import loadmat

    check_mat(path)
    try:
        content = loadmat(path, squeeze_me=True, struct_as_record=False)
    except NotImplementedError:
        return _hdf5(path)  # version 7.3 of the format is HDF5
    found: dict[str, Signal] = {}

    def visit(name: str, value: Any) -> None:
        if hasattr(value, "_fieldnames"):
            for one in value._fieldnames:
                visit(f"{name}.{one}", getattr(value, one))
        else:
            _add(found, name, np.asarray(value))

    for name, value in content.items():
        if not name.startswith("__"):
            visit(name, value)
    return found


def _hdf5(path: Path) -> dict[str, Signal]:
    import h5py

    found: dict[str, Signal] = {}
    size, packed = 0, path.stat().st_size

    def visit(name: str, node: Any) -> None:
        nonlocal size
        if isinstance(node, h5py.Dataset) and node.dtype.kind in "iufb":
            unit = next((node.attrs[key] for key in ("unit", "units", "Unit") if key in node.attrs), "")
            size += 8 * node.size
            check_size(size, packed)
            text = unit.decode() if isinstance(unit, bytes) else str(unit)
            _add(found, name.replace("/", "."), np.squeeze(node[()]), text)

    with h5py.File(path) as file:
        file.visititems(visit)
    return found


def _add(found: dict[str, Signal], name: str, values: np.ndarray, unit: str = "") -> None:
    """Add a series, or each of the shorter side of a table of numbers, from 0."""
    if values.dtype.kind not in "iufb":
        return
    if values.ndim == 1:
        found[name] = Signal(values.astype(float), unit)
    elif values.ndim == 2:
        columns = values if values.shape[0] >= values.shape[1] else values.T
        for index in range(columns.shape[1]):
            found[f"{name}[{index}]"] = Signal(np.ascontiguousarray(columns[:, index], float), unit)


def _mcap(path: Path) -> dict[str, Signal]:
    from mcap.reader import make_reader

    check_mcap(path)
    with path.open("rb") as stream:
        return _recorded(_decoded(make_reader(stream)))


def _decoded(reader: Any) -> Iterator[tuple[str, int, Any]]:
    decoders: dict[int, Callable[[bytes], Any]] = {}
    for schema, channel, message in reader.iter_messages():
        if channel.id not in decoders:
            decoders[channel.id] = _decoder(schema, channel)
        yield channel.topic, message.log_time, decoders[channel.id](message.data)


def _decoder(schema: Any, channel: Any) -> Callable[[bytes], Any]:
    if channel.message_encoding == "json":
        return json.loads
    if channel.message_encoding in ("cdr", "ros1") and schema is not None:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        store = get_typestore(Stores.EMPTY)
        name = schema.name if "/msg/" in schema.name else schema.name.replace("/", "/msg/")
        store.register(get_types_from_msg(schema.data.decode(), name))
        read = store.deserialize_cdr if channel.message_encoding == "cdr" else store.deserialize_ros1
        return lambda data: read(data, name)
    raise LogError(
        f"topic {channel.topic}: messages are encoded as {channel.message_encoding!r}; "
        "json, cdr and ros1 can be read"
    )


def _rosbag(path: Path) -> dict[str, Signal]:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    def messages() -> Iterator[tuple[str, int, Any]]:
        with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as reader:
            for connection, stamp, raw in reader.messages():
                yield connection.topic, stamp, reader.deserialize(raw, connection.msgtype)

    return _recorded(messages())


def _recorded(messages: Iterator[tuple[str, int, Any]]) -> dict[str, Signal]:
    """Signals of messages, at the log's stamps; stamps in headers are numbers like others."""
    series: dict[str, tuple[list[int], list[float]]] = {}
    for topic, stamp, message in messages:
        for name, value in _numbers(topic, message):
            times, values = series.setdefault(name, ([], []))
            times.append(stamp)
            values.append(value)
    if not series:
        return {}
    begin = min(times[0] for times, _ in series.values())
    # Differences of whole nanoseconds: as floats, absolute ones would be rounded to a quarter microsecond.
    return {
        name: Signal(np.array(values), "", (np.array(times) - begin) * 1e-9)
        for name, (times, values) in series.items()
    }


def _numbers(name: str, value: Any) -> Iterator[tuple[str, float]]:
    if isinstance(value, bool | int | float | np.number):
        yield name, float(value)
    elif isinstance(value, Mapping):
        for key, item in value.items():
            yield from _numbers(f"{name}.{key}", item)
    elif isinstance(value, list | tuple | np.ndarray):
        for index, item in enumerate(value):
            yield from _numbers(f"{name}[{index}]", item)
    elif hasattr(value, "__dataclass_fields__"):
        for key in value.__dataclass_fields__:
            if not key.startswith("__"):
                yield from _numbers(f"{name}.{key}", getattr(value, key))


_READERS: dict[str, Callable[[Path], dict[str, Signal]]] = {
    ".csv": _csv,
    ".csv.gz": _csv,
    ".parquet": _parquet,
    ".mat": _mat,
    ".h5": _hdf5,
    ".hdf5": _hdf5,
    ".mcap": _mcap,
    ".bag": _rosbag,
}
