"""The sub-commands `sweep` and `store list | show | query | export`."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..base.errors import ConfigError, Problem

if TYPE_CHECKING:
    import pyarrow as pa

    from ..campaign.database import Store
    from ..campaign.sweep import Swept

_SWEEP = """Run a system at many points: a study file names the system, the design over any of its
config's values, and the quantities of each run. Runs that the store holds already are not made again: the
same command goes on where it stopped. A run that fails is kept with its reason, and the others go on."""
_ROWS = 40


def add_sweep_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `orchestrator sweep`."""
    parser.description = _SWEEP
    parser.add_argument("study", type=Path, metavar="STUDY.yaml", help="the study")
    parser.add_argument("--store", type=Path, metavar="DIR", help="where the runs are kept; made if need be")
    parser.add_argument("--out", help=argparse.SUPPRESS)  # as `run` has it: answered by a hint
    parser.add_argument(
        "--jobs", type=int, metavar="N", help="processes; as many as there are cores by default"
    )
    parser.add_argument(
        "--scheduler", metavar="tcp://HOST:PORT", help="a Dask cluster that makes the runs (extra `cluster`)"
    )
    parser.add_argument("--check", action="store_true", help="check the study, and run nothing")
    parser.add_argument(
        "--retry-failed", action="store_true", help="make runs again that the store holds as failed"
    )
    parser.add_argument("--json", action="store_true", help="print what the sweep came to as JSON")
    parser.add_argument("--quiet", action="store_true", help="print errors only")


def sweep_main(args: argparse.Namespace) -> int:
    """Make the runs of a study.

    Returns: 0 if every point has its run, failures among them; 1 if all runs failed.
    """
    from ..campaign.sweep import Study, sweep
    from ..fmi.workers import pool_of
    from ..results.progress import counting

    problems: list[Problem] = []
    unchecked: tuple[str, ...] = ()
    study = pool = None
    if args.jobs is not None and args.jobs < 1:
        problems.append(Problem("--jobs", f"got {args.jobs}", "at least 1"))
    if args.out is not None:
        remedy = f"Did you mean --store {args.out}?"
        problems.append(
            Problem("--out", "is no option of sweep", "--store DIR, where the runs are kept", remedy)
        )
    elif args.store is None and not args.check:
        problems.append(Problem("--store", "is missing", "a folder; it is made if need be"))
    try:
        study = Study.load(args.study)
    except ConfigError as error:
        problems += error.problems
        unchecked = error.unchecked
    try:
        pool = None if args.check else pool_of(args.scheduler, args.jobs)
    except ConfigError as error:
        problems += error.problems
    if problems or study is None:
        raise ConfigError(problems, unchecked)
    notes = (
        [] if study.model.step_halving else ["step_halving is off: changes at half the step are not reported"]
    )
    if args.check:
        if not args.quiet:
            print(
                f"{study.name}: {len(study)} points over {', '.join(study.axes) or 'nothing'}",
                *notes,
                sep="\n",
            )
        return 0
    with counting(len(study), study.name, "run", not args.quiet) as report:
        swept = sweep(
            study,
            args.store,
            pool=pool,
            retry_failed=args.retry_failed,
            progress=lambda done, of, failed: report(done, of, f"{failed} failed" if failed else ""),
        )
    if args.json:
        print(json.dumps(swept.data() | {"step_halving": study.model.step_halving}, ensure_ascii=False))
    elif not args.quiet:
        print("\n".join([_outcome(swept), *notes]))
    runs = swept.made + swept.reused
    return 1 if runs and sum(swept.failed.values()) == runs else 0


def _outcome(swept: Swept) -> str:
    failed = sum(swept.failed.values())
    lines = [
        f"{swept.points} points: {swept.made} runs made, {swept.reused} found in the store, {failed} failed; "
        f"{swept.seconds:.1f} s"
    ]
    for kind, count in swept.failed.most_common():
        example = swept.examples.get(kind, "")
        lines.append(f"  {kind}: {count}" + (f", for example: {example.splitlines()[0]}" if example else ""))
    lines.append(
        f"study {swept.study} in {swept.store}; look at it by `orchestrator store show {swept.store}`"
    )
    return "\n".join(lines)


def add_store_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `orchestrator store`."""
    commands = parser.add_subparsers(dest="part", required=True, metavar="list|show|query|export")
    listing = commands.add_parser("list", help="studies in a store, and what their runs came to")
    show = commands.add_parser("show", help="one study: its points and quantities; or one run")
    query = commands.add_parser("query", help="an SQL query (DuckDB) over the store's views")
    export = commands.add_parser("export", help="write views as files")
    for one in (listing, show, query, export):
        one.add_argument("store", type=Path, metavar="DIR", help="what `sweep --store` was given")
    show.add_argument(
        "of", nargs="?", metavar="STUDY|RUN", help="beginning of an id; the latest study by default"
    )
    query.add_argument(
        "sql", metavar="SQL", help='for example "select kind, count(*) from failures group by kind"'
    )
    for one in (listing, show, query):
        one.add_argument("--json", action="store_true", help="print JSON")
    query.add_argument("--csv", action="store_true", help="print CSV")
    export.add_argument("--out", type=Path, required=True, metavar="DIR", help="where to; made if need be")
    export.add_argument("--format", default="csv", metavar="LIST", help="formats: csv, parquet")
    export.add_argument(
        "--views",
        default="sweep",
        metavar="LIST",
        help="views to write; sweep by default, trajectories for signals",
    )


def store_main(args: argparse.Namespace) -> int:
    """Look at a store. Returns: 0."""
    from ..campaign.database import Store

    with Store(args.store) as store:
        return {"list": _list, "show": _show, "query": _query, "export": _export}[args.part](store, args)


def _list(store: Store, args: argparse.Namespace) -> int:
    table = store.query(
        "select study, any_value(s.title) as title, any_value(s.system) as system, "
        "any_value(s.points) as points, "
        "count(*) filter (w.status = 'done') as done, count(*) filter (w.status = 'failed') as failed "
        "from studies s left join sweep w using (study) group by study order by study"
    )
    _print(table, args.json)
    return 0


def _show(store: Store, args: argparse.Namespace) -> int:
    runs = (
        store.query(f"select run from runs where starts_with(run, {_text(args.of or '?')})")
        .column(0)
        .to_pylist()
    )
    if len(runs) != 1:
        study = store.study(args.of)
        if not args.json:
            about = store.studies[study]
            print(f"{study}: {about['title']}, {about['points']} points of {about['system']}")
            print(f"made by {about['product']}")
            units = ", ".join(f"{path} [{unit}]" for path, unit in about["axes"].items() if unit)
            print(f"units: {units or 'none'}" + ("" if about["step_halving"] else "; step_halving is off"))
        table = store.table(study)
        _print(table.drop_columns(["run"]) if not args.json else table, args.json)
        return 0
    run = _text(runs[0])
    parts = {
        "run": store.query(f"select * from runs where run = {run}"),
        "points": store.query(f"select * from points where run = {run}"),
        "numbers": store.query(f"select name, value from numbers where run = {run} order by name"),
        "logs": store.query(f"select instance, line from logs where run = {run}"),
    }
    if args.json:
        print(json.dumps({name: table.to_pylist() for name, table in parts.items()}, ensure_ascii=False))
        return 0
    for name, table in parts.items():
        print(f"{name}:")
        for row in table.to_pylist():
            values = (
                list(row.values()) if name in ("numbers", "logs") else [f"{k}={v}" for k, v in row.items()]
            )
            print("  " + "  ".join(str(one) for one in values))
    return 0


def _query(store: Store, args: argparse.Namespace) -> int:
    table = store.query(args.sql)
    if args.csv:
        from pyarrow import csv

        csv.write_csv(table, sys.stdout.buffer)
    else:
        _print(table, args.json)
    return 0


def _export(store: Store, args: argparse.Namespace) -> int:
    import pyarrow.parquet as pq
    from pyarrow import csv

    from ..campaign.database import VIEWS

    formats = [one.strip() for one in args.format.split(",") if one.strip()]
    views = [one.strip() for one in args.views.split(",") if one.strip()]
    problems = [
        Problem("--format", f"no format {one!r}", "csv, parquet")
        for one in formats
        if one not in ("csv", "parquet")
    ]
    problems += [
        Problem("--views", f"no view {one!r}", f"views: {', '.join(VIEWS)}")
        for one in views
        if one not in VIEWS
    ]
    if problems:
        raise ConfigError(problems)
    args.out.mkdir(parents=True, exist_ok=True)
    for view in views:
        # Written as it is read: trajectories need not fit into memory.
        table = store.database.table(view)
        # Before version 1.4 duckdb called it by another name.
        reader = getattr(table, "to_arrow_reader", None) or table.fetch_arrow_reader
        reader = reader(100_000)
        with _Writers(args.out, view, formats, reader.schema, csv, pq) as writers:
            rows = 0
            for batch in reader:
                rows += batch.num_rows
                for one in writers:
                    one.write_batch(batch)
        print(f"{rows} rows of {view} written to {args.out}: {', '.join(f'{view}.{one}' for one in formats)}")
    return 0


class _Writers:
    def __init__(self, out: Path, view: str, formats: list[str], schema: Any, csv: Any, pq: Any) -> None:
        made = {"csv": csv.CSVWriter, "parquet": pq.ParquetWriter}
        self._open = [made[one](str(out / f"{view}.{one}"), schema) for one in formats]

    def __enter__(self) -> list[Any]:
        return self._open

    def __exit__(self, *problem: object) -> None:
        for one in self._open:
            one.close()


def _print(table: pa.Table, as_json: bool) -> None:
    if as_json:
        print(json.dumps(table.to_pylist(), ensure_ascii=False, default=str))
        return
    rows = [[_cell(one) for one in row.values()] for row in table.slice(0, _ROWS).to_pylist()]
    columns = [[name, *(row[n] for row in rows)] for n, name in enumerate(table.column_names)]
    widths = [max(map(len, column)) for column in columns]
    for line in zip(*columns, strict=True):
        print("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip())
    if table.num_rows > _ROWS:
        print(
            f"... {table.num_rows - _ROWS} more rows; --json or --csv prints all, `store export` writes them"
        )


def _cell(value: object) -> str:
    if value is None:
        return "-"
    return f"{value:.6g}" if isinstance(value, float) else str(value).partition("\n")[0]


def _text(text: str) -> str:
    return "'" + text.replace("'", "''") + "'"
