"""Result files: CSV, Parquet and MAT. All hold names, units and numbers that read back exactly."""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "FORMATS",
    "csv_header",
    "csv_rows",
    "read",
    "strict",
    "write",
    "write_csv",
    "write_mat",
    "write_parquet",
]

Array = NDArray[Any]
FORMATS = ("csv", "parquet", "mat")
_TIME = "time"
_CSV_BLOCK = 4096


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


def write(
    path: Path,
    time: Array,
    signals: Mapping[str, Array],
    units: Mapping[str, str],
    parameters: Mapping[str, Any],
    provenance: Mapping[str, Any],
) -> None:
    """Write a file in the format of its suffix. Raises: ValueError if there is no such format."""
    if path.suffix == ".csv":
        write_csv(path, time, signals, units)
    elif path.suffix == ".parquet":
        write_parquet(path, time, signals, units, parameters, provenance)
    elif path.suffix == ".mat":
        write_mat(path, time, signals, units, parameters, provenance)
    else:
        raise ValueError(f"no format {path.suffix!r}; formats: {', '.join(FORMATS)}")


def read(path: Path) -> tuple[Array, dict[str, Array], dict[str, str], dict[str, Any]]:
    """Time, signals, units, and further content of a result file.

    Raises: OSError or ValueError if it cannot be read.
    """
    readers = {".csv": _read_csv, ".parquet": _read_parquet, ".mat": _read_mat}
    if path.suffix not in readers:
        raise ValueError(f"no format {path.suffix!r}; formats: {', '.join(FORMATS)}")
    return readers[path.suffix](path)


# CSV


def csv_header(names: Iterable[str], units: Mapping[str, str]) -> str:
    """The header line, for example `time [s],robot.position [m]`."""
    line = io.StringIO()
    labels = [f"{name} [{units[name]}]" if units.get(name) else name for name in names]
    csv.writer(line, lineterminator="\n").writerow([f"{_TIME} [s]", *labels])
    return line.getvalue()


def csv_rows(time: Array, columns: Sequence[Array]) -> str:
    """Lines of numbers; floats as the shortest decimals that read back the same."""
    texts = [map(repr, time.tolist())]
    texts += [
        map(str, column.astype(int).tolist() if column.dtype == bool else column.tolist())
        for column in columns
    ]
    lines = "\n".join(map(",".join, zip(*texts, strict=True)))
    return f"{lines}\n" if lines else ""


def write_csv(path: Path, time: Array, signals: Mapping[str, Array], units: Mapping[str, str]) -> None:
    """Write a CSV file."""
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write(csv_header(signals, units))
        for begin in range(0, len(time), _CSV_BLOCK):
            rows = slice(begin, begin + _CSV_BLOCK)
            file.write(csv_rows(time[rows], [column[rows] for column in signals.values()]))


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


def write_parquet(
    path: Path,
    time: Array,
    signals: Mapping[str, Array],
    units: Mapping[str, str],
    parameters: Mapping[str, Any],
    provenance: Mapping[str, Any],
) -> None:
    """Write a Parquet file."""
    import pyarrow as pa
    import pyarrow.parquet as parquet

    content = {_TIME: time, **signals}
    arrays = {name: pa.array(column) for name, column in content.items()}
    fields = [
        pa.field(name, array.type, metadata={"unit": "s" if name == _TIME else units.get(name, "")})
        for name, array in arrays.items()
    ]
    metadata = {
        "orchestrator": json.dumps(
            strict({"parameters": parameters, "provenance": provenance}), allow_nan=False
        )
    }
    table = pa.table(list(arrays.values()), schema=pa.schema(fields, metadata=metadata))
    parquet.write_table(table, path)


def _read_parquet(path: Path) -> tuple[Array, dict[str, Array], dict[str, str], dict[str, Any]]:
    import pyarrow.parquet as parquet

    table = parquet.read_table(path)
    columns = {name: table.column(name).to_numpy() for name in table.column_names}
    if _TIME not in columns:
        raise ValueError(f"it has no column {_TIME!r}")
    time = columns.pop(_TIME)
    units = {name: (table.field(name).metadata or {}).get(b"unit", b"").decode() for name in columns}
    more = (table.schema.metadata or {}).get(b"orchestrator", b"{}")
    return time, columns, units, json.loads(more)


# MAT


def _identifier(name: str) -> str:
    """A name that MATLAB takes: letters, digits and underscores, 63 at most (the limit of its long names)."""
    name = re.sub(r"\W", "_", name, flags=re.ASCII)
    return (name if re.match(r"[A-Za-z]", name) else f"x{name}")[:63]


def write_mat(
    path: Path,
    time: Array,
    signals: Mapping[str, Array],
    units: Mapping[str, str],
    parameters: Mapping[str, Any],
    provenance: Mapping[str, Any],
) -> None:
    """Write a MATLAB 5 file: `time`, a struct per instance, `units` alike, `names` as in the config."""
    from scipy.io import savemat

    content: dict[str, Any] = {_TIME: time}
    unit_content: dict[str, Any] = {_TIME: "s"}
    names: list[tuple[str, str, str]] = []
    for name, column in signals.items():
        instance, _, variable = name.partition(".")
        group, key = _unused(_identifier(instance), content, (dict,)), _identifier(variable)
        key = _unused(key, content.setdefault(group, {}), ())
        content[group][key] = column
        unit_content.setdefault(group, {})[key] = units.get(name, "")
        names.append((name, group, key))
    content["units"] = unit_content
    content["names"] = json.dumps(names)
    content["run"] = json.dumps(strict({"parameters": parameters, "provenance": provenance}), allow_nan=False)
    savemat(path, content, long_field_names=True, oned_as="column")


def _unused(name: str, taken: Mapping[str, Any], sharing: tuple[type, ...]) -> str:
    """A name that is free, or used for something of a kind that may be shared."""
    candidate, number = name, 1
    reserved = (_TIME, "units", "names", "run") if sharing else ()
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
    return np.atleast_1d(content[_TIME]), signals, units, json.loads(str(content["run"]))
