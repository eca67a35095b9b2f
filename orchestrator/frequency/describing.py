"""Limit cycles that an effect which is not linear predicts: its describing function, then harmonic balance.

A sine of amplitude A goes through the effect as a run has it; N(A) is the first harmonic of what comes out
over that of the sine (Gelb, Vander Velde, Multiple-Input Describing Functions, 1968). The loop oscillates
where 1 + N(A) L(j omega) = 0, with L the loop opened at the connection. From there the balance of several
harmonics is solved: E_k + L(j k omega) Y_k = 0, with E_k those of what enters the effect and Y_k those of
what comes out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..base.arrays import Array, Complex
from ..effects import Effect
from ..effects.backlash import Backlash
from ..effects.dead_band import DeadBand
from ..effects.quantise import Quantise
from ..effects.rate_limit import RateLimit
from ..effects.relay import Relay
from ..effects.saturate import Saturate
from ..simulation.run import Prepared
from .from_system import Linearised

_KINDS = (Saturate, DeadBand, Backlash, Quantise, RateLimit, Relay)
# Samples of a period, and periods until a memory has settled.
_SAMPLES, _SETTLED = 2048, 2
# Of the harmonic balance: the highest harmonic, samples of a period, and what may be left of it.
_HARMONICS, _BALANCE_SAMPLES, _BALANCED = 15, 512, 1e-5
# Of a relay: the highest harmonic, and samples of a period.
_SWITCHING_HARMONICS, _SWITCHING_SAMPLES = 2001, 16384
# A balance that ends further away than this factor is another oscillation.
_NEAR = 2.0
# Amplitudes over the size of the effect, from and to, and how many.
_AMPLITUDES = np.geomspace(0.05, 1e3, 240)
_FREQUENCIES = 600


@dataclass(frozen=True)
class LimitCycle:
    """An oscillation that a describing function predicts.

    Attributes:
        connection, effect: which effect, and where.
        amplitude: half of the range of the signal that enters the effect, in the unit of the connection's
            target.
        omega: [rad/s].
        stable: whether oscillations beside it come back to it; else it parts those that grow from those that
            decay.
        first_amplitude, first_omega: by the first harmonic alone.
        balanced: whether the balance of several harmonics was found; if not, all is by the first alone.
    """

    connection: str
    effect: str
    amplitude: float
    omega: float
    stable: bool
    first_amplitude: float
    first_omega: float
    balanced: bool

    @property
    def frequency(self) -> float:
        """[Hz]."""
        return self.omega / (2.0 * np.pi)


def describing_function(effect: Effect, amplitude: float, omega: float = 1.0, mean: float = 0.0) -> complex:
    """N(A): first harmonic of what comes out over that of a sine.

    Args:
        effect: without a delay of its own.
        amplitude: of the sine; omega: its frequency [rad/s], which counts for limits of a rate.
        mean: that the sine swings around.
    """
    options = effect.numbers()
    memory = np.zeros(max(effect.room(2.0 * np.pi / omega / _SAMPLES), 1))
    phase = 2.0 * np.pi * np.arange(_SAMPLES * (_SETTLED + 1)) / _SAMPLES
    values = mean + amplitude * np.sin(phase)
    answer = np.array(
        [
            type(effect).kernel(float(angle) / omega, [float(value)], options, memory, True)
            for angle, value in zip(phase, values, strict=True)
        ]
    )
    last = slice(_SAMPLES * _SETTLED, None)
    return complex(2j * np.mean(answer[last] * np.exp(-1j * phase[last])) / amplitude)


def limit_cycles(prepared: Prepared, linear: Linearised) -> list[LimitCycle]:
    """All limit cycles that effects which are not linear predict, each with the others as in the linear
    system.

    Args:
        prepared: the checked system; linear: what `linearise` gave for it.
    """
    found = []
    for connection in prepared.system.connections:
        wire, name = connection.wire, str(connection)
        if wire is None or name not in linear.system.loops():
            continue
        # What the target gets is gain times what the effects give.
        mean = (linear.point.get(str(connection.target), 0.0) - connection.offset) / connection.gain
        for link in wire.links:
            if isinstance(link.effect, _KINDS):
                found += _of(linear, name, link.name, link.effect, mean)
    return found


def _size(effect: Any) -> float:
    """What amplitudes are measured by."""
    numbers = [abs(one) for one in effect.numbers() if np.isfinite(one) and one]
    return max(numbers, default=0.0)


def _of(linear: Linearised, connection: str, name: str, effect: Effect, mean: float) -> list[LimitCycle]:
    from scipy.optimize import root  # slow to import

    size = _size(effect)
    if not size:
        return []
    limited = isinstance(effect, RateLimit)
    # A limit of the rate acts on amplitude times frequency.
    mean = mean if isinstance(effect, Saturate) else 0.0
    amplitudes = size * _AMPLITUDES
    function = np.array([describing_function(effect, one, 1.0, mean) for one in amplitudes])
    grid = linear.system.frequencies(linear.modes())
    omega = np.geomspace(grid[0], grid[-1], _FREQUENCIES)
    omega = np.unique(np.concatenate([omega, grid[:: max(1, len(grid) // 1500)]]))
    response = linear.system.open_loop(connection, omega)
    logs = np.log(amplitudes)

    def n(log: float) -> complex:
        return complex(np.interp(log, logs, function.real), np.interp(log, logs, function.imag))

    value = 1.0 + function[:, None] * response
    found: list[LimitCycle] = []
    for row, column in _cells(value):
        at = np.log(omega)
        begin = np.array([logs[row] + 0.5 * (logs[1] - logs[0]), 0.5 * (at[column] + at[column + 1])])

        def miss(x: Array) -> Array:
            one = 1.0 + n(x[0]) * complex(linear.system.open_loop(connection, np.exp(x[1]))[0])
            return np.array([one.real, one.imag])

        solved = root(miss, begin, method="hybr", options={"xtol": 1e-10})
        if not (np.max(abs(miss(solved.x))) < 1e-6 and logs[0] < solved.x[0] < logs[-1]):
            continue
        amplitude, frequency = np.exp(solved.x)
        exact = describing_function(effect, float(amplitude), 1.0, mean)
        loop = complex(linear.system.open_loop(connection, frequency)[0])
        if abs(1.0 + exact * loop) > 0.05:  # the function jumps between two amplitudes
            continue
        amplitude = amplitude / frequency if limited else amplitude
        if any(
            abs(one.first_omega / frequency - 1.0) < 1e-4
            and abs(one.first_amplitude / amplitude - 1.0) < 1e-3
            for one in found
        ):
            continue
        stable = _comes_back(linear, connection, n, solved.x)
        first = float(amplitude), float(frequency)
        if isinstance(effect, Relay):
            balance = _switching(linear, connection, effect, first[1])
        else:
            balance = _balance(linear, connection, effect, mean, *first)
        found.append(LimitCycle(connection, name, *(balance or first), stable, *first, balance is not None))
    return found


def _answer(effect: Effect, values: Array, omega: float) -> Array:
    """What comes out of an effect that a periodic signal has settled in, shape of the samples of a period."""
    step = 2.0 * np.pi / omega / len(values)
    options, memory = effect.numbers(), np.zeros(max(effect.room(step), 1))
    kernel = type(effect).kernel
    for turn in range(_SETTLED + 1):
        begin = turn * len(values)
        answer = [
            kernel((begin + index) * step, [value], options, memory, True)
            for index, value in enumerate(values.tolist())
        ]
    return np.array(answer)


def _balance(
    linear: Linearised, connection: str, effect: Effect, mean: float, amplitude: float, omega: float
) -> tuple[float, float] | None:
    """Amplitude and frequency by several harmonics, from those by the first; None if they are not found."""
    from scipy.optimize import root

    # Effects are odd: around a mean that is not 0 there are even harmonics, too.
    orders = np.arange(1, _HARMONICS + 1, 1 if mean else 2)
    phase = 2.0 * np.pi * np.arange(_BALANCE_SAMPLES) / _BALANCE_SAMPLES
    waves = np.exp(1j * np.outer(orders, phase))

    def entering(x: Array) -> Array:
        parts = np.concatenate([[1.0], x[2:].view(np.complex128)])
        return mean + amplitude * np.exp(x[0]) * np.real(parts @ waves)

    def coming_back(x: Array) -> Complex:
        size, w = amplitude * np.exp(x[0]), omega * np.exp(x[1])
        answer = _answer(effect, entering(x), w)
        harmonics = 2.0 * np.mean(answer * waves.conj(), axis=1)
        return linear.system.open_loop(connection, orders * w) * harmonics / size

    def miss(x: Array) -> Array:
        parts = np.concatenate([[1.0], x[2:].view(np.complex128)])
        return (parts + coming_back(x)).view(np.float64)

    begin = np.zeros(2 * len(orders))
    begin[2:] = -coming_back(begin)[1:].view(np.float64)
    solved = root(miss, begin, method="hybr", options={"xtol": 1e-9})
    near = np.all(abs(solved.x[:2]) < np.log(_NEAR))
    if not near or not np.max(abs(miss(solved.x))) < _BALANCED:
        return None
    course = entering(solved.x)
    return 0.5 * float(np.ptp(course)), float(omega * np.exp(solved.x[1]))


def _switching(linear: Linearised, connection: str, relay: Relay, omega: float) -> tuple[float, float] | None:
    """Amplitude and frequency where a relay switches at its thresholds, from those by the first harmonic.

    A relay gives a square wave whatever enters it, so that all harmonics are known: it switches up where
    sum of 4 level/(pi k) Im L(j k omega) over odd k is minus half of its width (Tsypkin).
    """
    from scipy.optimize import brentq

    orders = np.arange(1, _SWITCHING_HARMONICS + 1, 2)

    def entering(w: float) -> Complex:
        return -linear.system.open_loop(connection, orders * w) * 4.0 * relay.level / (np.pi * orders)

    def early(log: float) -> float:
        return float(np.sum(entering(omega * np.exp(log)).imag)) - 0.5 * relay.width

    logs = np.linspace(-np.log(_NEAR), np.log(_NEAR), 41)
    values = np.array([early(one) for one in logs])
    places = np.flatnonzero(values[:-1] * values[1:] <= 0.0)
    if not len(places):
        return None
    place = places[np.argmin(abs(logs[places]))]
    found = omega * float(np.exp(brentq(early, logs[place], logs[place + 1], xtol=1e-12)))
    spectrum = np.zeros(_SWITCHING_SAMPLES // 2 + 1, np.complex128)
    spectrum[orders] = -0.5j * _SWITCHING_SAMPLES * entering(found)
    return 0.5 * float(np.ptp(np.fft.irfft(spectrum))), found


def _cells(value: Complex) -> list[tuple[int, int]]:
    """Cells of a grid in whose corners both parts change their sign."""
    corners = np.array([value[:-1, :-1], value[1:, :-1], value[:-1, 1:], value[1:, 1:]])
    changes = [(part.min(axis=0) <= 0.0) & (part.max(axis=0) >= 0.0) for part in (corners.real, corners.imag)]
    rows, columns = np.nonzero(changes[0] & changes[1])
    return list(zip(rows.tolist(), columns.tolist(), strict=True))


def _comes_back(linear: Linearised, connection: str, n: Any, x: Array) -> bool:
    """Whether the root of 1 + N(A) L(s) moves to the left with a larger amplitude."""
    log, s = x[0], 1j * np.exp(x[1])
    step = 1e-5 * abs(s)
    loop, ahead = linear.system.response(connection, np.array([s, s + step]))
    slope = (ahead - loop) / step
    change = (n(log + 0.02) - n(log - 0.02)) / 0.04
    return bool((-(change * loop) / (n(log) * slope)).real < 0.0)


def limit_cycles_text(cycles: Sequence[LimitCycle]) -> str:
    """Limit cycles in lines for terminals."""
    if not cycles:
        return "no effect predicts a limit cycle"
    lines = ["limit cycles, by harmonic balance and by the first harmonic alone (describing function):"]
    for one in cycles:
        kind = "stable" if one.stable else "unstable: larger ones grow, smaller ones decay"
        place = f"{one.effect} on {one.connection}"
        first = f"{one.first_omega / (2.0 * np.pi):.4g} Hz, {one.first_amplitude:.4g}"
        if one.balanced:
            found = (
                f"{one.frequency:.4g} Hz, amplitude {one.amplitude:.4g} before it (first harmonic: {first})"
            )
        else:
            found = f"{first} by the first harmonic; no balance of {_HARMONICS} harmonics was found near it"
        lines.append(f"  {place}: {found}; {kind}")
    return "\n".join(lines)
