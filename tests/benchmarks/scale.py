"""Time to check, load and step large systems: rings of FMUs with 10 ports each.

    python -m tests.benchmarks.scale [--rounds N]
    python -m tests.benchmarks.scale --whole [--steps N]

With `--whole` a run is timed as users make it: check, run, repeat with half the step size, files and figures.

The median of the rounds is printed; each round takes all sizes in turn.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any

from orchestrator.simulation.run import prepare, run

from .systems import STEP_SIZE, Case, build, ring

PORTS = 10
SIZES = (10, 100, 1000)
STEPS = 100
WHOLE = (200, 1000, 2000)


def large_config(instances: int, fmu: Path, steps: int, **options: Any) -> dict[str, Any]:
    """A config of a ring of FMUs of `build`, each fed by the one before it on all its ports.

    Args:
        options: further keys of `run`.
    """
    links = Case("", instances, PORTS, True, ring(instances, PORTS)).links
    times = {"step_size": f"{STEP_SIZE} s", "stop_time": f"{steps * STEP_SIZE} s"}
    return {
        "run": {"master": "jacobi", **times, **options},
        "instances": {f"s{index}": {"fmu": str(fmu)} for index in range(instances)},
        "connections": [f"s{a}.y{b} -> s{c}.u{d}" for a, b, c, d in links],
    }


def whole(fmu: Path, folder: Path, steps: int) -> None:
    """Time runs with all that belongs to them, and print."""
    print(f"instances  signals  check [s]  run with half the step size, files, figures of {steps} steps [s]")
    for size in WHOLE:
        begin = perf_counter()
        prepared = prepare(large_config(size, fmu, steps))
        checked = perf_counter()
        run(prepared, out=folder / "out")
        print(f"{size:9}  {size * PORTS:7}  {checked - begin:9.2f}  {perf_counter() - checked:.1f}")
        shutil.rmtree(folder / "out")


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=3, help="of which the median is taken")
    parser.add_argument("--whole", action="store_true", help="time whole runs instead")
    parser.add_argument("--steps", type=int, default=1000, help="of a whole run")
    options = parser.parse_args(arguments)
    rounds = options.rounds
    times: dict[int, list[tuple[float, float, float]]] = defaultdict(list)
    with tempfile.TemporaryDirectory() as folder:
        fmu = build(Case("", 2, PORTS, True, ring(2, PORTS)), Path(folder)).fmu
        run(large_config(2, fmu, 1), halving=False)  # imports
        if options.whole:
            whole(fmu, Path(folder), options.steps)
            return
        for _ in range(rounds):
            for size in SIZES:
                begin = perf_counter()
                prepared = prepare(large_config(size, fmu, STEPS, loop="python"))
                checked = perf_counter()
                one = prepare(large_config(size, fmu, 1, loop="python"))
                between = perf_counter()
                run(one, halving=False)
                loaded = perf_counter()
                run(prepared, halving=False)
                ended = perf_counter()
                step = (ended - loaded - (loaded - between)) / (STEPS - 1)
                times[size].append((checked - begin, loaded - between, step))
    print("instances  connections  check [s]  load and one step [s]  a step more [ms]")
    for size, found in times.items():
        check, load, step = (median(column) for column in zip(*found, strict=True))
        print(f"{size:9}  {size * PORTS:11}  {check:9.3f}  {load:21.3f}  {step * 1e3:16.3f}")


if __name__ == "__main__":
    main()
