"""Progress of a search for effects: candidates, fits, and the remaining time."""

from __future__ import annotations

import math
import threading
from bisect import insort
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from time import monotonic
from typing import NamedTuple, TypeVar

from ..results.progress import Share

__all__ = ["PLAN", "SearchProgress", "counted_calls", "progress_reported", "stage", "twice"]

_In, _Out = TypeVar("_In"), TypeVar("_Out")


class _Planned(NamedTuple):
    """A stage of a search as it usually is.

    Attributes:
        looks: how often each candidate is looked at, less than once where it is known which come near; look:
            how long that takes, as a share of a look in the first stage.
        fits: how many are made; fit: how long each takes, that of one effect being 1.
    """

    name: str
    looks: float
    look: float
    fits: float
    fit: float


# Later stages are left out where earlier ones explain all; a search by better weights is often made again.
PLAN = (
    _Planned("candidates", 2.0, 1.0, 0.0, 1.0),
    _Planned("white", 1.0, 0.5, 7.0, 1.0),
    _Planned("pairs", 2.0, 0.5, 3.0, 1.5),
    _Planned("more", 0.5, 0.5, 1.0, 2.5),
    _Planned("single", 0.2, 0.5, 8.0, 1.5),
    _Planned("pairs", 0.2, 0.5, 5.0, 2.0),
    _Planned("more", 0.1, 0.5, 8.0, 2.5),
    _Planned("exchanged", 0.1, 0.5, 3.0, 2.0),
    _Planned("single", 0.1, 0.5, 6.0, 1.5),
    _Planned("pairs", 0.1, 0.5, 4.0, 2.0),
    _Planned("more", 0.1, 0.5, 7.0, 2.5),
    _Planned("exchanged", 0.1, 0.5, 3.0, 2.0),
    _Planned("ties", 1.0, 0.2, 5.0, 1.5),
    _Planned("step", 1.0, 0.5, 16.0, 2.0),
)
# A fit of one effect takes so many times as long as a first look: that is believed like so many fits.
_FIT, _BELIEVED = 4.0, 3.0
# Times of more than so many medians are taken for that.
_OUTLYING = 4.0
# Looks before which no time is reported: the first ones compile.
_FEWEST = 20
# Seconds until the first report, and between reports; the reported time follows the expected one within this
# share of the time passed, and at least so many seconds.
_FIRST, _EVERY, _SLOW, _SLOWEST = 2.0, 0.5, 0.2, 3.0


class SearchProgress:
    """Counts the steps of a search and reports its progress.

    The remaining time is that of the usual stages to come, at the pace of this search so far. The reported
    time runs down with the clock and follows the expected one slowly, so that a stage that is left out or
    repeated causes no jump. A repeated search is that of `steps`, and is reported as such; its time counts
    from the call of `twice`.

    Args:
        candidates: how many there are.
        report: is reported, as "weigh 340/1001 candidates and fits, about 2 min left".
        clock: seconds.
    """

    def __init__(
        self, candidates: int, report: Callable[[str], None], clock: Callable[[], float] = monotonic
    ) -> None:
        self._candidates, self._report, self._clock = candidates, report, clock
        self._lock = threading.Lock()
        self._at, self._own = 0, [0, 0]
        self._done = [0, 0]
        self._again = self._twice = False
        # Seconds that looks and fits took, as multiples of what is planned of each; rising.
        self._paces: tuple[list[float], list[float]] = [], []
        self._seconds = 0.0
        self._shown: tuple[float, float] | None = None
        self._begun = clock()
        self._next = self._begun + _FIRST

    def stage(self, name: str) -> None:
        """A stage of the plan begins, possibly again; earlier stages are finished."""
        with self._lock:
            if PLAN[self._at].name == name and name != "candidates":
                return  # the same with one effect more
            self._again |= name == "candidates" and self._at > 0
            after = [at for at in range(self._at + 1, len(PLAN)) if PLAN[at].name == name]
            before = [at for at in range(self._at + 1) if PLAN[at].name == name]
            self._at = after[0] if after and name != "candidates" else (before or after)[-1]
            self._own = [0, 0]

    def twice(self) -> None:
        """The search will probably be repeated."""
        with self._lock:
            self._twice = True

    def left(self) -> tuple[int, int]:
        """Looks and fits that remain in the plan."""
        left = self._left()
        return round(sum(one.looks for one in left)), round(sum(one.fits for one in left))

    def _left(self) -> list[_Planned]:
        """Remaining work of each stage; looks in total, not by candidate."""
        plan = [*PLAN[self._at :], *(PLAN[:-1] if self._twice and not self._again else ())]
        now, *later = (one._replace(looks=one.looks * self._candidates) for one in plan)
        looks, fits = self._own
        own = now._replace(looks=max(now.looks - looks, 0.0), fits=max(now.fits - fits, 0.0))
        return [own, *later]

    def _expected(self, now: float) -> float:
        """Expected seconds of the remaining work at the pace so far, overhead included."""
        look = _typical(self._paces[0])
        fits = self._paces[1]
        fit = (sum(fits) + _BELIEVED * _FIT * look) / (len(fits) + _BELIEVED)
        counted = sum(one.looks * one.look * look + one.fits * one.fit * fit for one in self._left())
        return counted * max((now - self._begun) / max(self._seconds, 1e-9), 1.0)

    def _steady(self, now: float) -> float:
        """Remaining seconds as reported; see `SearchProgress`."""
        expected = self._expected(now)
        if self._shown is not None:
            then, shown = self._shown
            passed = now - then
            share = 1.0 - math.exp(-passed / max(_SLOW * (now - self._begun), _SLOWEST))
            expected = max(shown - passed, 0.0) + share * (expected - max(shown - passed, 0.0))
        self._shown = now, expected
        return expected

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
            self._seconds += seconds
            insort(self._paces[kind], seconds / (PLAN[self._at].fit if kind else PLAN[self._at].look))
            now = self._clock()
            if now < self._next:
                return
            self._next = now + _EVERY
            done, left = sum(self._done), sum(self.left())
            time = ""
            if len(self._paces[0]) >= min(2 * self._candidates, _FEWEST):
                time = f", about {_time(self._steady(now))} left"
        again = " again, the step's own error taken off:" if self._again else ""
        text = f"weigh{again} {done}/{done + left} candidates and fits{time}"
        self._report(Share("weigh", done, done + left, text))


def _typical(rising: Sequence[float]) -> float:
    """Mean time in which outliers, such as compilations, are limited to some medians."""
    most = _OUTLYING * rising[len(rising) // 2] if rising else 0.0
    return sum(min(one, most) for one in rising) / max(len(rising), 1)


def _time(seconds: float) -> str:
    return f"{max(seconds, 1.0):.0f} s" if seconds < 90.0 else f"{seconds / 60.0:.0f} min"


_current: ContextVar[SearchProgress | None] = ContextVar("search progress", default=None)


@contextmanager
def progress_reported(progress: SearchProgress | None) -> Iterator[None]:
    """Count searches within this context."""
    token = _current.set(progress)
    try:
        yield
    finally:
        _current.reset(token)


def stage(name: str) -> None:
    """Report that a stage of `PLAN` begins."""
    progress = _current.get()
    if progress is not None:
        progress.stage(name)


def twice() -> None:
    """The search will probably be repeated: see `SearchProgress.twice`."""
    progress = _current.get()
    if progress is not None:
        progress.twice()


def counted_calls(function: Callable[[_In], _Out], fits: bool, workers: int) -> Callable[[_In], _Out]:
    """A function whose calls are counted, if anyone counts; see `SearchProgress.counted`."""
    progress = _current.get()
    return function if progress is None else progress.counted(function, fits, workers)
