"""Makes the runs of a study that the store does not hold yet."""

from __future__ import annotations

import json
import secrets
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

from ..base.errors import Interrupted, extras_named
from ..base.provenance import origin, versions
from ..base.text_tables import html_table
from ..fmi.workers import Outcome, Pool, Work, pool_of
from .execute import Task, as_json, begin, execute
from .software_version import product
from .store import StoreWriter
from .study import CheckedStudy

if TYPE_CHECKING:
    import pyarrow as pa

_PACKAGES = (
    "orchestrator",
    "fmpy",
    "numpy",
    "scipy",
    "pydantic",
    "PyYAML",
    "pyarrow",
    "duckdb",
    "distributed",
)
# A worker that has grown by so much is replaced: FMUs lose memory, and there may be thousands of runs.
_GROWTH = 512 << 20
# Rows that a notebook shows.
_MOST_ROWS = 30


@dataclass(repr=False)
class Swept:
    """What a sweep came to.

    Attributes:
        store: folder of the store.
        study: id of the study in it.
        points: of the design, repeats included.
        made, reused: runs that were made now, and that the store held already.
        failed: runs of the study that failed, by kind, those that were reused included.
        examples: the first message of each kind.
        seconds: wall time of all [s].
        busy: wall time of the runs themselves, summed over the workers [s].
    """

    store: Path
    study: str
    points: int
    made: int = 0
    reused: int = 0
    failed: Counter[str] = field(default_factory=Counter)
    examples: dict[str, str] = field(default_factory=dict)
    seconds: float = 0.0
    busy: float = 0.0

    @property
    def table(self) -> pa.Table:
        """Points with what their runs gave, in the order of the design; an Arrow table."""
        from .database import Store

        with extras_named(), Store(self.store) as store:
            return store.table(self.study)

    def columns(self) -> dict[str, Any]:
        """The table as numpy arrays by name; gaps are not a number, or None among texts.

        Of a study without derived quantities, the numbers of the summaries stand in it.
        """
        from .database import Store

        with extras_named(), Store(self.store) as store:
            table = store.table(self.study)
            numbers = {} if store.studies[self.study]["derived"] else store.numbers(table["run"])
        found = {name: table.column(name).to_numpy(zero_copy_only=False) for name in table.column_names}
        return found | {name: one for name, one in numbers.items() if name not in found}

    def to_dataframe(self) -> Any:
        """The table as a pandas DataFrame. Raises: ImportError if pandas is not installed."""
        import pandas as pd

        return pd.DataFrame(self.columns())

    def __repr__(self) -> str:
        failed = "".join(f"; {count} failed: {kind}" for kind, count in self.failed.items())
        return (
            f"sweep of {self.points} points: {self.made} runs made, {self.reused} reused{failed}; "
            f"{self.seconds:.1f} s; study {self.study} in {self.store}"
        )

    def _repr_html_(self) -> str:
        hidden = {"run", *(() if self.failed else ("kind", "message", "halving_error"))}
        columns = {name: one for name, one in self.columns().items() if name not in hidden}
        rows = list(zip(*(one.tolist() for one in columns.values()), strict=True))
        return f"{escape(repr(self))}{html_table(rows[:_MOST_ROWS], list(columns))}"

    def data(self) -> dict[str, Any]:
        """Plain values, as --json prints them."""
        return {
            "store": str(self.store),
            "study": self.study,
            "points": self.points,
            "made": self.made,
            "reused": self.reused,
            "failed": dict(self.failed),
            "examples": self.examples,
            "seconds": self.seconds,
            "busy": self.busy,
        }


def sweep(
    study: CheckedStudy,
    store: Path | str,
    *,
    jobs: int | None = None,
    scheduler: object = None,
    retry_failed: bool = False,
    pool: Pool | None = None,
    progress: Callable[[int, int, int], None] | None = None,
) -> Swept:
    """Make the runs of a study that the store does not hold yet.

    Args:
        study: that is checked already.
        store: folder; made if need be.
        jobs, scheduler: see `pool_of`.
        retry_failed: whether runs that the store holds as failed are made again.
        pool: what runs them, in place of `jobs` and `scheduler`.
        progress: called with runs done, of how many, and failed.
    Raises: ConfigError before the first run; OrchestratorError if the store takes no more; Interrupted.
        What is in the store by then stays, and the same call goes on from there.
    """
    began = monotonic()
    pool = pool or pool_of(scheduler, jobs)
    folder = Path(store)
    try:
        with StoreWriter(folder) as writer:
            swept = _sweep(study, writer, pool, retry_failed, progress)
    finally:
        close = getattr(pool, "close", None)
        if close is not None:
            close()
    swept.seconds = monotonic() - began
    return swept


class Study(CheckedStudy):
    """A system, the points at which it is run, and what is kept of each run; `Study.load` reads a file."""

    def run(self, store: Path | str, **options: Any) -> Swept:
        """Make the runs that the store does not hold yet; `options` are those of `sweep`."""
        return sweep(self, store, **options)


def _sweep(
    study: CheckedStudy,
    writer: StoreWriter,
    pool: Pool,
    retry_failed: bool,
    progress: Callable[[int, int, int], None] | None,
) -> Swept:
    swept = Swept(writer.folder, study.id, len(study))
    writer.put(study.files)
    now = origin()
    about = {**study.about(), "origin": now}
    writer.study_folder(study.id, about, study.points(study.id))
    seen = writer.seen()
    todo: list[int] = []
    met: dict[str, None] = {}
    kept_failures = 0
    for index, key in enumerate(_keys(study, writer.folder)):
        if key in met:
            continue
        met[key] = None
        if key not in seen or (retry_failed and seen[key]):
            todo.append(index)
        else:
            swept.reused += 1
            kept_failures += seen[key]
    if kept_failures:
        swept.failed["of an earlier sweep"] = kept_failures
    if progress is not None:
        progress(swept.reused, len(met), kept_failures)
    if not todo:
        return swept
    session = secrets.token_hex(8)
    facts = {**now, "packages": versions(_PACKAGES), "product": product(), "fmus": sorted(study.files)}
    writer.begin(session, {"study": study.id, "created": now["created"], "about": json.dumps(facts)})
    work = Work(
        execute,
        begin,
        study.order(len(todo)),
        {place: writer.folder / "files" / place for place in study.files},
        study.model.seconds(),
        study.retry,
        threads=1,
        recycle=_GROWTH,
    )
    outcomes = pool.outcomes(work, (study.task(n)[0] for n in todo), (writer.folder / "files").resolve())
    try:
        for outcome in outcomes:
            _keep(outcome, writer, swept)
            if progress is not None:
                progress(swept.reused + swept.made, len(met), sum(swept.failed.values()))
    except KeyboardInterrupt:
        raise Interrupted(
            f"interrupted; {swept.made} runs of this sweep are kept in {writer.folder}, "
            "and the same command goes on from there"
        ) from None
    finally:
        outcomes.close()  # type: ignore[attr-defined]
    return swept


def _keys(study: CheckedStudy, folder: Path) -> Iterator[str]:
    """Identities of the study's runs, as its points in the store have them."""
    import pyarrow.parquet as pq

    with pq.ParquetFile(folder / "studies" / study.id / "points.parquet") as file:
        for batch in file.iter_batches(columns=["run"]):
            yield from batch.column(0).to_pylist()


def _keep(outcome: Outcome, writer: StoreWriter, swept: Swept) -> None:
    task: Task = outcome.task
    attempts = outcome.attempts
    swept.made += 1
    swept.busy += outcome.seconds
    if outcome.failure is not None:
        failure = outcome.failure
        row = {"kind": failure.kind, "message": failure.message}
        if failure.log:
            row["log"] = {"": failure.log}  # type: ignore[assignment]
        data = b""
    else:
        row, data = json.loads(as_json(outcome.value)), outcome.value.trajectory
        attempts += outcome.value.attempts - 1
    writer.add(task.key, row, attempts, outcome.seconds, data)
    if row.get("kind"):
        swept.failed[row["kind"]] += 1
        swept.examples.setdefault(row["kind"], row["message"])
