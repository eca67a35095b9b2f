"""How far a search for effects is: candidates looked at and fits made, of how many, and the time left."""

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

__all__ = ["PLAN", "Tally", "stage", "tallied", "telling", "twice"]

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
# Seconds until told, and until told again; what is reported follows what is expected within this share of the
# time passed, and so many seconds at least.
_FIRST, _EVERY, _SLOW, _SLOWEST = 2.0, 0.5, 0.2, 3.0


class Tally:
    """Counts what a search does, and says how far it is.

    The time left is what stages that are to come usually do, at the pace of this search so far. What is told
    of it runs down with the clock and follows what is expected slowly, so that no stage that is left out, or
    made anew, makes it jump. A search that begins anew is that of `steps`, and is told as such; the time that
    it takes counts from when `twice` is reported.

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
        self._told: tuple[float, float] | None = None
        self._begun = clock()
        self._next = self._begun + _FIRST

    def stage(self, name: str) -> None:
        """A stage of the plan begins, perhaps anew; those before it are over."""
        with self._lock:
            if PLAN[self._at].name == name and name != "candidates":
                return  # the same with one effect more
            self._again |= name == "candidates" and self._at > 0
            after = [at for at in range(self._at + 1, len(PLAN)) if PLAN[at].name == name]
            before = [at for at in range(self._at + 1) if PLAN[at].name == name]
            self._at = after[0] if after and name != "candidates" else (before or after)[-1]
            self._own = [0, 0]

    def twice(self) -> None:
        """All is likely to be sought a second time."""
        with self._lock:
            self._twice = True

    def left(self) -> tuple[int, int]:
        """Looks and fits that the plan still holds."""
        left = self._left()
        return round(sum(one.looks for one in left)), round(sum(one.fits for one in left))

    def _left(self) -> list[_Planned]:
        """What is left of each stage; looks counted, not by candidate."""
        plan = [*PLAN[self._at :], *(PLAN[:-1] if self._twice and not self._again else ())]
        now, *later = (one._replace(looks=one.looks * self._candidates) for one in plan)
        looks, fits = self._own
        own = now._replace(looks=max(now.looks - looks, 0.0), fits=max(now.fits - fits, 0.0))
        return [own, *later]

    def _expected(self, now: float) -> float:
        """Seconds that what is left takes, at the pace so far, with what goes on between looks and fits."""
        look = _typical(self._paces[0])
        fits = self._paces[1]
        fit = (sum(fits) + _BELIEVED * _FIT * look) / (len(fits) + _BELIEVED)
        counted = sum(one.looks * one.look * look + one.fits * one.fit * fit for one in self._left())
        return counted * max((now - self._begun) / max(self._seconds, 1e-9), 1.0)

    def _steady(self, now: float) -> float:
        """Seconds left as they are reported, see `Tally`."""
        expected = self._expected(now)
        if self._told is not None:
            then, told = self._told
            passed = now - then
            share = 1.0 - math.exp(-passed / max(_SLOW * (now - self._begun), _SLOWEST))
            expected = max(told - passed, 0.0) + share * (expected - max(told - passed, 0.0))
        self._told = now, expected
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
    """The mean of what a few times of all, as those that compile a law, do not count beyond some medians."""
    most = _OUTLYING * rising[len(rising) // 2] if rising else 0.0
    return sum(min(one, most) for one in rising) / max(len(rising), 1)


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


def twice() -> None:
    """All is likely to be sought a second time: see `Tally.twice`."""
    tally = _current.get()
    if tally is not None:
        tally.twice()


def tallied(function: Callable[[_In], _Out], fits: bool, workers: int) -> Callable[[_In], _Out]:
    """A function whose calls are counted, if anyone counts; see `Tally.counted`."""
    tally = _current.get()
    return function if tally is None else tally.counted(function, fits, workers)
