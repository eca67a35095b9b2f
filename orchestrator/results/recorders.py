"""What records the signals of a run, and reads them back."""

from __future__ import annotations

import json
import mmap
from collections.abc import Mapping
from pathlib import Path
from time import monotonic
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import DTypeLike

from ..base.errors import OrchestratorError
from ..fmi import Array, Kind, Point, Value, Variable
from ..system.signal_vector import Layout, Signals
from ..system.system import System
from . import file_formats as formats
from .column_stream import StreamedColumns, StreamWriter, typed
from .recorded_signals import Results

_SECONDS_PER_FLUSH = 1.0
# Rows that are gathered before they go on; half as many of wide systems. StreamWriter likes such numbers.
_ROWS, _WIDE = 1024, 128
_TYPES = {Kind.REAL: np.dtype(np.float64), Kind.BOOLEAN: np.dtype(np.bool_)}
_WHOLE, _UNSIGNED = np.dtype(np.int64), np.dtype(np.uint64)
# Least size for which numpy asks the kernel for huge pages [B].
_HUGE = 1 << 22


def _column_type(variable: Variable) -> np.dtype[Any]:
    return _UNSIGNED if variable.type == "UInt64" else _TYPES.get(variable.kind, _WHOLE)


def _untouched(width: int, points: int) -> Array:
    """An array of small pages, shape (width, points), with any content.

    Huge pages, which numpy asks for, are the dearer ones to touch for the first time where memory is in
    pieces or virtual, and columns that grow side by side touch many at once.
    """
    size = 8 * width * points
    if size < _HUGE or not hasattr(mmap, "MAP_PRIVATE"):
        return np.empty((width, points))
    pages = mmap.mmap(-1, size, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    return np.frombuffer(pages, np.float64).reshape(width, points)


class _Memory:
    """Columns in memory that rows are appended to."""

    def __init__(self, width: int, points: int) -> None:
        self._columns = _untouched(width, points)
        self.rows = 0

    def write(self, first: Array, others: Array) -> None:
        end = self.rows + len(first)
        if end > self._columns.shape[1]:
            grown = _untouched(len(self._columns), max(2 * self._columns.shape[1], end))
            grown[:, : self.rows] = self._columns[:, : self.rows]
            self._columns = grown
        self._columns[0, self.rows : end], self._columns[1:, self.rows : end] = first, others
        self.rows = end

    def columns(self) -> Array:
        """Shape (width, rows): a view, which later rows leave alone."""
        return self._columns[:, : self.rows]


class Recorder:
    """An observer that keeps signals: in memory, or in a file, where memory does not grow with the run.

    The file, an Arrow IPC stream, can be read at any moment up to its last flush, which is at most about a
    second ago, whatever happens to this process.
    """

    def __init__(
        self,
        system: System,
        *,
        every: int = 1,
        path: Path | BinaryIO | None = None,
        points: int = 0,
        parameters: Mapping[str, Value] | None = None,
        provenance: Mapping[str, Any] | None = None,
    ) -> None:
        """
        Args:
            system: what runs.
            every: keep every n-th communication point.
            path: of the file, or an unbuffered binary file open for writing and reading; in memory if None.
            points: how many communication points are expected, if that is known.
            parameters, provenance: go into the file, and are reported with the results.
        Raises: OSError if the file cannot be made; its methods raise OrchestratorError once it cannot be
            written any more.
        """
        layout = Layout.of(system)
        self.names = [str(port) for port in system.recorded]
        self._types = [_column_type(system.variable(port)) for port in system.recorded]
        self.units = {str(port): system.variable(port).unit_name for port in system.recorded}
        self._chosen = layout.recorded
        self._whole = bool(np.array_equal(self._chosen, np.arange(layout.size)))
        self._every = every
        self._about = {"parameters": dict(parameters or {}), "provenance": dict(provenance or {})}
        width = len(self.names) + 1
        self._pending = np.empty((_ROWS if width <= _WIDE else _ROWS // 2, width))
        self._used = 0
        self._flushed = monotonic()
        self._path = path
        self._memory = self._writer = None
        if path is None:
            self._memory = _Memory(width, -(-points // every) or _ROWS)
        else:
            columns: dict[str, DTypeLike] = {formats.TIME: np.float64}
            columns |= dict(zip(self.names, self._types, strict=True))
            about = {formats.ABOUT: json.dumps(formats.strict(self._about), allow_nan=False)}
            self._writer = StreamWriter(path, columns, {formats.TIME: "s", **self.units}, about)

    def __call__(self, point: Point, signals: Signals) -> None:
        """Keep the signals of a point."""
        if self._every != 1 and point.index % self._every:
            return
        row = self._pending[self._used]
        row[0] = point.time
        row[1:] = signals.values if self._whole else signals.values[self._chosen]
        self._used += 1
        self._flush_in_time()

    def observe_block(self, first: int, times: Array, values: Array) -> None:
        """Keep the signals of consecutive points; see BlockObserver."""
        if self._every != 1:
            chosen = slice(-first % self._every, None, self._every)
            times, values = times[chosen], values[chosen]
        if not self._whole:
            values = values[:, self._chosen]
        if len(times) >= len(self._pending):
            self.flush()
            self._write(times, values.T)
            return
        while len(times):
            rows = self._pending[self._used : self._used + len(times)]
            taken = len(rows)
            rows[:, 0], rows[:, 1:] = times[:taken], values[:taken]
            times, values = times[taken:], values[taken:]
            self._used += taken
            self._flush_in_time()

    def _flush_in_time(self) -> None:
        full = self._used == len(self._pending)
        if full or (self._writer is not None and monotonic() - self._flushed > _SECONDS_PER_FLUSH):
            self.flush()

    def flush(self) -> None:
        """Bring the file up to date."""
        if self._used:
            used, self._used = self._used, 0
            self._write(self._pending[:used, 0], self._pending[:used, 1:].T)

    def _write(self, times: Array, columns: Array) -> None:
        try:
            sink = self._writer or self._memory
            assert sink is not None
            sink.write(times, columns)
        except OSError as error:
            raise OrchestratorError(
                f"{self._path}: the results can no longer be written ({error}); those until then are kept"
            ) from error
        self._flushed = monotonic()

    def close(self) -> None:
        """Write the remaining rows and close the file."""
        if self._writer is not None:
            self.flush()
            self._writer.close()

    def results(self) -> Results:
        """What was recorded so far."""
        self.flush()
        if self._path is not None:
            return Results.streamed(StreamedColumns(self._path), **self._about)
        assert self._memory is not None
        time, *columns = self._memory.columns()
        signals = {
            name: column if kind.kind == "f" else typed(column, kind)
            for name, column, kind in zip(self.names, columns, self._types, strict=True)
        }
        return Results(time, signals, self.units, **self._about)


def parameters_of(system: System) -> dict[str, Value]:
    """Parameters as the FMUs declare them, start values as the config gives them, by instance.variable."""
    values: dict[str, Value] = {}
    for instance in system.instances:
        given = {one.name: one.start for one in instance.fmu.description.parameters if one.start is not None}
        values.update(
            {f"{instance.name}.{name}": value for name, value in {**given, **instance.start}.items()}
        )
    return values


def read_results(path: Path | str) -> Results:
    """Read results back, those of a run that goes on or was killed, too.

    Args:
        path: a folder that `orchestrator run --out` wrote, or a file: arrow, csv, parquet, mat or h5. What is
            cut off at its end is left out. Large Arrow files stay on disk; columns are read when asked for.
    Raises: OrchestratorError if it cannot be read.
    """
    path = Path(path)
    parameters: Mapping[str, Value] | None = None
    provenance: Mapping[str, Any] | None = None
    if path.is_dir():
        summary = path / "summary.json"
        if summary.is_file():
            content = json.loads(summary.read_text(encoding="utf-8"))
            parameters, provenance = content.get("parameters", {}), content.get("provenance", {})
        path = path / ("results.arrow" if (path / "results.arrow").is_file() else "results.csv")
    try:
        if path.suffix == ".arrow":
            return Results.streamed(StreamedColumns(path), parameters, provenance)
        time, signals, units, more = formats.read(path)
    except (OSError, ValueError, OrchestratorError) as error:
        raise OrchestratorError(f"{path}: no results can be read from it ({error})") from error
    return Results(
        time,
        signals,
        units,
        more.get("parameters", parameters),
        more.get("provenance", provenance),
    )


load = read_results
