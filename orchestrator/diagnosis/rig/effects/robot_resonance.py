"""A lightly damped mode of the structure, seen by the encoder."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ....base.compiled_functions import njit
from ..config_changes import start
from ..effect import Context, Effect, Parameter, Seen, Site, law

_ACCELERATION = int(Context.ACCELERATION)
# Ratio of neighbouring candidates for the frequency: a mode's own width.
_APART = 1.02
_PROPOSED = 6


@law
def _law(time, step, value, context, memory, theta):
    if step > 0.0:
        w = theta[1]
        memory[1] += step * (-theta[0] * context[_ACCELERATION] - w * w * memory[0] - 0.06 * w * memory[1])
        memory[0] += step * memory[1]
    return value + memory[0]


@njit(error_model="numpy", nogil=True)
def _modes(frequencies, commands, position_error, tick, omega, xi, delay):
    """Products of the position error with modes of unit gain, and of these with themselves [m2].

    Returns: shape (2, k).
    """
    found = np.zeros((2, frequencies.shape[0]))
    subs = 4
    dt = tick / subs
    n = position_error.shape[0]
    rates = np.zeros(n * subs)
    x, v = commands[0] - delay * (commands[1] - commands[0]) / tick, (commands[1] - commands[0]) / tick
    x -= 2.0 * xi / omega * v
    for i in range(n * subs):
        at = (i + 0.5) / subs - delay / tick
        held = commands[min(max(math.floor(at) + 1, 0), n - 1)]
        c = held if at >= 0.0 else commands[0] + v * tick * at
        before = v
        v += dt * (omega * omega * (c - x) - 2.0 * xi * omega * v)
        x += dt * v
        rates[i] = (v - before) / dt
    for one in range(frequencies.shape[0]):
        w = frequencies[one]
        q, p = 0.0, 0.0
        for i in range((n - 1) * subs):
            p += dt * (-rates[i] - w * w * q - 0.06 * w * p)
            q += dt * p
            if i % subs == subs - 1:
                found[0, one] += q * position_error[i // subs + 1]
                found[1, one] += q * q
    return found


def propose(seen: Seen) -> Sequence[tuple[float, ...]]:
    """Gains and frequencies of the modes that explain most of the robot's position error."""
    frequencies = 25.0 * _APART ** np.arange(int(math.log(20.0) / math.log(_APART)))
    products = sum(
        _modes(frequencies, commands, position_error, seen.tick, *seen.lag)
        for commands, position_error in zip(seen.commands, seen.position_error, strict=True)
    )
    explained = products[0] ** 2 / np.maximum(products[1], 1e-300)
    peaks = [
        place
        for place in np.argsort(-explained)
        if explained[place] >= explained[max(place - 1, 0) : place + 2].max()
    ]
    return [
        (float(np.clip(products[0, place] / products[1, place], -2.0, 2.0)), float(frequencies[place]))
        for place in peaks[:_PROPOSED]
    ]


EFFECTS = (
    Effect(
        id="robot.resonance",
        words="A lightly damped mode of the structure, seen by the encoder",
        equation="q'' + 2 z w q' + w^2 q = -g x'', x_out = x + q, z = 0.03",
        source="Spong: Modeling and control of elastic joint robots, 1987",
        parameters=(
            Parameter("gain", "1", 0.5, low=-5.0, high=5.0, starts=(0.2,)),
            Parameter(
                "frequency", "rad/s", 0.6, low=12.0, high=600.0, starts=(40.0, 85.0, 160.0, 300.0), shape=True
            ),
        ),
        site=Site.POSITION,
        apply=_law,
        memory=2,
        written=lambda t, rig: start(
            "robot", resonance_gain=(t["gain"], "1"), resonance_frequency=(t["frequency"], "rad/s")
        ),
        propose=propose,
    ),
)
