"""What a law of the library is."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....base.compiled_functions import cfunc
from ....base.units import known_unit, parse_unit
from ..calls import SIGNATURE

_DIMENSIONS = {
    "force": ("N", "N.m"), "rate": ("m/s", "rad/s"), "travel": ("m", "rad"), "electric": ("V", "A"),
    "temperature": ("K",), "flow": ("W", "kg/s", "m3/s"), "pressure": ("Pa",), "angle": ("rad",),
    "current": ("A",),
}  # fmt: skip
# Places where something can flow off, or through.
_FLOWS = ("flow", "rate", "number", "share", "temperature", "pressure", "")
_PLACES = {"force": ("force", "number"), "flow": _FLOWS, "electric": ("electric",)}


@cache
def _measured(unit: str) -> tuple[str, ...]:
    """All that a unit measures: keys of `_DIMENSIONS`; "number", which may be anything; or "share": %."""
    found = known_unit(unit)
    if found is None:
        return ()
    if not any(found.exponents):
        return ("number" if found.factor == 1 else "share",)
    return tuple(
        what
        for what, units in _DIMENSIONS.items()
        if any(parse_unit(one).same_dimension(found) for one in units)
    )


def dimension(unit: str) -> str:
    """What a unit measures: a key of `_DIMENSIONS` ("force" is a torque, too), "number", "share", or ""."""
    return next(iter(_measured(unit)), "")


@dataclass(frozen=True)
class Number:
    """One of a law's numbers.

    Attributes:
        name: of it.
        unit: with `w` for the unit at the place, `u` for that of the signal, `v` for that of the second one.
        starts: where fits begin, in multiples of `by`.
        by: "one"; the signal's "spread", its largest size ("most"), the spread of its "slope", its spread
            times the interval ("step"); the "interval" of the logs, one over it ("rate"), the length of a
            "run"; the frequency of a "tone" that calibration leaves [rad/s], 0 if it leaves none; of the
            second signal its largest size ("second") and "second step"; the "product" of both spreads.
            "range", "second range": parts of the way from the lowest to the highest value.
        most: largest size, times the signal's spread; a fit beyond it is another law.
        limits: least and largest value; a fit beyond them is another law.
        positive: whether its sign means nothing.
        scanned: share of it by which fits may miss it, since they end at the nearest of many minima.
        within: whether it, or its negative if `positive`, lies within the signal's range; a fit beyond it is
            another law.
    """

    name: str
    unit: str
    starts: tuple[float, ...] = (1.0,)
    by: str = "spread"
    most: float = math.inf
    limits: tuple[float, float] = (-math.inf, math.inf)
    positive: bool = False
    scanned: float = 0.0
    within: bool = False

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
            s[0] is the signal, s[1] the second one, s[2] the interval of the logs [s].
        reads: "rate", "travel", "angle", "temperature", "current", "own" (the signal at the place), "other"
            (any but that), or "any" of the component. second: what a second signal of the component measures;
            "": it reads one.
        states: of its own, which start at 0. settled: those, from 0, which start at the signal.
        kinds: places where it acts, as in `Kinds`; empty: all but exchanges between two states.
        linear: whether w is proportional to the amplitude.
        at: "force" for laws that make forces and torques, which act only at such a place or at the
            derivative of a speed; "flow" for what flows off or through; "electric" for voltages and currents;
            empty: at any place.
        modelica: its equations, of the signal u, the numbers by their names, the states z1, z2, and y = w.
            Without them an answer is not written as a model.
        odds: how likely the law is before the logs are seen, against others. A number that may be wrong is
            listed in the study, so that a gain or an offset elsewhere is less likely.
        unlogged: factor of the odds at a motion or a temperature that is not logged. Such signals join parts
            of a machine, which keep no offset against each other; what is logged has passed a sensor. With
            0 the law is not tried there.
        rare: whether it is tried only where the other laws leave more than the noise. It then has to
            close 30 % of what they leave.
        covers: range of the signal that shows the law: a ripple of which less is seen looks like others.
        delay: "fixed" if it delays the signal by its first number, "held" if it holds a sample for so long.
            Simulations look the signal up in the past; `code` is what a filter takes instead.
        unit: whose zero the signal must have, K or degC, where the law counts from absolute zero.
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
    unlogged: float = 1.0
    second: str = ""
    settled: tuple[int, ...] = ()
    rare: bool = False
    covers: float = 0.0
    delay: str = ""
    unit: str = ""

    @cached_property
    def compiled(self) -> Any:
        """The machine code."""
        return cfunc(SIGNATURE)(self.code)

    @property
    def address(self) -> int:
        """Of the machine code."""
        return int(self.compiled.address)

    def values(
        self, time: NDArray[np.float64], signal: NDArray[np.float64], numbers: Any, interval: float = 1.0
    ) -> NDArray[np.float64]:
        """w along a signal, shape (n,), or along two, shape (n, 2).

        With states, times are `interval` apart; the states take eight steps of Euler an interval.
        """
        out, made, s = np.zeros(8), np.empty(len(time)), np.zeros(3)
        n, z = np.asarray(numbers, np.float64), np.zeros(max(1, self.states))
        signals = signal.reshape(len(time), -1)
        z[list(self.settled)] = signals[0, 0]
        width, s[2] = signals.shape[1], interval
        for k in range(len(time)):
            s[:width] = signals[k]
            self.code(time[k], s, n, z, out)
            made[k] = out[0]
            if self.states and k + 1 < len(time):
                for part in range(8):
                    s[:width] = signals[k] + (signals[k + 1] - signals[k]) * part / 8.0
                    self.code(time[k] + interval * part / 8.0, s, n, z, out)
                    z += interval / 8.0 * out[1 : 1 + self.states]
        return made

    def starts(self, sizes: Mapping[str, float], begins: Mapping[str, float]) -> list[list[float]]:
        """Numbers where fits begin; 1 for the amplitude, if w is proportional to it.

        Args:
            sizes: by each `Number.by`. begins: what is added, 0 where it is not there.
        """
        grids: list[list[float]] = [[]]
        for number in self.numbers[1 if self.linear else 0 :]:
            begin, size = begins.get(number.by, 0.0), sizes[number.by]
            grids = [[*some, begin + start * size] for some in grids for start in number.starts]
        return [[1.0, *some] if self.linear else some for some in grids]

    def typical(self, middles: Any, spreads: Any, numbers: Any, interval: float, length: float) -> float:
        """Size of w along signals around such middles of such spreads, in a run of such a length [s]."""
        if self.states:
            time = interval * np.arange(40.0)
            wave = 1.5 * np.sin(0.4 * np.arange(40.0))
        else:
            time, wave = np.full(3, length), np.array([-2.0, 1.0, 4.0])
        return float(np.abs(self.values(time, middles + np.outer(wave, spreads), numbers, interval)).max())

    def fits(self, unit: str, own: bool, place: str) -> bool:
        """Whether it reads a signal of such a unit, and acts at a place of such a dimension."""
        if self.at and place not in _PLACES[self.at]:
            return False
        if self.reads in ("own", "other"):
            return own is (self.reads == "own")
        if self.reads != "any" and self.reads not in _measured(unit) and dimension(unit) != "number":
            return False
        return not self.unit or parse_unit(unit).offset == parse_unit(self.unit).offset

    def fits_second(self, unit: str) -> bool:
        """Whether its second signal has such a unit."""
        return self.second == "any" or self.second in _measured(unit)
