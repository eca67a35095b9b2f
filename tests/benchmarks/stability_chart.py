"""How long a chart of 200 x 200 points takes: ten states with three delays, over a gain and a delay.

`python -m tests.benchmarks.stability_chart`, with one thread for matrices. Roots at the border are printed.
"""

from __future__ import annotations

from time import perf_counter

import numpy as np

from orchestrator.cli.arguments import one_matrix_thread
from orchestrator.frequency import DelaySystem, Link, chart_of

STATES, DELAYS = 10, (0.1, 0.137)


def ring(delay: float, gain: float) -> DelaySystem:
    """Three parts in a ring of negative gain, ten states; the third delay varies."""
    draw = np.random.default_rng(7)
    a = draw.normal(size=(STATES, STATES)) * 0.4 - 1.5 * np.eye(STATES)
    b, c = draw.normal(size=(STATES, 3)), draw.normal(size=(3, STATES))
    names = [tuple(f"p.{kind}{k}" for k in range(size)) for kind, size in (("x", STATES), ("u", 3), ("y", 3))]
    links = (
        Link("one", 0, 1, 0.3, DELAYS[0]),
        Link("two", 1, 2, 0.4, DELAYS[1]),
        Link("three", 2, 0, -gain, delay),
    )
    return DelaySystem(a, b, c, np.zeros((3, 3)), *names, links)


def main() -> None:
    """Print the time of the chart, and how far its border is from delay margins."""
    one_matrix_thread()
    begin = perf_counter()
    found = chart_of(ring, (0.02, 3.0), (0.2, 4.0))
    print(f"{found.unstable.shape[1]} x {found.unstable.shape[0]} points: {perf_counter() - begin:.2f} s")
    apart = []
    for line in found.border:
        for delay, gain, _ in line[:: max(1, len(line) // 20)]:
            system = ring(delay, gain)
            apart.append(abs(max(one.root.real for one in system.modes(2).modes)))
    count = sum(len(one) for one in found.border)
    print(f"{count} points of the border; real part of the root there up to {max(apart):.1e}")


if __name__ == "__main__":
    main()
