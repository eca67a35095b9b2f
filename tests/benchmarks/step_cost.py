"""CPU time of a communication step, for this package, a plain C master and other tools that are installed.

    python -m tests.benchmarks.step_cost [--rounds N]

All take turns in every round, so that a change of the machine's speed meets all alike; the median of the
rounds is printed. Times are CPU times of all threads, without loading and initialising.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from statistics import median

from .contenders import CONTENDERS
from .systems import CASES, Plant, build

# Other ways of recording what another row shows.
_ONLY_RECORDED = ("orchestrator, native loop, to disk", "orchestrator, native loop, and to CSV")

Times = dict[tuple[str, bool], list[float]]


def measure(plant: Plant, rounds: int) -> tuple[Times, Times, dict[str, str], list[str]]:
    """CPU times off and recorded, times on the clock [us per step]; who cannot run; disagreements."""
    times: Times = defaultdict(list)
    absent: dict[str, str] = {}
    walls: Times = defaultdict(list)
    differing: dict[str, None] = {}
    for _ in range(rounds):
        for name, (run, steps) in CONTENDERS.items():
            for record in (False, True):
                if name in absent or (name in _ONLY_RECORDED and not record):
                    continue
                try:
                    seconds, outputs, wall = run(plant, record, steps)
                except (ImportError, OSError) as error:
                    absent[name] = str(error)
                    continue
                times[name, record].append(seconds / steps * 1e6)
                if wall is not None:
                    walls[name, record].append(wall / steps * 1e6)
                expected = CONTENDERS["plain C master"][0](plant, False, steps).outputs
                if outputs is not None and not all(map(_close, outputs, expected)):
                    differing[f"{name} ends at {outputs[:3]} ..., the C master at {expected[:3]} ..."] = None
    return times, walls, absent, list(differing)


def _close(one: float, other: float) -> bool:
    return math.isclose(one, other, rel_tol=1e-9)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=7, help="of which the median is taken")
    rounds = parser.parse_args(arguments).rounds
    for case in CASES:
        with tempfile.TemporaryDirectory() as folder:
            times, walls, absent, differing = measure(build(case, Path(folder)), rounds)
        print(f"{case.name}: CPU time per step [us], median of {rounds}; ratio to the plain C master")
        print(f"  {'':38}{'recording off':>22}{'all recorded':>22}{'on the clock':>15}")
        for name in CONTENDERS:
            if name in absent:
                print(f"  {name:38}  not run: {absent[name]}")
                continue
            clock = f"{median(walls[name, True]):15.3f}" if (name, True) in walls else ""
            print(f"  {name:38}{_cell(times, name, False)}{_cell(times, name, True)}{clock}")
        print(f"  {_summary(times)}")
        for line in differing:
            print(f"  different results: {line}")
        print()


def _summary(times: Times) -> str:
    """Our ratios to the C master, and the other tools' to us."""
    native = "orchestrator, native loop"
    shown = {
        "recording off": (native, False),
        "in memory": (native, True),
        "to disk": (f"{native}, to disk", True),
    }
    reported = [
        f"{what} {_ratio(times, key, ('plain C master', key[1])):.2f}"
        for what, key in shown.items()
        if times[key]
    ]
    others = [
        _ratio(times, key, (native, True))
        for key in list(times)
        if key[1] and not key[0].startswith(("orchestrator", "plain C")) and times[key]
    ]
    least = f"; other tools that record, to it: {min(others):.0f} or more" if others else ""
    return f"native loop to the C master: {', '.join(reported)}{least}"


def _ratio(times: Times, one: tuple[str, bool], other: tuple[str, bool]) -> float:
    return median(a / b for a, b in zip(times[one], times[other], strict=True))


def _cell(times: dict[tuple[str, bool], list[float]], name: str, record: bool) -> str:
    found = times.get((name, record))
    if not found:
        return f"{'':22}"
    ratio = _ratio(times, (name, record), ("plain C master", record))
    return f"{median(found):12.3f} {ratio:7.2f} x"


if __name__ == "__main__":
    main()
