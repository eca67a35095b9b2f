"""What a law of the library is."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....base.compiled_functions import cfunc
from ....base.units import UnitError, parse_unit
from ..calls import SIGNATURE

__all__ = ["Law", "Number", "dimension"]

_DIMENSIONS = {
    "force": ("N", "N.m"), "rate": ("m/s", "rad/s"), "travel": ("m", "rad"), "electric": ("V", "A"),
    "temperature": ("K",), "flow": ("W", "kg/s", "m3/s"),
}  # fmt: skip
# Places where something can flow off, or through.
_FLOWS = ("flow", "rate", "number", "temperature", "")


@cache
def dimension(unit: str) -> str:
    """What a unit measures: a key of `_DIMENSIONS` ("force" is a torque, too), "number", or ""."""
    try:
        found = parse_unit(unit)
    except UnitError:
        return ""
    if not any(found.exponents):
        return "number"
    return next(
        (
            what
            for what, units in _DIMENSIONS.items()
            if any(parse_unit(one).same_dimension(found) for one in units)
        ),
        "",
    )


@dataclass(frozen=True)
class Number:
    """One of a law's numbers.

    Attributes:
        name: of it. unit: with `w` for the unit at the place and `u` for that of the signal.
        starts: where fits begin, in multiples of `by`: the signal's "spread", the "interval" of the logs, one
            over it ("rate"), or "one".
        most: largest size, times the signal's spread; a fit beyond it is another law.
        positive: whether its sign means nothing.
    """

    name: str
    unit: str
    starts: tuple[float, ...] = (1.0,)
    by: str = "spread"
    most: float = math.inf
    positive: bool = False

    @property
    def word(self) -> str:
        """Its name in `Law.modelica`."""
        word = re.sub(r"\W", "_", self.name)
        return f"{word}_" if word in ("time", "value") else word


@dataclass(frozen=True)
class Law:
    """A law w = g(signal; numbers), the first number of which is its amplitude.

    Attributes:
        name, family: families hold laws that logs often cannot tell apart.
        numbers: the amplitude first. sentence: where it occurs.
        code: writes out[0] = w and out[1:] = derivatives of its states; arguments (t, s, n, z, out).
        reads: "rate", "travel", "temperature", "own" (the signal at the place), or "any" of the component.
        states: of its own. kinds: places where it acts, as in `Kinds`; empty: all.
        linear: whether w is proportional to the amplitude.
        at: "force" for laws that make forces and torques, which act only at such a place or at the
            derivative of a speed; "flow" for what flows off or through; empty: at any place.
        modelica: its equations, of the signal u, the numbers by their names, the states z1, z2, and y = w.
            Without them an answer is not written as a model.
        odds: how likely the law is before the logs are seen, against others. A number that may be wrong is
            listed in the study, so that a gain or an offset elsewhere is less likely.
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
    at: str = ""
    modelica: str = ""
    odds: float = 1.0

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

    def fits(self, unit: str, own: bool, place: str) -> bool:
        """Whether it reads a signal of such a unit, and acts at a place of such a dimension."""
        if self.at and place not in {"force": ("force", "number"), "flow": _FLOWS}[self.at]:
            return False
        if self.reads == "own":
            return own
        return self.reads == "any" or dimension(unit) in (self.reads, "number")
