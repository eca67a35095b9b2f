"""Temporary folders that are removed even if the process that made them is killed: at the next start."""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
import threading
from contextlib import suppress
from functools import cache
from pathlib import Path
from time import time

from .folder_lock import NAME, take

_PREFIX = "orchestrator-"
# A folder without a lock is being made, or its maker was killed meanwhile: that is not this young [s].
_YOUNG = 3600.0
# A kept folder that was used later than this ago may be in use [s].
_IN_USE = 3600.0
# Threads would each make one.
_ONE_AT_A_TIME = threading.Lock()


def scratch_root() -> Path:
    """The folder of this process within the system's temporary folder; removed when the process ends.

    It is locked as long as the process lives. The first call removes the folders of processes that were
    killed: the system has taken their locks.
    """
    with _ONE_AT_A_TIME:
        return _root(os.getpid(), tempfile.gettempdir())


def scratch_folder(prefix: str) -> Path:
    """A new folder within `scratch_root`."""
    return Path(tempfile.mkdtemp(prefix=prefix, dir=scratch_root()))


def cache_folder(name: str) -> Path:
    """Where this machine keeps files of a kind between runs, for this user; may not exist yet."""
    base = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA")
    return (Path(base) if base else Path.home() / ".cache") / "orchestrator" / name


def keep_last_used(folder: Path, most: int) -> None:
    """Remove all folders within one but those used last; one that a build may still read stays."""
    found = {}
    for one in folder.iterdir():
        with suppress(OSError):
            found[one] = one.stat().st_mtime
    for one in sorted(found, key=found.__getitem__, reverse=True)[most:]:
        if time() - found[one] > _IN_USE:
            shutil.rmtree(one, ignore_errors=True)


def remove_scratch() -> None:
    """Remove what this process has made, for a process that ends without its exit handlers."""
    if _root.cache_info().currsize:
        _remove(os.getpid(), scratch_root())


@cache
def _root(process: int, parent: str) -> Path:
    _remove_abandoned(Path(parent))
    while True:
        folder = Path(tempfile.mkdtemp(prefix=_PREFIX, dir=parent))
        try:
            held = take(folder / NAME)  # kept open: the process's end gives the lock up
        except OSError:
            held = None
            if folder.is_dir():  # a file system without locks, or without room
                break
        if held is not None:
            break
    atexit.register(_remove, process, folder)
    return folder


def _remove(process: int, folder: Path) -> None:
    if os.getpid() == process:  # not in a copy of the process, which inherits its exit handlers
        shutil.rmtree(folder, ignore_errors=True)


def _remove_abandoned(parent: Path) -> None:
    for folder in parent.glob(f"{_PREFIX}*"):
        with suppress(OSError):
            found = folder.lstat()
            if not folder.is_dir() or folder.is_symlink():
                continue
            if hasattr(os, "getuid") and found.st_uid != os.getuid():
                continue
            lock = folder / NAME
            if not lock.exists() and time() - found.st_mtime < _YOUNG:
                continue
            file = take(lock)
            if file is None:
                continue
            try:
                shutil.rmtree(folder, ignore_errors=True)
            finally:
                os.close(file)
            shutil.rmtree(folder, ignore_errors=True)  # where an open file cannot be removed
