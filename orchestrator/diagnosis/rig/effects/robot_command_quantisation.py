"""The robot rounds its commands to a step."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ....base.compiled_functions import njit
from ..config_changes import COMMAND, ConfigChanges, merged, through, with_unit
from ..effect import Effect, Parameter, Seen, Site, law
from ..servo import pulse_response

_LOW, _HIGH = 1e-6, 2e-4
# Commands are counted by bins of this width [m]; the spectrum is so much finer than their range asks for.
_BIN, _FINE = 8e-8, 16
_CANDIDATES = 12
# Where steps and phases are looked at first: about likely steps, and by so much of a turn about zero.
_NEAR, _LEVEL = np.linspace(-1.0, 1.0, 9), 0.04
# Ticks in which the robot has answered to a command.
_ANSWER = 64


@law
def _law(time, step, value, context, memory, theta):
    return theta[0] * (math.floor(value / theta[0] - theta[1] + 0.5) + theta[1])


@njit(error_model="numpy", nogil=True)
def _explained(steps, phases, commands, position_error, tick, omega, xi, delay):
    """By how much rounding, by each step and phase, lowers the sum of squares of `position_error` [m2]."""
    late = int(delay / tick)
    first = delay - late * tick
    root = omega * math.sqrt(max(1.0 - xi * xi, 1e-6))
    e = np.empty((2, 4))  # transition of position and velocity over both parts of a tick
    for part in range(2):
        over = first if part == 0 else tick - first
        envelope = math.exp(-xi * omega * over)
        cosine, sine = envelope * math.cos(root * over), envelope * math.sin(root * over) / root
        e[part, 0], e[part, 1] = cosine + xi * omega * sine, sine
        e[part, 2], e[part, 3] = -omega * omega * sine, cosine - xi * omega * sine
    found = np.zeros(steps.shape[0])
    for one in range(steps.shape[0]):
        q, phase = steps[one], phases[one]
        x, v, before, total = 0.0, 0.0, 0.0, 0.0
        for n in range(late, position_error.shape[0]):
            c = commands[n - late]
            c = q * (math.floor(c / q - phase + 0.5) + phase) - c
            a, b = x - before, v
            x, v = before + e[0, 0] * a + e[0, 1] * b, e[0, 2] * a + e[0, 3] * b
            a, b = x - c, v
            x, v = c + e[1, 0] * a + e[1, 1] * b, e[1, 2] * a + e[1, 3] * b
            before = c
            total += (2.0 * position_error[n] - x) * x
        found[one] = total
    return found


def _likely(seen: Seen) -> NDArray[np.float64]:
    """Steps whose rounding errors, sawteeth over the commands, most resemble the position error [m].

    The correlation with all of them at once: a Fourier transform over the commands, summed over harmonics.
    """
    reach = max(float(np.ptp(run)) for run in seen.commands)
    size = 1 << (int(_FINE * reach / _BIN) - 1).bit_length()
    density = np.zeros(size)
    response = pulse_response(seen.lag, seen.tick, _ANSWER)
    for commands, position_error in zip(seen.commands, seen.position_error, strict=True):
        # A command's part in all later position errors; the commands are those before each tick.
        part = np.correlate(np.append(position_error, np.zeros(_ANSWER)), response, "valid")[
            : len(position_error)
        ]
        bins = (
            np.round(commands / _BIN).astype(int) % size
        )  # turns the circle at zero, so that phases are zero
        density += np.bincount(bins, part, size)
    sine = np.fft.rfft(density).imag
    first = np.arange(int(size * _BIN / _HIGH), int(size * _BIN / _LOW))
    # c - q round(c/q) is the sum of -(-1)^k sin(2 pi k c/q) q/(pi k).
    score = sum((-1) ** k * -sine[np.minimum(k * first, size // 2)] / k for k in range(1, 7))
    best = np.argpartition(-score, 20 * _CANDIDATES)[: 20 * _CANDIDATES]
    found: list[int] = []
    for one in best[np.argsort(-score[best])].tolist():
        if all(abs(one - other) > 2 * _FINE for other in found):
            found.append(one)
        if len(found) == _CANDIDATES:
            break
    return size * _BIN / first[found]


def propose(seen: Seen) -> Sequence[tuple[float, ...]]:
    """Steps and phases that explain most of the robot's position error; neighbours differ."""

    def explained(steps: NDArray[np.float64], phases: NDArray[np.float64]) -> NDArray[np.float64]:
        pairs = zip(seen.commands, seen.position_error, strict=True)
        return sum(_explained(steps, phases, *pair, seen.tick, *seen.lag) for pair in pairs)

    farthest = max(float(np.abs(run).max()) for run in seen.commands)
    found = []
    # A wide step hardly explains anything a hundredth of it from its phase.
    phases, aside = (one.ravel() for one in np.meshgrid(_LEVEL * _NEAR, 0.1 / farthest * _NEAR))
    for turns in 1.0 / _likely(seen):
        near = 1.0 / (turns + aside)
        gain = explained(near, phases)
        found.append((float(gain.max()), float(near[int(np.argmax(gain))])))
    starts = []
    across = np.linspace(-1.0, 1.0, 41)
    for _, step in sorted(found, reverse=True)[:2]:
        phase = 0.0
        for wide, narrow in ((0.5, 0.05), (0.05, 0.02), (0.01, 0.005), (0.002, 0.001), (0.001, 0.0005)):
            phases = np.clip(phase + wide * across, -0.5, 0.5)
            phase = float(phases[int(np.argmax(explained(np.full(41, step), phases)))])
            near = 1.0 / (1.0 / step + narrow / farthest * across)
            step = float(near[int(np.argmax(explained(near, np.full(41, phase))))])
        starts.append((step, phase))
    return starts


def _written(theta: Mapping[str, float], rig: Mapping[str, float]) -> ConfigChanges:
    off = theta["step"] * theta["phase"]
    rounded = through(COMMAND, quantise=with_unit(theta["step"], "m"))
    if not off:
        return rounded
    before, after = (through(COMMAND, offset=with_unit(one, "m")) for one in (-off, off))
    return merged([before, rounded, after])


EFFECTS = (
    Effect(
        id="robot.command-quantisation",
        words="The robot rounds its commands to a step",
        equation="c = q (round(command/q - p) + p)",
        source="Widrow, Kollar: Quantization Noise, 2008",
        parameters=(
            Parameter("step", "m", 1.0, low=_LOW, high=_HIGH, starts=(2e-5,), shape=True, jagged=True),
            Parameter("phase", "1", 0.1, low=-0.5, high=0.5, starts=(0.0,), jagged=True),
        ),
        site=Site.COMMAND,
        apply=_law,
        written=_written,
        propose=propose,
    ),
)
