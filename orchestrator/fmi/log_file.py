"""Files that take what FMUs log over a run, one for each instance."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import IO, BinaryIO

# Within the folder of a run.
LOG_FOLDER = "log"
# Of a file [B].
_LARGEST = 10 << 20

_folder: ContextVar[Path | None] = ContextVar("log_folder", default=None)


@contextmanager
def logs_in(folder: Path | None) -> Iterator[None]:
    """Instances that are made meanwhile log to files of a folder; None: to none."""
    token = _folder.set(folder)
    try:
        yield
    finally:
        _folder.reset(token)


def log_folder() -> Path | None:
    """Where instances log to now."""
    return _folder.get()


class LogFile:
    """Takes the lines of an instance; the file is made with the first one.

    Each line is written at once, so that nothing is lost if the process is killed. A file that is full says
    so in its last line. A disk that takes no more fails no run.
    """

    def __init__(self, folder: Path, name: str) -> None:
        self.path = folder / f"{name}.log"
        self._file: BinaryIO | None = None
        self._size = 0

    @staticmethod
    def of(name: str) -> LogFile | None:
        """The file of an instance, where there is a folder for it."""
        folder = log_folder()
        return None if folder is None else LogFile(folder, name)

    def write(self, lines: list[str], time: Callable[[], float | None]) -> None:
        """Write lines with the time of the communication point [s]."""
        if self._size >= _LARGEST:
            return
        at = time()
        begin = "start" if at is None else f"{at:.12g} s"
        with suppress(OSError):
            if self._file is None:
                self.path.parent.mkdir(parents=True, exist_ok=True)
                # Unbuffered; a process of its own appends what it printed.
                self._file = open(self.path, "ab", buffering=0)
                self._size = os.fstat(self._file.fileno()).st_size
            text = bytearray()
            for line in lines:
                row = f"{begin}\t{line}\n".encode(errors="replace")
                if self._size + len(text) + len(row) > _LARGEST:
                    full = f"... the file is full ({_LARGEST >> 20} MiB): further lines are left out"
                    text += f"{begin}\t{full}\n".encode()
                    self._size = _LARGEST
                    break
                text += row
            self._size += len(text)
            self._file.write(text)

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            with suppress(OSError):
                self._file.close()
            self._file = None


class PrintedFile:
    """Takes what the process of an instance prints: in the folder of logs, so that it outlives a killed run.

    Attributes:
        stream: open for writing and reading.
    """

    def __init__(self, name: str) -> None:
        folder = log_folder()
        self._path = None if folder is None else folder / f"{name}.printed.log"
        if self._path is not None:
            try:
                self._path.parent.mkdir(parents=True, exist_ok=True)
                self.stream: IO[bytes] = open(self._path, "w+b")
                return
            except OSError:
                self._path = None
        self.stream = tempfile.TemporaryFile(prefix="fmu-output-")

    def text(self) -> str:
        """All that was printed so far."""
        self.stream.seek(0)
        return self.stream.read().decode("utf-8", errors="replace")

    def remove(self) -> None:
        """Close and remove the file."""
        self.stream.close()
        if self._path is not None:
            with suppress(OSError):
                self._path.unlink()


def clear_logs(folder: Path) -> None:
    """Remove the files of an earlier run. Raises: OSError."""
    for path in (folder / LOG_FOLDER).glob("*.log"):
        os.unlink(path)
