"""What a law of the library is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....base.compiled_functions import cfunc
from ..calls import SIGNATURE

__all__ = ["RATES", "TRAVELS", "Law", "Number"]

# Units of signals that are speeds, and that are positions.
RATES = frozenset({"m/s", "rad/s", "mm/s", "deg/s", "rpm"})
TRAVELS = frozenset({"m", "rad", "mm", "deg"})


@dataclass(frozen=True)
class Number:
    """One of a law's numbers.

    Attributes:
        name: of it. unit: with `w` for the unit at the place and `s` for that of the signal.
        starts: where fits begin; times the signal's spread where `relative`, or, of laws with states, times
            the interval of the logs.
    """

    name: str
    unit: str
    starts: tuple[float, ...] = (1.0,)
    relative: bool = True


@dataclass(frozen=True)
class Law:
    """A law w = g(signal; numbers), the first number of which is its amplitude.

    Attributes:
        name, family: families hold laws that logs often cannot tell apart.
        numbers: the amplitude first. sentence: where it occurs.
        code: writes out[0] = w and out[1:] = derivatives of its states; arguments (t, s, n, z, out).
        reads: "rate", "travel", "own" (the signal at the place) or "any" signal of the component.
        states: of its own. kinds: places where it acts, as in `Kinds`; empty: all.
        linear: whether w is proportional to the amplitude.
    """

    name: str
    family: str
    numbers: tuple[Number, ...]
    code: Callable[..., None]
    reads: str = "any"
    states: int = 0
    kinds: tuple[int, ...] = ()
    sentence: str = ""
    linear: bool = True

    @cached_property
    def compiled(self) -> Any:
        """The machine code."""
        return cfunc(SIGNATURE)(self.code)

    @property
    def address(self) -> int:
        """Of the machine code."""
        return int(self.compiled.address)

    def values(
        self, time: NDArray[np.float64], signal: NDArray[np.float64], numbers: Any
    ) -> NDArray[np.float64]:
        """w along a signal, shape (n,), of a law without states."""
        out, made = np.zeros(8), np.empty(len(time))
        code, rest = self.code, np.zeros(1)
        n = np.asarray(numbers, np.float64)
        for k in range(len(time)):
            code(time[k], signal[k : k + 1], n, rest, out)
            made[k] = out[0]
        return made

    def fits(self, unit: str, own: bool) -> bool:
        """Whether it reads a signal of such a unit."""
        if self.reads == "own":
            return own
        if self.reads == "rate":
            return unit in RATES
        if self.reads == "travel":
            return unit in TRAVELS
        return True
