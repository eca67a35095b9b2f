"""The store of runs: append-only, whole after a kill at any moment.

    store.json            what this folder is
    files/<sha256>/<name> FMUs and effects of the runs
    studies/<id>/         study.json: the study, its config and versions; points.parquet: its points
    journal/<n>.log       runs as they came in
    parts/<n>/*.parquet   the runs of a journal that is closed, in columns

A part appears under its name at once and whole, and its journal goes afterwards: whoever finds both takes the
part. Nothing that stands under its final name is ever changed.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
from collections.abc import Iterable, Mapping
from contextlib import ExitStack, suppress
from pathlib import Path
from time import time
from typing import TYPE_CHECKING, Any

from ..base.errors import ConfigError, OrchestratorError, Problem
from ..base.folder_lock import locked
from ..fmi.workers.files import put_file
from .journal import Journal, read_journal
from .tables import tables_of

if TYPE_CHECKING:
    import pyarrow as pa

_FORMAT = "store/1"
# A journal becomes a part when it has grown to so many bytes or records.
_LARGEST, _MOST = 64 << 20, 20_000


def number_of(path: Path) -> int:
    """The number of a journal or part."""
    return int(path.stem)


def journals(folder: Path) -> list[Path]:
    """Journals of a store, oldest first."""
    return sorted((folder / "journal").glob("[0-9]*.log"), key=number_of)


def parts(folder: Path) -> list[Path]:
    """Parts of a store, oldest first."""
    return sorted((one for one in (folder / "parts").glob("[0-9]*") if one.is_dir()), key=number_of)


def check_store(folder: Path) -> None:
    """Raises: ConfigError if the folder is no store."""
    try:
        data = json.loads((folder / "store.json").read_text(encoding="utf-8"))
        found = data.get("format") if isinstance(data, dict) else None
    except (OSError, ValueError):
        found = None
    if found != _FORMAT:
        what = "is not a store of runs" if found is None else f"is a store of format {found!r}"
        raise ConfigError(
            [Problem(str(folder), what, f"{_FORMAT}, which `orchestrator sweep --store` makes")]
        )


def write_whole(path: Path, data: bytes) -> None:
    """Have a file appear under its name whole. Raises: OSError."""
    temporary = path.with_name(f".{path.name}.new")
    with temporary.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    os.replace(temporary, path)
    _sync_folder(path.parent)


def _sync_folder(folder: Path) -> None:
    if os.name != "posix":
        return
    number = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)


class StoreWriter:
    """Writes runs to a store; one at a time per store."""

    def __init__(self, folder: Path) -> None:
        """Make the store, or open it and correct what a kill has left.

        Raises: ConfigError if the folder is none, or somebody writes to it; OrchestratorError if the disk
            does not take it.
        """
        self.folder = folder
        self._journal: Journal | None = None
        self._session = ""
        self._stack = ExitStack()
        if folder.exists() and not folder.is_dir():
            problem = Problem(str(folder), "is a file", "a folder, which is made if need be")
            raise ConfigError([problem])
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigError([Problem("", f"cannot make the folder {folder} ({error})")]) from error
        with self._reporting("it cannot be opened"):
            if any(folder.iterdir()) and not (folder / "store.json").is_file():
                left = {one.name for one in folder.iterdir()} - {
                    "journal",
                    "parts",
                    "files",
                    "studies",
                    ".running",
                }
                if left - {".store.json.new"}:
                    raise ConfigError(
                        [Problem(str(folder), "is not empty, and no store", remedy="Name a new folder.")]
                    )
            for name in ("journal", "parts", "files", "studies"):
                (folder / name).mkdir(parents=True, exist_ok=True)
        self._stack.enter_context(locked(folder))
        try:
            with self._reporting("it cannot be opened"):
                if (folder / "store.json").exists():
                    check_store(folder)
                else:
                    write_whole(folder / "store.json", json.dumps({"format": _FORMAT}).encode())
                self._repair()
        except BaseException:
            self._stack.close()
            raise

    def _repair(self) -> None:
        for left in (self.folder / "parts").glob(".*"):
            shutil.rmtree(left, ignore_errors=True)
        there = {number_of(one) for one in parts(self.folder)}
        for path in journals(self.folder):
            if number_of(path) not in there:
                self._compact(path)
            path.unlink(missing_ok=True)

    def __enter__(self) -> StoreWriter:
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        self.close(failed=kind is not None)

    def close(self, failed: bool = False) -> None:
        """Turn what came in into a part, and let others write.

        Args:
            failed: whether an error is on its way that is to be reported first.
        Raises: OrchestratorError if what came in cannot be brought to the disk.
        """
        try:
            if self._journal is not None:
                with suppress(OrchestratorError) if failed else ExitStack():
                    with self._reporting("the latest runs cannot be brought to the disk"):
                        self._journal.sync()
                # A journal that there is no room to turn into a part stays, and is read as well.
                with suppress(OSError):
                    self._turn()
        finally:
            self._stack.close()

    def seen(self) -> dict[str, bool]:
        """Runs that the store holds, and whether each failed."""
        import pyarrow.parquet as pq

        found: dict[str, bool] = {}
        for part in parts(self.folder):
            if (part / "runs.parquet").is_file():
                table = pq.read_table(part / "runs.parquet", columns=["run", "status"])
                for run, status in zip(*(one.to_pylist() for one in table.columns), strict=True):
                    found[run] = status != "done"
        return found

    def put(self, files: Mapping[str, bytes]) -> None:
        """Keep files by content. Raises: OrchestratorError."""
        with self._reporting("files of the study cannot be kept"):
            for place, data in files.items():
                put_file(self.folder / "files", place, data)

    def study_folder(self, study: str, about: Mapping[str, Any], points: Iterable[pa.Table]) -> Path:
        """Keep a study and its points, unless they stand there. Raises: OrchestratorError."""
        import pyarrow.parquet as pq

        folder = self.folder / "studies" / study
        with self._reporting("the study cannot be kept"):
            if (folder / "study.json").is_file():
                return folder
            folder.mkdir(parents=True, exist_ok=True)
            temporary = folder / ".points.new"
            writer = None
            try:
                for table in points:
                    writer = writer or pq.ParquetWriter(temporary, table.schema, compression="zstd")
                    writer.write_table(table)
            finally:
                if writer is not None:
                    writer.close()
            os.replace(temporary, folder / "points.parquet")
            # Last: what it stands beside is whole.
            write_whole(folder / "study.json", json.dumps(about, ensure_ascii=False, indent=1).encode())
        return folder

    def begin(self, session: str, about: Mapping[str, Any]) -> None:
        """Begin a session: a journal of its own. Raises: OrchestratorError."""
        self._session, self._about = session, {"session": session, **about}
        with self._reporting("no journal can be begun"):
            self._open()

    def _open(self) -> None:
        numbers = [number_of(one) for one in (*journals(self.folder), *parts(self.folder))]
        path = self.folder / "journal" / f"{max(numbers, default=0) + 1:06d}.log"
        self._journal = Journal(path)
        self._journal.append(json.dumps(self._about, ensure_ascii=False).encode())

    def add(self, run: str, row: Mapping[str, Any], attempts: int, seconds: float, data: bytes) -> None:
        """Keep a run. Raises: OrchestratorError if the disk does not take it; those before it are kept."""
        assert self._journal is not None
        record = {
            "run": run,
            "session": self._session,
            "status": "failed" if row.get("kind") else "done",
            "attempts": attempts,
            "seconds": seconds,
            "written": time(),
            "row": row,
        }
        with self._reporting("no more runs can be kept"):
            self._journal.append(json.dumps(record, ensure_ascii=False, separators=(",", ":")).encode(), data)
        if self._journal.size > _LARGEST or self._journal.count > _MOST:
            with self._reporting("no more runs can be kept"):
                self._turn()
                self._open()

    def _turn(self) -> None:
        """Make a part of the journal. Where the disk is too full for that, the journal stays, and is read."""
        journal, self._journal = self._journal, None
        assert journal is not None
        try:
            journal.sync()
            journal.close()
            if journal.count > 1:
                self._compact(journal.path)
            journal.path.unlink()
        finally:
            journal.close()

    def _compact(self, path: Path) -> None:
        import pyarrow.parquet as pq

        final = self.folder / "parts" / path.stem
        temporary = final.with_name(f".{path.stem}")
        shutil.rmtree(temporary, ignore_errors=True)
        tables = tables_of(read_journal(path))
        if "runs" not in tables:
            return
        temporary.mkdir()
        try:
            for name, table in tables.items():
                with (temporary / f"{name}.parquet").open("wb") as file:
                    pq.write_table(table, file, compression="zstd")
                    file.flush()
                    os.fsync(file.fileno())
            _sync_folder(temporary)
            os.rename(temporary, final)
            _sync_folder(final.parent)
        except BaseException:
            shutil.rmtree(temporary, ignore_errors=True)
            raise

    def _reporting(self, what: str) -> _Reporting:
        return _Reporting(self.folder, what)


_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}


class _Reporting:
    """Errors of the disk as errors that say what to do."""

    def __init__(self, folder: Path, what: str) -> None:
        self._folder, self._what = folder, what

    def __enter__(self) -> None: ...

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if not isinstance(error, OSError):
            return
        full = error.errno in _FULL
        with suppress(OSError):
            full = full or shutil.disk_usage(self._folder).free < 1 << 16
        reason = f"the disk is full ({error})" if full else str(error)
        raise OrchestratorError(
            f"{self._folder}: {self._what}: {reason}; what was kept until then can be read\n"
            f"  {'Make room' if full else 'Put that right'} and start again: it goes on where it stopped."
        ) from error
