"""A progress bar for runs that last."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import monotonic
from typing import Any, TextIO

from ..fmi import Array, Point
from ..system.signal_vector import Signals

_EVERY = 64
_SECONDS_UNTIL_SHOWN = 2.0


class Progress:
    """An observer that shows a bar on a terminal, from two seconds after its making on."""

    def __init__(self, points: int, label: str = "", file: TextIO | None = None) -> None:
        """
        Args:
            points: number of communication points of the complete run.
            label: stands before the bar.
            file: where to; the standard error by default.
        """
        self._points = points
        self._label = label
        self._file = file or sys.stderr
        self._shown = self._file.isatty()
        self._begin = monotonic()
        self._bar: Any = None
        self._done = 0

    def __call__(self, point: Point, signals: Signals) -> None:
        """Note a point."""
        if point.index % _EVERY == 0:
            self._show(point.index)

    def observe_block(self, first: int, times: Array, values: Array) -> None:
        """Note consecutive points."""
        self._show(first + len(times) - 1)

    def _show(self, index: int) -> None:
        if not self._shown:
            return
        if self._bar is None:
            if monotonic() - self._begin < _SECONDS_UNTIL_SHOWN:
                return
            # Imported late: most runs are over before a bar is wanted.
            from tqdm import tqdm

            self._bar = tqdm(total=self._points, desc=self._label, unit="step", file=self._file, leave=False)
        self._bar.update(index - self._done)
        self._done = index

    def close(self) -> None:
        """Take the bar away."""
        if self._bar is not None:
            self._bar.close()
            self._bar = None


@contextmanager
def counting(total: int, label: str, unit: str, shown: bool = True) -> Iterator[Callable[..., None]]:
    """A bar with rate and remaining time on a terminal, after two seconds; nothing elsewhere.

    Args:
        total: how many there are, if that is known.
        unit: what is counted.
        shown: whether it is wanted.
    Returns: advance(done, of, note=""): how many are done, of how many, and what to show beside it.
    """
    from tqdm import tqdm

    with tqdm(
        total=total or None,
        desc=label,
        unit=unit,
        file=sys.stderr,
        disable=None if shown else True,
        delay=_SECONDS_UNTIL_SHOWN,
        dynamic_ncols=True,
    ) as bar:

        def advance(done: int, of: int, note: str = "") -> None:
            if bar.disable:
                return
            bar.total = of
            if bar.n == 0 and done > 1:
                bar.initial = done  # what was there before says nothing of the rate
            if note:
                bar.set_postfix_str(note, refresh=False)
            bar.update(done - bar.n)

        yield advance
