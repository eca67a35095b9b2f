"""Effects on connections as transfer functions."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from ..base.arrays import Array
from ..effects import Effect
from ..effects.backlash import Backlash
from ..effects.choose import BUILT_IN, built_in
from ..effects.dead_band import DeadBand
from ..effects.delay import Delay
from ..effects.gain import Gain
from ..effects.low_pass import LowPass
from ..effects.noise import Noise
from ..effects.offset import Offset
from ..effects.quantise import Quantise
from ..effects.rate_limit import RateLimit
from ..effects.relay import Relay
from ..effects.sample_and_hold import SampleAndHold
from ..effects.saturate import Saturate


class Path(NamedTuple):
    """gain * exp(-delay s) / (1 + lag s) of an effect.

    Attributes:
        delay, lag: [s].
    """

    gain: float = 1.0
    delay: float = 0.0
    lag: float = 0.0


# The exact class counts: what a subclass of a user's does is not known.
_LINEAR: Mapping[type[Effect], Callable[[Any], Path]] = {
    Gain: lambda effect: Path(effect.factor),
    Offset: lambda effect: Path(),
    Delay: lambda effect: Path(delay=effect.time),
    LowPass: lambda effect: Path(lag=effect.numbers()[0]),
    SampleAndHold: lambda effect: Path(delay=0.5 * effect.period),
}
_LEFT_OUT = (Saturate, Quantise, RateLimit, DeadBand, Backlash, Noise, Relay)


def effect_path(effect: Effect) -> Path | None:
    """What a bundled effect does around its operating point; None of any other.

    A hold counts as a delay of half its period. Effects that are not linear count as one.
    """
    if type(effect) in _LEFT_OUT:
        return Path()
    made = _LINEAR.get(type(effect))
    return None if made is None else made(effect)


def known_effects() -> tuple[str, ...]:
    """Names of the bundled effects that have a transfer function here."""
    return tuple(name for name in BUILT_IN if built_in(name) in (*_LINEAR, *_LEFT_OUT))


def effect_note(effect: Effect) -> str:
    """What the transfer function leaves out; empty if nothing."""
    if isinstance(effect, Relay) and effect.level:
        return "switches and has no slope; it counts as gain 1, --limit-cycles says what it does"
    if type(effect) in _LEFT_OUT:
        return "is not linear and is left out"
    if isinstance(effect, SampleAndHold) and effect.period:
        return "counts as a delay of half a period"
    return ""


class _Law(Protocol):
    """A linear effect from instant to instant, on many columns at once."""

    size: int

    def advance(self, memory: Array, x: Array) -> Array:
        """The memory with the instant's value in it."""

    def value(self, memory: Array, x: Array) -> Array:
        """What comes out at the instant that the memory ends with."""


class _Factor:
    def __init__(self, factor: float) -> None:
        self.size, self.factor = 0, factor

    def advance(self, memory: Array, x: Array) -> Array:
        return memory

    def value(self, memory: Array, x: Array) -> Array:
        return self.factor * x


class _Later:
    """A delay: on the line between two instants."""

    def __init__(self, delay: float, step: float) -> None:
        self.whole = math.floor(delay / step + 1e-9)
        self.share = max(delay / step - self.whole, 0.0)
        self.size = self.whole + 2

    def advance(self, memory: Array, x: Array) -> Array:
        return np.concatenate([x[None], memory[:-1]])

    def value(self, memory: Array, x: Array) -> Array:
        return (1.0 - self.share) * memory[self.whole] + self.share * memory[self.whole + 1]


class _Lag:
    """A first-order lag, exact for lines between instants. Memory: x and y."""

    def __init__(self, lag: float, step: float) -> None:
        self.size, ratio = 2, step / lag
        self.gone = -math.expm1(-ratio)
        self.rest = 1.0 - self.gone / ratio

    def advance(self, memory: Array, x: Array) -> Array:
        old, y = memory
        return np.array([x, y + self.gone * (old - y) + self.rest * (x - old)])

    def value(self, memory: Array, x: Array) -> Array:
        return memory[1]


class _Held:
    """A sample that is held. Memory: the sample, and the signal one instant ago."""

    size = 2

    def __init__(self, period: float, phase: float, step: float, instant: int) -> None:
        latest, before = (math.floor((one * step - phase) / period + 1e-6) for one in (instant, instant - 1))
        behind = max(instant * step - phase - latest * period, 0.0) / step
        self.samples, self.share = latest > before, behind if behind > 1e-6 else 0.0

    def advance(self, memory: Array, x: Array) -> Array:
        held, old = memory
        return np.array([x + self.share * (old - x) if self.samples else held, x])

    def value(self, memory: Array, x: Array) -> Array:
        return memory[0]


class Feed:
    """A connection's signal from instant to instant: effects in turn, with what they remember.

    Attributes:
        size: rows of its memory.
    """

    def __init__(
        self,
        effects: Sequence[Effect],
        step: float,
        instant: int,
    ) -> None:
        """Args: instant: number of the point that `advance` leads to, since the first sample of holds."""
        laws: list[_Law] = []
        for effect in effects:
            if isinstance(effect, SampleAndHold) and effect.period:
                laws.append(_Held(effect.period, effect.phase, step, instant))
                continue
            numbers = effect.numbers()
            if isinstance(effect, Gain):
                laws.append(_Factor(effect.factor))
            elif isinstance(effect, Delay) and numbers[0]:
                laws.append(_Later(numbers[0], step))
            elif isinstance(effect, LowPass) and numbers[0]:
                laws.append(_Lag(numbers[0], step))
        self._laws = laws
        self._rows = np.cumsum([0, *(law.size for law in laws)])
        self.size = int(self._rows[-1])

    def lines(self) -> list[tuple[int, int]]:
        """Rows of the memory that move on by one at each instant: the first, and how many of them."""
        return [
            (int(low), law.size)
            for law, low in zip(self._laws, self._rows, strict=False)
            if isinstance(law, _Later)
        ]

    def advance(self, memory: Array, x: Array) -> tuple[Array, Array]:
        """The memory with one more instant, and the signal there; x: sum of the sources, shape (columns,)."""
        kept = memory.copy()
        for law, low, high in zip(self._laws, self._rows[:-1], self._rows[1:], strict=True):
            kept[low:high] = law.advance(memory[low:high], x)
            x = law.value(kept[low:high], x)
        return kept, x
