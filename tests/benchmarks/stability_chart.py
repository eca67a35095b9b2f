"""Time per point of a stability chart beside python-control's margins of each point, one by one.

python -m tests.benchmarks.stability_chart
"""

from __future__ import annotations

from time import perf_counter

import control
import numpy as np

from orchestrator.frequency import Loop, chart

POINTS, SINGLE = 200, 40


def main() -> None:
    """Print both times and their ratio."""
    loop = Loop.of("docking-1d-uncompensated")
    delays, damping = np.linspace(1e-4, 1e-2, POINTS), np.linspace(0.0, 3000.0, POINTS)
    begin = perf_counter()
    drawn = chart(loop, ("robot.tau_m", delays), ("contact.damping", damping))
    each = (perf_counter() - begin) / drawn.unstable.size
    random = np.random.default_rng(1)
    models = [
        loop.with_parameters({"robot.tau_m": tau, "contact.damping": c}).gain().pade(1e-3, 600.0)[0]
        for tau, c in zip(random.choice(delays, SINGLE), random.choice(damping, SINGLE), strict=True)
    ]
    begin = perf_counter()
    for model in models:
        control.margin(model)
    single = (perf_counter() - begin) / SINGLE
    print(f"chart of {POINTS} x {POINTS}: {each * drawn.unstable.size:.2f} s, {each * 1e6:.2f} us a point")
    print(f"control.margin: {single * 1e6:.0f} us a point, {single / each:.0f} times as much")


if __name__ == "__main__":
    main()
