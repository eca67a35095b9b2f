"""Time from nothing to the end of a run of 10 steps, in fresh processes.

    python -m tests.benchmarks.start_up [--rounds N]

All rows take turns in every round; the median of the rounds is printed. Bytecode is kept, as it is wherever
PYTHONDONTWRITEBYTECODE is not set; without it this package costs 0.06 s more.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median
from time import perf_counter

ROOT = Path(__file__).parents[2]
RUN = """
from orchestrator.simulation.run import run
made = run({
    "run": {"master": "gauss-seidel", "step_size": "1 ms", "stop_time": "10 ms"},
    "instances": {"robot": {"fmu": "RobotResponse", "start": {"command": "0 m"}}},
}, halving=False)
assert len(made.results.time) == 11
"""
ROWS = {
    "the interpreter": "",
    "import numpy, pydantic, fmpy": "import numpy, pydantic, fmpy; pydantic.BaseModel",
    "import orchestrator": "import orchestrator",
    "a run of 10 steps": RUN,
}


def _seconds(code: str, environment: Mapping[str, str]) -> tuple[float, float]:
    """Wall and CPU time of a process [s]."""
    before, begin = os.times(), perf_counter()
    subprocess.run([sys.executable, "-c", code], check=True, env=dict(environment), cwd=ROOT)
    wall, after = perf_counter() - begin, os.times()
    spent = after.children_user + after.children_system - before.children_user - before.children_system
    return wall, spent


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=11, help="of which the median is taken")
    rounds = parser.parse_args(arguments).rounds
    with tempfile.TemporaryDirectory() as folder:
        kept = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONPYCACHEPREFIX": folder}
        kept.pop("PYTHONDONTWRITEBYTECODE", None)
        _seconds(RUN, kept)
        times: dict[str, list[tuple[float, float]]] = defaultdict(list)
        for _ in range(rounds):
            for name, code in ROWS.items():
                times[name].append(_seconds(code, kept))
    print(f"{'median of ' + str(rounds) + ' rounds':34} wall [s]  CPU [s]")
    for name, found in times.items():
        print(f"{name:34} {median(one for one, _ in found):8.3f} {median(one for _, one in found):8.3f}")


if __name__ == "__main__":
    main()
