"""Result files: Arrow, CSV, Parquet, MAT and HDF5. All hold names, units and exact numbers."""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Iterable, Iterator, Mapping
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import DTypeLike, NDArray

from ..base.errors import ConfigError, OrchestratorError, Problem, listed, needs
from .column_stream import StreamWriter, arrow_column, numpy_column

if TYPE_CHECKING:
    import h5py
    import pyarrow as pa

Array = NDArray[Any]
FORMATS = ("arrow", "csv", "parquet", "mat", "h5")
TIME = "time"
ABOUT = "orchestrator"  # where Arrow, Parquet and HDF5 files hold parameters and provenance
_ROWS, _ROWS_OF_GROUP = 4096, 1 << 17


def strict(value: Any) -> Any:
    """Plain JSON values: numpy's numbers unpacked, numbers that JSON does not have as null."""
    if isinstance(value, Mapping):
        return {str(key): strict(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [strict(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not np.isfinite(value):
        return None
    if value is None or isinstance(value, bool | int | float | str):
        return value
    return str(value)


def check_formats(names: Iterable[str]) -> tuple[str, ...]:
    """Names of formats, each once. Raises: ConfigError naming those that do not exist."""
    wanted = tuple(dict.fromkeys(name.strip() for name in names if name.strip()))
    unknown = [name for name in wanted if name not in FORMATS]
    if unknown:
        raise ConfigError([Problem("", f"no format {listed(unknown)}", f"formats: {listed(FORMATS)}")])
    if "h5" in wanted and find_spec("h5py") is None:
        raise ConfigError([Problem("", f"format h5 {needs('h5py')}")])
    return wanted


class Recorded(Protocol):
    """What is written: see orchestrator.results.recorders.Results."""

    signals: Mapping[str, NDArray[Any]]
    units: Mapping[str, str]
    parameters: Mapping[str, Any]
    provenance: Mapping[str, Any]

    @property
    def time(self) -> Array:
        """Instants, shape (n,) [s]."""

    @property
    def types(self) -> Mapping[str, np.dtype[Any]]:
        """Type of each signal."""

    def blocks(self) -> Iterator[pa.RecordBatch]:
        """All columns, the time's first, some rows at a time."""


def blocks(columns: Mapping[str, Array]) -> Iterator[pa.RecordBatch]:
    """Columns, shape (n,) each, some rows at a time."""
    import pyarrow as pa

    for begin in range(0, len(next(iter(columns.values()))), _ROWS):
        rows = slice(begin, begin + _ROWS)
        yield pa.RecordBatch.from_pydict({name: arrow_column(one[rows]) for name, one in columns.items()})


def write(path: Path, recorded: Recorded) -> None:
    """Write a file in the format of its suffix. Raises: ValueError if there is no such format."""
    writers = {
        ".arrow": write_arrow,
        ".csv": write_csv,
        ".parquet": write_parquet,
        ".mat": write_mat,
        ".h5": write_hdf5,
    }
    if path.suffix not in writers:
        raise ValueError(f"no format {path.suffix!r}; formats: {', '.join(FORMATS)}")
    writers[path.suffix](path, recorded)


def read(path: Path) -> tuple[Array, dict[str, Array], dict[str, str], dict[str, Any]]:
    """Time, signals, units, and further content of a result file, other than of Arrow files.

    Raises: OSError or ValueError if it cannot be read; OrchestratorError if a package is missing for it.
    """
    readers = {".csv": _read_csv, ".parquet": _read_parquet, ".mat": _read_mat, ".h5": _read_hdf5}
    if path.suffix not in readers:
        raise ValueError(f"no format {path.suffix!r}; formats: {', '.join(FORMATS)}")
    return readers[path.suffix](path)


# Arrow


def write_arrow(path: Path, recorded: Recorded) -> None:
    """Write an Arrow IPC stream."""
    about = {"parameters": recorded.parameters, "provenance": recorded.provenance}
    units = {TIME: "s", **recorded.units}
    types: dict[str, DTypeLike] = {TIME: np.float64, **recorded.types}
    writer = StreamWriter(path, types, units, {ABOUT: json.dumps(strict(about), allow_nan=False)})
    for block in recorded.blocks():
        time, *columns = (numpy_column(one) for one in block.columns)
        writer.write(time, columns)
    writer.close()


# CSV


def write_csv(path: Path, recorded: Recorded) -> None:
    """Write a CSV file; floats as the shortest decimals that read back the same, flags as 0 and 1."""
    import pyarrow as pa
    from pyarrow import csv as arrow_csv

    options = arrow_csv.WriteOptions(include_header=False)
    with path.open("wb") as file:
        file.write(_csv_header(recorded.signals, recorded.units).encode())
        for block in recorded.blocks():
            columns = [one.cast(pa.int8()) if pa.types.is_boolean(one.type) else one for one in block.columns]
            arrow_csv.write_csv(pa.RecordBatch.from_arrays(columns, block.schema.names), file, options)


def _csv_header(names: Iterable[str], units: Mapping[str, str]) -> str:
    """The header line, for example `time [s],robot.position [m]`."""
    line = io.StringIO()
    labels = [f"{name} [{units[name]}]" if units.get(name) else name for name in names]
    csv.writer(line, lineterminator="\n").writerow([f"{TIME} [s]", *labels])
    return line.getvalue()


def _read_csv(path: Path) -> tuple[Array, dict[str, Array], dict[str, str], dict[str, Any]]:
    text = path.read_text(encoding="utf-8")
    text = text[: text.rfind("\n") + 1]  # a line that is not whole belongs to a run that was killed
    header, _, body = text.partition("\n")
    labels = next(csv.reader([header]), [])
    if not labels:
        raise ValueError("it has no header")
    named = [re.fullmatch(r"(.*?)(?: \[([^\[\]]*)\])?", label) for label in labels]
    names = [match[1] for match in named if match]
    units = {match[1]: match[2] or "" for match in named[1:] if match}
    if body:
        values = np.loadtxt(io.StringIO(body), delimiter=",", ndmin=2, comments=None)
    else:
        values = np.zeros((0, len(names)))
    if values.shape[1] != len(names):
        raise ValueError(f"{values.shape[1]} columns under {len(names)} names")
    columns = dict(zip(names[1:], np.ascontiguousarray(values.T[1:]), strict=True))
    return np.ascontiguousarray(values[:, 0]), columns, units, {}


# Parquet


def write_parquet(path: Path, recorded: Recorded) -> None:
    """Write a Parquet file."""
    import pyarrow as pa
    import pyarrow.parquet as parquet

    about = {"parameters": recorded.parameters, "provenance": recorded.provenance}
    types = {TIME: np.dtype(np.float64), **recorded.types}
    fields = [
        pa.field(
            name,
            pa.from_numpy_dtype(kind),
            metadata={"unit": "s" if name == TIME else recorded.units.get(name, "")},
        )
        for name, kind in types.items()
    ]
    schema = pa.schema(fields, metadata={ABOUT: json.dumps(strict(about), allow_nan=False)})
    with parquet.ParquetWriter(path, schema) as writer:
        gathered: list[pa.RecordBatch] = []
        rows = 0
        for block in recorded.blocks():
            gathered.append(pa.RecordBatch.from_arrays(block.columns, schema=schema))
            rows += block.num_rows
            if rows >= _ROWS_OF_GROUP:
                writer.write_table(pa.Table.from_batches(gathered, schema))
                gathered, rows = [], 0
        if gathered:
            writer.write_table(pa.Table.from_batches(gathered, schema))


def _read_parquet(path: Path) -> tuple[Array, dict[str, Array], dict[str, str], dict[str, Any]]:
    import pyarrow.parquet as parquet

    table = parquet.read_table(path)
    columns = {name: table.column(name).to_numpy() for name in table.column_names}
    if TIME not in columns:
        raise ValueError(f"it has no column {TIME!r}")
    time = columns.pop(TIME)
    units = {name: (table.field(name).metadata or {}).get(b"unit", b"").decode() for name in columns}
    more = (table.schema.metadata or {}).get(ABOUT.encode(), b"{}")
    return time, columns, units, json.loads(more)


# MAT


def _identifier(name: str) -> str:
    """A name that MATLAB takes: letters, digits and underscores, 63 at most (the limit of its long names)."""
    name = re.sub(r"\W", "_", name, flags=re.ASCII)
    return (name if re.match(r"[A-Za-z]", name) else f"x{name}")[:63]


def write_mat(path: Path, recorded: Recorded) -> None:
    """Write a MATLAB 5 file: `time`, a struct per instance, `units` likewise, `names` as in the config."""
    from scipy.io import savemat

    about = {"parameters": recorded.parameters, "provenance": recorded.provenance}
    content: dict[str, Any] = {TIME: recorded.time}
    unit_content: dict[str, Any] = {TIME: "s"}
    names: list[tuple[str, str, str]] = []
    for name, column in recorded.signals.items():
        instance, _, variable = name.partition(".")
        group, key = _unused(_identifier(instance), content, (dict,)), _identifier(variable)
        key = _unused(key, content.setdefault(group, {}), ())
        content[group][key] = column
        unit_content.setdefault(group, {})[key] = recorded.units.get(name, "")
        names.append((name, group, key))
    content["units"] = unit_content
    content["names"] = json.dumps(names)
    content["run"] = json.dumps(strict(about), allow_nan=False)
    savemat(path, content, long_field_names=True, oned_as="column")


def _unused(name: str, taken: Mapping[str, Any], sharing: tuple[type, ...]) -> str:
    """A name that is free, or used for something of a kind that may be shared."""
    candidate, number = name, 1
    reserved = (TIME, "units", "names", "run") if sharing else ()
    while candidate in reserved or (candidate in taken and not isinstance(taken[candidate], sharing)):
        number += 1
        candidate = f"{name[:60]}_{number}"
    return candidate


def _read_mat(path: Path) -> tuple[Array, dict[str, Array], dict[str, str], dict[str, Any]]:
    from scipy.io import loadmat

    content = loadmat(path, simplify_cells=True)
    if "names" not in content:
        raise ValueError("it was not written by this package")
    signals, units = {}, {}
    for name, group, key in json.loads(str(content["names"])):
        signals[name] = np.atleast_1d(content[group][key])
        units[name] = str(content["units"][group][key]) if len(content["units"][group][key]) else ""
    return np.atleast_1d(content[TIME]), signals, units, json.loads(str(content["run"]))


# HDF5


def _h5py() -> ModuleType:
    """Raises: OrchestratorError if it is not installed."""
    try:
        import h5py
    except ImportError as error:
        raise OrchestratorError(f"HDF5 {needs(error.name or 'h5py')}") from None
    return h5py


def write_hdf5(path: Path, recorded: Recorded) -> None:
    """Write an HDF5 file: `/time`, a group per instance, and the unit as attribute of each dataset.

    Raises: OrchestratorError without h5py.
    """
    about = {"parameters": recorded.parameters, "provenance": recorded.provenance}
    rows = len(recorded.time)
    with _h5py().File(path, "w", track_order=True) as file:
        file.attrs[ABOUT] = json.dumps(strict(about), allow_nan=False)
        made = [file.create_dataset(TIME, (rows,), np.float64)]
        made[0].attrs["unit"] = "s"
        for name, kind in recorded.types.items():
            one = file.create_dataset(_inside(file, name), (rows,), kind)
            one.attrs.update(name=name, unit=recorded.units.get(name, ""), place=len(made))
            made.append(one)
        first = 0
        for block in recorded.blocks():
            for one, column in zip(made, block.columns, strict=True):
                one[first : first + block.num_rows] = numpy_column(column)
            first += block.num_rows


def _inside(file: h5py.File, name: str) -> str:
    """Where a signal stands: `instance/variable`, with underscores for slashes, and after what is taken."""
    instance, dot, variable = name.replace("/", "_").partition(".")
    while instance in file and (not dot or not hasattr(file[instance], "keys")):
        instance += "_"
    while dot and f"{instance}/{variable}" in file:
        variable += "_"
    return instance + dot.replace(".", "/") + variable


def _read_hdf5(path: Path) -> tuple[Array, dict[str, Array], dict[str, str], dict[str, Any]]:
    with _h5py().File(path) as file:
        if ABOUT not in file.attrs:
            raise ValueError("it was not written by this package")
        found: list[tuple[int, str, Array, str]] = []

        def visit(_: str, node: h5py.Dataset | h5py.Group) -> None:
            if "place" in node.attrs:
                kept = node.attrs
                found.append((int(kept["place"]), str(kept["name"]), node[()], str(kept["unit"])))

        file.visititems(visit)
        found.sort(key=lambda one: one[0])
        signals = {name: values for _, name, values, _ in found}
        units = {name: unit for _, name, _, unit in found}
        return file[TIME][()], signals, units, json.loads(file.attrs[ABOUT])
