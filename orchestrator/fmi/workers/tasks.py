"""What is asked of workers, and what comes back."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

# Why a task failed: its process crashed, it took too long, it raised, or its process was killed from outside.
KINDS = ("crash", "time limit", "error", "killed")


@dataclass(frozen=True)
class Failure:
    """Why a task has no value.

    Attributes:
        kind: one of KINDS.
        message: what happened.
        log: the latest lines that the process printed.
    """

    kind: str
    message: str
    log: tuple[str, ...] = ()


@dataclass(frozen=True)
class Attempt:
    """One go at a task: its value, or why there is none; and how long it took [s]."""

    value: Any = None
    failure: Failure | None = None
    seconds: float = 0.0


@dataclass(frozen=True)
class Outcome:
    """What became of a task.

    Attributes:
        task: as it was given.
        value: what the function returned; None if it failed.
        failure: why it failed; None if it did not.
        attempts: how many it took.
        seconds: wall time of the last one [s].
    """

    task: Any
    value: Any
    failure: Failure | None
    attempts: int
    seconds: float


@dataclass(frozen=True)
class Retry:
    """Which failures are tried again, and how often.

    Attributes:
        attempts: at most so many for each task, the first one counted.
        kinds: of failures that are worth it. A process that was killed from outside is no fault of its task:
            that is tried again three times in any case.
    """

    attempts: int = 1
    kinds: frozenset[str] = frozenset({"crash", "time limit"})

    def again(self, failure: Failure, attempts: int) -> bool:
        """Whether to try once more after so many attempts."""
        if failure.kind == "killed":
            return attempts < max(self.attempts, 4)
        return failure.kind in self.kinds and attempts < self.attempts


@dataclass(frozen=True)
class Work:
    """A function, and what its workers need before they call it.

    Attributes:
        function: called as function(context, task); it and `prepare` are found by the name of their module.
        prepare: makes the context, once per process: prepare(payload, folder of the files). None: the
            payload is the context.
        payload: anything that can be pickled.
        files: by their place below the folder, "<sha256>/<name>": they travel once to each machine and are
            checked there.
        time_limit: of a task [s]; None: as long as it takes.
        retry: what to do about failures.
        threads: that numerical libraries may start in each process; None: as they like. One thread makes a
            number the same wherever it is computed.
        recycle: bytes of memory that a process may grow by before a fresh one takes over; None: any.
    """

    function: Callable[[Any, Any], Any]
    prepare: Callable[[Any, Path], Any] | None = None
    payload: Any = None
    files: Mapping[str, Path] = field(default_factory=dict)
    time_limit: float | None = None
    retry: Retry = Retry()
    threads: int | None = None
    recycle: int | None = None


class Pool(Protocol):
    """What runs tasks."""

    def outcomes(self, work: Work, tasks: Iterable[Any], folder: Path | None = None) -> Iterator[Outcome]:
        """What becomes of each task, in the order in which they end.

        Tasks are taken as they can be worked on: neither they nor the outcomes pile up.

        Args:
            folder: that holds the files already; a machine of its own keeps them in a cache.
        Raises: OrchestratorError if workers cannot begin.
        """
