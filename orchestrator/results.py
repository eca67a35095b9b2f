"""Recorded signals with their units and where they come from."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import formats
from .errors import OrchestratorError, listed, nearest
from .fmi import Array, Kind, Point, Value
from .signals import Layout, Signals
from .system import System

__all__ = ["Recorder", "Results", "read_results"]

_ROWS = 1024
_SECONDS_PER_FLUSH = 1.0


class _Named(dict[str, Any]):
    """A dict that tells what there is when something is asked for that there is not."""

    def __missing__(self, name: str) -> Any:
        raise KeyError(f"no {name!r}; there are {listed(self)}. {nearest(name, self)}".strip())


@dataclass(frozen=True)
class Results:
    """What a run recorded.

    Attributes:
        time: instants, shape (n,) [s].
        signals: by name, instance.variable, each of shape (n,): float64, int64 or bool.
        units: unit of each signal, empty where the FMU declares none.
        parameters: values of all parameters and start values in the FMUs' units.
        provenance: what ran: config, versions, FMU checksums, timing.
    """

    time: Array
    signals: Mapping[str, NDArray[Any]]
    units: Mapping[str, str] = field(default_factory=dict)
    parameters: Mapping[str, Value] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "signals", _Named(self.signals))
        object.__setattr__(self, "parameters", _Named(self.parameters))

    def __getitem__(self, name: str) -> NDArray[Any]:
        """A signal by name. Raises: KeyError naming what there is."""
        return self.signals[name]

    def __len__(self) -> int:
        return len(self.time)

    def write(self, path: Path) -> None:
        """Write a file whose suffix is csv, parquet or mat."""
        formats.write(path, self.time, self.signals, self.units, self.parameters, self.provenance)

    def to_csv(self, path: Path | str) -> None:
        """Write CSV: names and units in the header, numbers as the shortest that read back the same."""
        formats.write_csv(Path(path), self.time, self.signals, self.units)

    def to_parquet(self, path: Path | str) -> None:
        """Write Parquet; units stand in each column's metadata, parameters and provenance in the file's."""
        formats.write_parquet(
            Path(path), self.time, self.signals, self.units, self.parameters, self.provenance
        )

    def to_mat(self, path: Path | str) -> None:
        """Write a MATLAB 5 file: a vector `time` and a struct per instance, and the same again for units."""
        formats.write_mat(Path(path), self.time, self.signals, self.units, self.parameters, self.provenance)


class Recorder:
    """An observer that keeps signals, and streams them to a CSV file if one is given.

    The file can be read at any moment up to the last flush: every 1024 rows or every second, if sooner.
    """

    def __init__(self, system: System, *, every: int = 1, path: Path | None = None) -> None:
        """
        Args:
            system: what runs.
            every: keep every n-th communication point.
            path: of the CSV file.
        Raises: OSError if the file cannot be written.
        """
        layout = Layout.of(system)
        self.names = [str(port) for port in system.recorded]
        self._kinds = [system.variable(port).kind for port in system.recorded]
        self.units = {str(port): system.variable(port).unit_name for port in system.recorded}
        self._columns = layout.recorded
        self._whole = bool(np.array_equal(self._columns, np.arange(layout.size)))
        self._every = every
        self._times: list[Array] = []
        self._values: list[Array] = []
        self._new_block()
        self._file = None
        if path is not None:
            self._file = path.open("w", encoding="utf-8", newline="")
            self._file.write(formats.csv_header(self.names, self.units))
            self._flushed = monotonic()

    def _new_block(self) -> None:
        self._time = np.empty(_ROWS)
        self._block = np.empty((_ROWS, len(self.names)))
        self._used = self._written = 0

    def __call__(self, point: Point, signals: Signals) -> None:
        """Keep the signals of a point."""
        if self._every != 1 and point.index % self._every:
            return
        row = self._used
        self._time[row] = point.time
        self._block[row] = signals.values if self._whole else signals.values[self._columns]
        self._used = row + 1
        if self._used == _ROWS:
            self.flush()
            self._times.append(self._time)
            self._values.append(self._block)
            self._new_block()
        elif self._file is not None and not row & 15 and monotonic() - self._flushed > _SECONDS_PER_FLUSH:
            self.flush()

    def observe_block(self, first: int, times: Array, values: Array) -> None:
        """Keep the signals of consecutive points; see BlockObserver."""
        if self._used:
            self.flush()
            self._times.append(self._time[: self._used])
            self._values.append(self._block[: self._used])
            self._new_block()
        if self._every != 1:
            chosen = slice(-first % self._every, None, self._every)
            times, values = times[chosen], values[chosen]
        if not self._whole:
            values = values[:, self._columns]
        elif self._every != 1:
            values = values.copy()  # a view would keep the rows that are not wanted
        self._times.append(times)
        self._values.append(values)
        self._write(times, values)

    def flush(self) -> None:
        """Bring the file up to date."""
        rows = slice(self._written, self._used)
        self._write(self._time[rows], self._block[rows])
        self._written = self._used

    def _write(self, times: Array, values: Array) -> None:
        if self._file is not None:
            columns = [_typed(column, kind) for column, kind in zip(values.T, self._kinds, strict=True)]
            self._file.write(formats.csv_rows(times, columns))
            self._file.flush()
            self._flushed = monotonic()

    def close(self) -> None:
        """Write what is left and close the file."""
        if self._file is not None:
            self.flush()
            self._file.close()
            self._file = None

    def results(
        self, parameters: Mapping[str, Value] | None = None, provenance: Mapping[str, Any] | None = None
    ) -> Results:
        """What was recorded so far."""
        time = np.concatenate([*self._times, self._time[: self._used]])
        values = np.concatenate([*self._values, self._block[: self._used]])
        signals = {
            name: _typed(np.ascontiguousarray(column), kind)
            for name, column, kind in zip(self.names, values.T, self._kinds, strict=True)
        }
        return Results(time, signals, self.units, parameters or {}, provenance or {})


def _typed(column: Array, kind: Kind) -> NDArray[Any]:
    if kind is Kind.REAL:
        return column
    return column != 0.0 if kind is Kind.BOOLEAN else column.astype(np.int64)


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
    """Read results back.

    Args:
        path: a folder that `orchestrator run --out` wrote, or a file: csv, parquet or mat. A CSV file may be
            one that is still being written, or whose run was killed: a last line that is cut off is dropped.
    Raises: OrchestratorError if it cannot be read.
    """
    path = Path(path)
    parameters: Mapping[str, Value] = {}
    provenance: Mapping[str, Any] = {}
    if path.is_dir():
        summary = path / "summary.json"
        if summary.is_file():
            content = json.loads(summary.read_text(encoding="utf-8"))
            parameters, provenance = content.get("parameters", {}), content.get("provenance", {})
        path = path / "results.csv"
    try:
        time, signals, units, more = formats.read(path)
    except (OSError, ValueError) as error:
        raise OrchestratorError(f"{path}: no results can be read from it ({error})") from error
    return Results(
        time,
        signals,
        units,
        more.get("parameters", parameters),
        more.get("provenance", provenance),
    )
