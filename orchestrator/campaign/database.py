"""A store as a database: views in SQL over its parts and over what is still in its journals."""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..base.errors import ConfigError, OrchestratorError, Problem, listed, nearest
from .journal import read_journal
from .store import check_store, journals, number_of, parts
from .tables import TABLES, empty_tables, tables_of

if TYPE_CHECKING:
    import duckdb
    import pyarrow as pa

VIEWS = {
    "sweep": "points of all studies with what their runs gave: the table to begin with",
    "runs": "each run once: status, kind and message of a failure, derived quantities, timing",
    "points": "study, point, repeat, the values that were varied, and the run that they led to",
    "numbers": "run, name, value: all numbers of the summary, `numerics` included",
    "failures": "runs that failed",
    "logs": "run, instance, line: warnings and errors of instances",
    "trajectories": "run, time and signals, where they were recorded",
    "sessions": "when and with what the runs were made",
    "studies": "studies by id: title, system, number of points",
}


# Numbers of a summary that say how a run was computed.
_APART = ("numerics.", "coupling.")


class Store:
    """Reads a store, one that is being written, too.

    Attributes:
        folder: of the store.
        database: the views, in DuckDB.
    """

    def __init__(self, folder: Path | str) -> None:
        """Raises: ConfigError if the folder is no store."""
        # Imported late: it takes 0.2 s.
        import duckdb

        self.folder = Path(folder)
        check_store(self.folder)
        self.database: duckdb.DuckDBPyConnection = duckdb.connect()
        self.studies = _studies(self.folder)
        # Journals first: what becomes a part meanwhile is then read twice, not never.
        waiting = {}
        for path in journals(self.folder):
            with suppress(FileNotFoundError):
                waiting[number_of(path)] = tables_of(read_journal(path))
        closed = parts(self.folder)
        for one in closed:
            waiting.pop(number_of(one), None)
        for name in TABLES:
            self._view(name, closed, [tables[name] for tables in waiting.values() if name in tables])
        self._views()

    def _view(self, name: str, closed: list[Path], waiting: list[pa.Table]) -> None:
        files = [str(part / f"{name}.parquet") for part in closed if (part / f"{name}.parquet").is_file()]
        sources = []
        if files:
            names = ", ".join(_quoted(one) for one in files)
            sources.append(f"select * from read_parquet([{names}], union_by_name=true)")
        for index, table in enumerate(waiting or ([] if files else [empty_tables()[name]])):
            self.database.register(f"_waiting_{name}_{index}", table)
            sources.append(f"select * from _waiting_{name}_{index}")
        self.database.execute(f"create view _{name} as {' union all by name '.join(sources)}")

    def _views(self) -> None:
        run = self.database.execute
        # A run that failed and was made again counts as it is now.
        run(
            "create view runs as select * from _runs "
            "qualify row_number() over (partition by run order by written desc) = 1"
        )
        run("create view failures as select * from runs where status <> 'done'")
        for name in ("numbers", "logs", "trajectories"):
            run(f"create view {name} as select n.* from _{name} n semi join runs using (run, session)")
        run("create view sessions as select * from _sessions")
        files = [str(self.folder / "studies" / study / "points.parquet") for study in self.studies]
        if files:
            names = ", ".join(_quoted(one) for one in files)
            run(f"create view points as select * from read_parquet([{names}], union_by_name=true)")
        else:
            run("create view points as select '' as study, 0 as point, 0 as repeat, '' as run where false")
        run("create view sweep as select p.*, r.* exclude (run) from points p left join runs r using (run)")
        import pyarrow as pa

        rows = [
            {"study": study, "title": about["title"], "system": about["system"], "points": about["points"]}
            for study, about in self.studies.items()
        ]
        kinds = {"study": pa.string(), "title": pa.string(), "system": pa.string(), "points": pa.int64()}
        self.database.register("studies", pa.Table.from_pylist(rows, pa.schema(kinds)))

    def query(self, sql: str) -> pa.Table:
        """The result of a query. Raises: ConfigError if it cannot be answered."""
        import duckdb

        try:
            return self.database.sql(sql).to_arrow_table()
        except (duckdb.Error, AttributeError) as error:
            what = str(error).strip() if isinstance(error, duckdb.Error) else "the query gives no table"
            raise ConfigError([Problem("query", what, f"views: {listed(VIEWS)}")]) from None

    def study(self, name: str | None = None) -> str:
        """The id of a study by its beginning; the latest one if none is given. Raises: ConfigError."""
        if name is None and self.studies:
            return list(self.studies)[-1]
        found = [study for study in self.studies if study.startswith(name or "?")]
        if len(found) == 1:
            return found[0]
        what = f"no study {name!r}" if not found else f"several studies begin with {name!r}"
        raise ConfigError(
            [
                Problem(
                    str(self.folder),
                    what,
                    f"studies: {listed(self.studies)}",
                    nearest(name or "", self.studies),
                )
            ]
        )

    def table(self, study: str | None = None) -> pa.Table:
        """Points of a study with what their runs gave, without what differs from one machine to another.

        The points are read from the study's own file: in the view, columns have the type that fits those of
        all studies, and SQL does not distinguish m.mass from M.mass.
        """
        import pyarrow as pa
        import pyarrow.parquet as pq

        study = self.study(study)
        about = self.studies[study]
        points = pq.ParquetFile(self.folder / "studies" / study / "points.parquet").read()
        points = points.sort_by([("point", "ascending"), ("repeat", "ascending")])
        ends = ("", ".change") if about["step_halving"] else ("",)
        derived = [f"{name}{end}" for name in about["derived"] for end in ends]
        there = {name.casefold() for name in self.database.table("runs").columns}
        columns = ["status", "kind", "message", "halving_error"]
        wanted = [
            # As the study has it: another one of the store may have named it in other letters first.
            f"{_column(name) if name.casefold() in there else 'null::double'} as {_column(name)}"
            for name in (*columns, *derived)
        ]
        runs = points.select(["run"]).append_column("row", pa.array(range(len(points)), pa.int64()))
        self.database.register("_asked", runs)
        try:
            found = self.query(
                f"select {', '.join(wanted)} from _asked left join runs using (run) order by _asked.row"
            )
        finally:
            self.database.unregister("_asked")
        made = {name: points.column(name) for name in ("point", "repeat", "run", *about["axes"])}
        return pa.table(made | dict(zip(found.column_names, found.columns, strict=True)))

    def numbers(self, runs: pa.ChunkedArray) -> dict[str, Any]:
        """Single numbers of the summaries by name, one for each of some runs; not a number where it has none.

        Numbers in lists, of the coupling and of step halving are left out; the view `numbers` holds them.
        """
        import numpy as np

        rows: dict[str, list[int]] = {}
        for row, run in enumerate(runs.to_pylist()):
            rows.setdefault(run, []).append(row)
        found: dict[str, Any] = {}
        for one in self.query("select run, name, value from numbers order by name").to_pylist():
            if one["run"] in rows and "[" not in one["name"] and not one["name"].startswith(_APART):
                column = found.setdefault(one["name"], np.full(len(runs), np.nan))
                column[rows[one["run"]]] = one["value"]
        return found

    def close(self) -> None:
        """Close the database; the store's files are left alone."""
        self.database.close()

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *problem: object) -> None:
        self.close()


def _studies(folder: Path) -> dict[str, dict[str, Any]]:
    found = []
    for path in (folder / "studies").glob("*/study.json"):
        try:
            found.append((path.parent.name, json.loads(path.read_text(encoding="utf-8"))))
        except (OSError, ValueError) as error:
            raise OrchestratorError(f"{path}: cannot be read ({error})") from error
    return dict(sorted(found, key=lambda one: (one[1]["origin"]["created"], one[0])))


def _quoted(text: str) -> str:
    return "'" + text.replace("'", "''") + "'"


def _column(name: str) -> str:
    return '"' + name.replace('"', '""') + '"'
