"""How far a search for effects is: candidates looked at and fits made, of how many, and the time left."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from time import monotonic
from typing import TypeVar

__all__ = ["PLAN", "Tally", "stage", "tallied", "telling"]

_In, _Out = TypeVar("_In"), TypeVar("_Out")

# Stages of a search in their order: how often each candidate is looked at in it, and how many fits are made.
# Later ones are left out where earlier ones explain all.
PLAN = {
    "candidates": (2, 0),
    "white": (1, 7),
    "single": (1, 7),
    "pairs": (2, 4),
    "more": (2, 4),
    "exchanged": (2, 14),
    "ties": (1, 6),
    "step": (1, 7),
}
# A fit takes so many times as long as a look, until there was one; seconds until told, and until told again.
_FIT, _FIRST, _EVERY = 15.0, 2.0, 0.5


class Tally:
    """Counts what a search does, and tells how far it is.

    Args:
        candidates: how many there are.
        report: is told, as "weigh 340/1001 candidates and fits, about 2 min left".
        clock: seconds.
    """

    def __init__(
        self, candidates: int, report: Callable[[str], None], clock: Callable[[], float] = monotonic
    ) -> None:
        self._candidates, self._report, self._clock = candidates, report, clock
        self._lock = threading.Lock()
        self._stages = list(PLAN)
        self._own = [0, 0]
        self._done, self._seconds = [0, 0], [0.0, 0.0]
        self._next = clock() + _FIRST

    def stage(self, name: str) -> None:
        """A stage of the plan begins, perhaps anew; those before it are over."""
        with self._lock:
            stages = list(PLAN)
            self._stages = stages[stages.index(name) :]
            self._own = [0, 0]

    def left(self) -> tuple[int, int]:
        """Looks and fits that the plan still holds."""
        now, *later = ((many * self._candidates, fits) for many, fits in (PLAN[one] for one in self._stages))
        looks, fits = (max(planned - own, 0) for planned, own in zip(now, self._own, strict=True))
        return looks + sum(one[0] for one in later), fits + sum(one[1] for one in later)

    def counted(self, function: Callable[[_In], _Out], fits: bool, workers: int) -> Callable[[_In], _Out]:
        """A function that counts what it did.

        Args:
            fits: whether it fits, or else looks at a candidate; workers: threads that do so at once.
        """

        def counting(one: _In) -> _Out:
            begin = self._clock()
            try:
                return function(one)
            finally:
                self._count(int(fits), (self._clock() - begin) / workers)

        return counting

    def _count(self, kind: int, seconds: float) -> None:
        with self._lock:
            self._done[kind] += 1
            self._own[kind] += 1
            self._seconds[kind] += seconds
            now = self._clock()
            if now < self._next:
                return
            self._next = now + _EVERY
            looks, fits = self.left()
            look = self._seconds[0] / max(self._done[0], 1)
            fit = self._seconds[1] / self._done[1] if self._done[1] else _FIT * look
            done = sum(self._done)
            time = _time(looks * look + fits * fit)
        self._report(f"weigh {done}/{done + looks + fits} candidates and fits, about {time} left")


def _time(seconds: float) -> str:
    return f"{max(seconds, 1.0):.0f} s" if seconds < 90.0 else f"{seconds / 60.0:.0f} min"


_current: ContextVar[Tally | None] = ContextVar("tally", default=None)


@contextmanager
def telling(tally: Tally | None) -> Iterator[None]:
    """Searches are counted by a tally."""
    token = _current.set(tally)
    try:
        yield
    finally:
        _current.reset(token)


def stage(name: str) -> None:
    """A stage of `PLAN` begins, if anyone counts."""
    tally = _current.get()
    if tally is not None:
        tally.stage(name)


def tallied(function: Callable[[_In], _Out], fits: bool, workers: int) -> Callable[[_In], _Out]:
    """A function whose calls are counted, if anyone counts; see `Tally.counted`."""
    tally = _current.get()
    return function if tally is None else tally.counted(function, fits, workers)
