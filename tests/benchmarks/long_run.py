"""Memory and time of a long run whose results are streamed to disk, and of what is done with them afterwards.

python -m tests.benchmarks.long_run [--steps N]
"""

from __future__ import annotations

import argparse
import resource
import tempfile
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from time import perf_counter, process_time

from orchestrator.master import create_master
from orchestrator.results.measures import signal_changes
from orchestrator.results.recorders import Recorder, read_results
from orchestrator.simulation.grid import Grid
from orchestrator.simulation.loop import simulate

from .systems import CASES, STEP_SIZE, Plant, build


def _ran(plant: Plant, steps: int, factor: int, path: Path) -> None:
    grid = Grid(Fraction(0), Fraction(STEP_SIZE).limit_denominator(10**6) / factor, steps * factor)
    recorder = Recorder(plant.system, path=path)
    simulate(plant.system, create_master("jacobi"), grid, [recorder], loop="native")
    recorder.close()


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=10_000_000)
    parser.add_argument("--csv", action="store_true", help="write CSV, too")
    options = parser.parse_args(arguments)
    case = CASES[0]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        plant = build(case, folder)
        path, halved = folder / "results.arrow", folder / "halved.arrow"
        print(f"{case.name}, {options.steps} steps, everything recorded")
        print(f"{'':44}{'clock [s]':>12}{'CPU [s]':>12}{'peak memory [MB]':>18}")

        def reported(what: str, work) -> None:
            clock, cpu = perf_counter(), process_time()
            work()
            clock, cpu = perf_counter() - clock, process_time() - cpu
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            print(f"{what:44}{clock:12.2f}{cpu:12.2f}{peak:18.0f}", flush=True)

        reported("imports and 1000 steps", lambda: _ran(plant, 1000, 1, path))
        reported("the run, streamed to disk", lambda: _ran(plant, options.steps, 1, path))
        reported("the same with half the step size", lambda: _ran(plant, options.steps, 2, halved))
        reported(
            "comparing all signals of the two", lambda: signal_changes(*map(read_results, (path, halved)))
        )
        reported("reading one signal", lambda: read_results(path)["s1.y0"].max())
        if options.csv:
            reported("writing CSV", lambda: read_results(path).to_csv(folder / "results.csv"))
        print(f"the file: {path.stat().st_size / 2**20:.0f} MB")


if __name__ == "__main__":
    main()
