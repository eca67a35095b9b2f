"""One run at a time in a folder: a lock that goes with the process that holds it, however that ends."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from .errors import ConfigError, Problem

NAME = ".running"
# Windows lets nobody read what is locked, and the holder's number is to be read: what is locked is a byte
# far behind it.
_BYTE = 1 << 30
_TAKEN = {errno.EACCES, errno.EAGAIN, errno.EDEADLK}


@contextmanager
def locked(folder: Path | None) -> Iterator[None]:
    """Keep other runs out of a folder, in this process and in others.

    The system takes the lock from a process that ends, killed or not: a file that was left behind holds
    nobody up. A file system without locks is written to without one.

    Args:
        folder: that exists; None: nothing is to be kept.
    Raises: ConfigError if another run is writing there, or the lock's file cannot be made.
    """
    if folder is None:
        yield
        return
    path = folder / NAME
    try:
        file = take(path)
    except OSError as error:
        raise ConfigError([Problem("", f"cannot write to the folder {folder} ({error})")]) from error
    if file is None:
        what = f"another run{_holder(path)} is writing to this folder"
        remedy = "Wait until it has ended, or give another folder."
        raise ConfigError([Problem(str(folder), what, "a folder takes one run at a time", remedy)])
    try:
        yield
    finally:
        # Removed while it is locked where that can be (not on Windows), so that nobody else's is removed.
        with suppress(OSError):
            path.unlink()
        os.close(file)
        if sys.platform == "win32":
            with suppress(OSError):
                path.unlink()


def take(path: Path) -> int | None:
    """A lock file, made if need be, open and locked; None if somebody else holds it. Raises: OSError."""
    while True:
        file = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            held = _lock(file)
            if held and not _still_there(file, path):  # its holder removed it between the two calls
                os.close(file)
                continue
            if held:
                os.truncate(file, 0)
                os.write(file, f"{os.getpid()}\n".encode())
                return file
        except BaseException:
            os.close(file)
            raise
        os.close(file)
        return None


def _lock(file: int) -> bool:
    """Whether the lock was free, and is now this run's."""
    try:
        if sys.platform == "win32":
            import msvcrt

            os.lseek(file, _BYTE, os.SEEK_SET)
            msvcrt.locking(file, msvcrt.LK_NBLCK, 1)
            os.lseek(file, 0, os.SEEK_SET)
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in _TAKEN:
            return False
        if error.errno not in (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP):
            raise
    return True


def _still_there(file: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(file), path.stat())
    except FileNotFoundError:
        return False


def _holder(path: Path) -> str:
    with suppress(OSError, ValueError):
        return f" (process {int(path.read_text(encoding='ascii'))})"
    return ""
