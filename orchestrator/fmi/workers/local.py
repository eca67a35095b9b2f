"""Processes of this machine, each held by a thread of this one."""

from __future__ import annotations

import os
import queue
import threading
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from .child import Child, attempt
from .tasks import Outcome, Work


def cores() -> int:
    """How many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class LocalPool:
    """As many processes as there are cores, or as are asked for; see `Pool`."""

    def __init__(self, jobs: int | None = None) -> None:
        self.jobs = jobs or cores()

    def outcomes(self, work: Work, tasks: Iterable[Any], folder: Path | None = None) -> Iterator[Outcome]:
        """See `Pool.outcomes`. Closing the iterator ends the processes."""
        held = _RunningCall(work, iter(tasks), folder, self.jobs)
        try:
            yield from held.outcomes()
        finally:
            held.end()


class _RunningCall:
    """The threads and processes of one call."""

    def __init__(self, work: Work, tasks: Iterator[Any], folder: Path | None, jobs: int) -> None:
        self._work, self._tasks, self._folder = work, tasks, folder
        self._taking = threading.Lock()
        self._made: queue.Queue[Outcome | BaseException | None] = queue.Queue(4 * jobs)
        self._ending = threading.Event()
        self._children: dict[int, Child] = {}
        self._holding = threading.Lock()
        self._threads = [
            threading.Thread(target=self._hold, args=(n,), daemon=True, name=f"worker-{n}")
            for n in range(jobs)
        ]
        for thread in self._threads:
            thread.start()

    def outcomes(self) -> Iterator[Outcome]:
        left = len(self._threads)
        while left:
            made = self._made.get()
            if isinstance(made, BaseException):
                raise made
            if made is None:
                left -= 1
            else:
                yield made

    def end(self) -> None:
        self._ending.set()
        with self._holding:
            for child in self._children.values():
                child.end()
        while any(thread.is_alive() for thread in self._threads):
            try:  # a thread may stand at a full queue
                self._made.get(timeout=0.02)
            except queue.Empty:
                continue

    def _next(self) -> tuple[bool, Any]:
        with self._taking:
            if self._ending.is_set():
                return False, None
            try:
                return True, next(self._tasks)
            except StopIteration:
                return False, None

    def _hold(self, number: int) -> None:
        child: Child | None = None

        def make() -> Child:
            made = Child(self._work, self._folder)
            with self._holding:
                self._children[number] = made
                if self._ending.is_set():
                    made.end()
            return made

        try:
            while True:
                there, task = self._next()
                if not there:
                    break
                child, made, attempts = attempt(child, make, task, self._work)
                if self._ending.is_set():
                    break
                self._made.put(Outcome(task, made.value, made.failure, attempts, made.seconds))
        except BaseException as error:
            self._made.put(error)
        finally:
            if child is not None:
                child.end()
            self._made.put(None)
