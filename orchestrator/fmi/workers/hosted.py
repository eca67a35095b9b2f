"""Works on a Dask worker: their files and processes."""

from __future__ import annotations

import pickle
import threading
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...base.errors import OrchestratorError
from .child import Child, attempt
from .files import cache_folder, put_file
from .tasks import Work


class _Hosted:
    """On a Dask worker: a work, its files, and its idle processes."""

    def __init__(self, work: Work, folder: Path) -> None:
        self.work, self.folder = work, folder
        self.idle: deque[Child] = deque()
        self.all: set[Child] = set()
        self.lock = threading.Lock()

    def make(self) -> Child:
        child = Child(self.work, self.folder)
        with self.lock:
            self.all = {one for one in self.all if one.alive} | {child}
        return child

    def end(self) -> None:
        with self.lock:
            for child in self.all:
                child.end()


_HOSTED: dict[str, _Hosted] = {}


def host(name: str, data: bytes, files: Mapping[str, bytes]) -> None:
    """On a Dask worker: take in a work and its files."""
    folder = cache_folder()
    for place, content in files.items():
        put_file(folder, place, content)
    if name not in _HOSTED:
        _HOSTED[name] = _Hosted(Work(**pickle.loads(data)), folder)


def dismiss(name: str) -> None:
    """On a Dask worker: end the processes of a work."""
    hosted = _HOSTED.pop(name, None)
    if hosted is not None:
        hosted.end()


def _threads_of(name: str, dask_worker: Any = None) -> int:
    if name not in _HOSTED:
        raise OrchestratorError(f"{name} did not arrive")
    return dask_worker.state.nthreads


def _do(name: str, task: Any) -> tuple[Any, int]:
    hosted = _HOSTED[name]
    with hosted.lock:
        child = hosted.idle.popleft() if hosted.idle else None
    child, made, attempts = attempt(child, hosted.make, task, hosted.work)
    if child is not None:
        hosted.idle.append(child)
    return made, attempts
