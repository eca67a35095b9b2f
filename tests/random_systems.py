"""Random linear systems with delays, their rightmost roots, and their growth in simulations."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from orchestrator.frequency.delay_equation import Link
from orchestrator.frequency.delay_system import DelaySystem

STEP, STEPS, BLOCKS = 0.01, 8000, 8


class Compared(NamedTuple):
    """How signs of stability agree.

    Attributes:
        judged: systems further from the border than 1 % of the size of their root; wrong: of those.
        unstable: by their roots.
        median_error: of growth rates [1/s].
    """

    judged: int
    wrong: int
    unstable: int
    median_error: float


def drawn(count: int, states: tuple[int, int], delays: tuple[int, int], seed: int) -> list[DelaySystem]:
    """Systems of so many states and so many delays, of 5 to 150 steps."""
    draw = np.random.default_rng(seed)
    systems = []
    for _ in range(count):
        n, m = (int(draw.integers(low, high + 1)) for low, high in (states, delays))
        a = draw.normal(size=(n, n)) / np.sqrt(n) - draw.uniform(0.6, 2.0) * np.eye(n)
        b, c = draw.normal(size=(n, m)) / np.sqrt(n), draw.normal(size=(m, n))
        links = tuple(
            Link(str(k), k, k, float(draw.choice([-1.0, 1.0])), STEP * int(draw.integers(5, 150)))
            for k in range(m)
        )
        names = [tuple(f"p.{kind}{k}" for k in range(size)) for kind, size in (("x", n), ("u", m), ("y", m))]
        systems.append(DelaySystem(a, b, c, np.zeros((m, m)), *names, links))
    return systems


def compared(systems: Sequence[DelaySystem]) -> Compared:
    """Rightmost roots against simulations."""
    roots = np.array([one.modes(2).modes[0].root for one in systems])
    growth = simulated(systems, STEP, STEPS, BLOCKS)
    judged = abs(roots.real) > 0.01 * np.maximum(abs(roots), 1.0)
    wrong = np.sign(growth[judged]) != np.sign(roots.real[judged])
    unstable = int(np.sum(roots.real > 0.0))
    return Compared(int(judged.sum()), int(wrong.sum()), unstable, float(np.median(abs(growth - roots.real))))


def simulated(systems, step, steps, blocks):
    """Growth rates of random systems, all simulated at once by the trapezoidal rule, shape (systems,).

    From the largest norm in the last of so many blocks and that in the middle one.
    """
    count, n = len(systems), max(len(one.a) for one in systems)
    m = max(len(one.links) for one in systems)
    a, b, c = np.zeros((count, n, n)), np.zeros((count, n, m)), np.zeros((count, m, n))
    late, gain = np.ones((count, m), int), np.zeros((count, m))
    for place, one in enumerate(systems):
        k = len(one.a)
        a[place, :k, :k] = one.a
        for link_place, link in enumerate(one.links):
            b[place, :k, link_place] = one.b[:, link.target]
            c[place, link_place, :k] = one.c[link.source]
            late[place, link_place], gain[place, link_place] = round(link.delay / step), link.gain
    eye = np.eye(n)
    inverse = np.linalg.inv(eye - 0.5 * step * a)
    right, drive = inverse @ (eye + 0.5 * step * a), 0.5 * step * inverse @ b
    outputs = np.zeros((steps + 1, count, m))
    x = np.random.default_rng(7).normal(size=(count, n, 1))
    x *= np.array([[[float(k < len(one.a))] for k in range(n)] for one in systems])
    outputs[0] = (c @ x)[..., 0]
    rows, columns = np.arange(count)[:, None], np.arange(m)[None]

    def fed(index):
        value = outputs[np.maximum(index - late, 0), rows, columns]
        return np.where(index >= late, gain * value, 0.0)[..., None]

    norms = np.zeros((steps + 1, count))
    held = fed(0)
    for index in range(steps):
        new = fed(index + 1)
        x = right @ x + drive @ (held + new)
        held = new
        outputs[index + 1] = (c @ x)[..., 0]
        norms[index + 1] = np.linalg.norm(x[..., 0], axis=1)
    peaks = np.array([np.max(one, axis=0) for one in np.array_split(norms[1:], blocks)])
    half = blocks // 2
    return np.log(peaks[-1] / peaks[half]) / (step * steps / blocks * (blocks - 1 - half))
