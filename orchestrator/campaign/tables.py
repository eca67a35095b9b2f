"""Records of a journal -> tables in Arrow, for the parts on disk and for what is still in a journal."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pyarrow as pa

TABLES = ("runs", "numbers", "logs", "trajectories", "sessions")

_RUNS = {
    "run": "string",
    "session": "string",
    "status": "string",
    "kind": "string",
    "message": "string",
    "halving_error": "string",
    "attempts": "int32",
    "seconds": "float64",
    "written": "float64",
    "loop": "string",
    "steps": "int64",
    "simulated_time": "float64",
    "wall_time": "float64",
    "stepping_time": "float64",
}
_OTHERS = {
    "numbers": {"run": "string", "session": "string", "name": "string", "value": "float64"},
    "logs": {"run": "string", "session": "string", "instance": "string", "line": "string"},
    "trajectories": {"run": "string", "session": "string", "time": "float64"},
    "sessions": {"session": "string", "study": "string", "created": "string", "about": "string"},
}
# Names that quantities of a study cannot have.
RESERVED = frozenset({*_RUNS, "study", "point", "repeat"})


def _schema(columns: Mapping[str, str]) -> pa.Schema:
    import pyarrow as pa

    return pa.schema([pa.field(name, pa.type_for_alias(kind)) for name, kind in columns.items()])


def empty_tables() -> dict[str, pa.Table]:
    """Tables without rows."""
    return {name: _schema(columns).empty_table() for name, columns in {"runs": _RUNS, **_OTHERS}.items()}


def tables_of(records: Iterable[tuple[bytes, bytes]]) -> dict[str, pa.Table]:
    """The tables of records; those that nothing is in are left out."""
    import pyarrow as pa

    rows: dict[str, list[dict[str, Any]]] = {name: [] for name in TABLES}
    derived: dict[str, None] = {}
    streams: list[pa.Table] = []
    for text, data in records:
        record = json.loads(text)
        if "run" not in record:
            rows["sessions"].append(record)
            continue
        row, names = record["row"], {"run": record["run"], "session": record["session"]}
        values = {**(row.get("derived") or {})}
        values |= {f"{name}.change": value for name, value in (row.get("changes") or {}).items()}
        derived |= dict.fromkeys(values)
        rows["runs"].append(
            {
                **names,
                **{key: record[key] for key in ("status", "attempts", "seconds", "written")},
                **{key: row.get(key) or "" for key in ("kind", "message", "halving_error")},
                **(row.get("timing") or {}),
                **values,
            }
        )
        rows["numbers"] += [{**names, "name": n, "value": v} for n, v in (row.get("numbers") or {}).items()]
        for instance, lines in (row.get("log") or {}).items():
            rows["logs"] += [{**names, "instance": instance, "line": line} for line in lines]
        if data:
            streams.append(_named(data, names))
    made = {}
    schemas = {"runs": _schema(_RUNS | dict.fromkeys(derived, "float64"))}
    schemas |= {name: _schema(columns) for name, columns in _OTHERS.items()}
    for name, found in rows.items():
        if found:
            made[name] = pa.Table.from_pylist(found, schemas[name])
    if streams:
        made["trajectories"] = pa.concat_tables(streams, promote_options="default")
    return made


def _named(data: bytes, names: Mapping[str, str]) -> pa.Table:
    import pyarrow as pa

    table = pa.ipc.open_stream(data).read_all()
    columns = {key: pa.repeat(pa.scalar(text), len(table)) for key, text in names.items()}
    columns |= {name: table.column(name) for name in table.column_names}
    return pa.table(columns)
