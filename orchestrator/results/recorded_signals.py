"""Recorded signals with their units and where they come from, in memory or on disk."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..base.errors import listed, nearest
from ..fmi import Array, Value
from . import file_formats as formats
from .column_stream import StreamedColumns

if TYPE_CHECKING:
    import pyarrow as pa

# What is no larger than this is read into memory whole [B].
_SMALL = 64 << 20


class _Named(dict[str, Any]):
    """A dict that says what there is when something is asked for that there is not."""

    def __missing__(self, name: str) -> Any:
        raise KeyError(_missing(name, self))


class _Signals(Mapping[str, NDArray[Any]]):
    """All columns but the time's, which stay where they are until they are asked for."""

    def __init__(self, columns: Mapping[str, NDArray[Any]]) -> None:
        self._columns = columns
        self._names = dict.fromkeys(name for name in columns if name != formats.TIME)

    def __getitem__(self, name: str) -> NDArray[Any]:
        if name not in self._names:
            raise KeyError(_missing(name, self._names))
        return self._columns[name]

    def __contains__(self, name: object) -> bool:
        return name in self._names

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


def _missing(name: str, there: Mapping[str, Any]) -> str:
    return f"no {name!r}; there are {listed(there)}. {nearest(name, there)}".strip()


class Results:
    """What a run recorded.

    Attributes:
        signals: by name, instance.variable, each of shape (n,): float64, int64, uint64 or bool. Those of a
            long run stay on disk: each is read when it is asked for, and forgotten when nobody holds it.
        units: unit of each signal, empty where the FMU declares none.
        parameters: values of all parameters and start values in the FMUs' units.
        provenance: what ran: config, versions, FMU checksums, timing.
    """

    def __init__(
        self,
        time: Array,
        signals: Mapping[str, NDArray[Any]],
        units: Mapping[str, str] | None = None,
        parameters: Mapping[str, Value] | None = None,
        provenance: Mapping[str, Any] | None = None,
    ) -> None:
        """
        Args:
            time: instants, shape (n,) [s]; the others: see the attributes.
        """
        self._hold({formats.TIME: time, **signals}, units, parameters, provenance)

    def _hold(
        self,
        columns: Mapping[str, NDArray[Any]],
        units: Mapping[str, str] | None,
        parameters: Mapping[str, Value] | None,
        provenance: Mapping[str, Any] | None,
    ) -> None:
        self._columns = columns
        self.signals: Mapping[str, NDArray[Any]] = _Signals(columns)
        self.units: Mapping[str, str] = units or {}
        self.parameters: Mapping[str, Value] = _Named(parameters or {})
        self.provenance: Mapping[str, Any] = provenance or {}

    @staticmethod
    def streamed(
        columns: StreamedColumns,
        parameters: Mapping[str, Value] | None = None,
        provenance: Mapping[str, Any] | None = None,
    ) -> Results:
        """Results on disk; small ones are read at once.

        Args:
            columns: of the file.
            parameters, provenance: those that the file itself names if not given.
        """
        about = json.loads(columns.metadata.get(formats.ABOUT, "{}"))
        units = {name: unit for name, unit in columns.units.items() if name != formats.TIME}
        small = 8 * columns.rows * len(columns) <= _SMALL
        results = Results.__new__(Results)
        results._hold(
            columns.several(columns) if small else columns,
            units,
            about.get("parameters") if parameters is None else parameters,
            about.get("provenance") if provenance is None else provenance,
        )
        return results

    @property
    def time(self) -> Array:
        """Instants, shape (n,) [s]."""
        return self._columns[formats.TIME]

    def __getitem__(self, name: str) -> NDArray[Any]:
        """A signal by name. Raises: KeyError naming what there is."""
        return self.signals[name]

    def __len__(self) -> int:
        return self._columns.rows if isinstance(self._columns, StreamedColumns) else len(self.time)

    @property
    def types(self) -> dict[str, np.dtype[Any]]:
        """Type of each signal, without reading it."""
        if isinstance(self._columns, StreamedColumns):
            return {name: self._columns.types[name] for name in self.signals}
        return {name: column.dtype for name, column in self.signals.items()}

    def blocks(self) -> Iterator[pa.RecordBatch]:
        """All columns, the time's first, some rows at a time."""
        if isinstance(self._columns, StreamedColumns):
            return self._columns.blocks()
        return formats.blocks(self._columns)

    def chunks(self, rows: int) -> Iterator[dict[str, NDArray[Any]]]:
        """All columns by name, so many rows at a time; the last chunk may be shorter."""
        if not isinstance(self._columns, StreamedColumns):
            for begin in range(0, len(self), rows):
                yield {name: column[begin : begin + rows] for name, column in self._columns.items()}
            return
        import pyarrow as pa

        held: list[pa.RecordBatch] = []
        count = 0
        for block in self._columns.blocks():
            held.append(block)
            count += block.num_rows
            while count >= rows:
                table = pa.Table.from_batches(held)
                yield _arrays(table.slice(0, rows))
                held, count = table.slice(rows).to_batches(), count - rows
        if count:
            yield _arrays(pa.Table.from_batches(held))

    def write(self, path: Path) -> None:
        """Write a file whose suffix is arrow, csv, parquet, mat or h5."""
        formats.write(path, self)

    def to_csv(self, path: Path | str) -> None:
        """Write CSV: names and units in the header, numbers as the shortest that read back the same."""
        formats.write_csv(Path(path), self)

    def to_parquet(self, path: Path | str) -> None:
        """Write Parquet; units stand in each column's metadata, parameters and provenance in the file's."""
        formats.write_parquet(Path(path), self)

    def to_mat(self, path: Path | str) -> None:
        """Write a MATLAB 5 file: a vector `time` and a struct per instance, and the same again for units."""
        formats.write_mat(Path(path), self)

    def to_hdf5(self, path: Path | str) -> None:
        """Write HDF5 (needs h5py): `/time`, a group per instance, units as attributes."""
        formats.write_hdf5(Path(path), self)


def _arrays(table: pa.Table) -> dict[str, NDArray[Any]]:
    return {name: table.column(name).to_numpy() for name in table.column_names}
