"""What a sweep costs beyond its runs, and an outlook on a million of them.

    python -m tests.benchmarks.sweep_cost [--runs N] [--quick-runs N] [--stop TIME] [--out FILE]

Measured with `docking-1d` in its native forms, delays and stiffness drawn by Latin hypercube:

efficiency  wall time with one process over twice that with two, from the call to the closed store: checking
            the study, starting processes, loading machine code and writing are included.
cost        wall time of a process per run, over the loop time (`run.stepping_time`) of the same run alone;
            without step halving, so that both are one run. Start-up is left out: it is paid once per process.
memory      of this process and of a worker, after a tenth and after all of many quick runs.
cluster     whether a Dask cluster of two workers on this machine gives the same table to the bit.
outlook     time and storage of a million runs, from these figures.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from time import perf_counter, process_time
from typing import Any

from orchestrator.campaign import Store, Study
from orchestrator.campaign.sweep import Swept
from orchestrator.run import prepare, run

NATIVE = {"controller.form": "native", "satellite.form": "native"}
OVER = {
    "robot.tau_m": {"uniform": ["0.5 ms", "6 ms"]},
    "contact.stiffness": {"log-uniform": ["50 N/mm", "500 N/mm"]},
}
DERIVED = {"peak": "max(abs(contact.force))", "last": "final(satellite.velocity)"}
DAY = 86_400.0


def study(runs: int, **changes: Any) -> Study:
    """Runs of `docking-1d`, drawn."""
    design = {"latin-hypercube": {"count": runs, "seed": 1, "over": OVER}}
    return Study({"system": "docking-1d", "set": NATIVE, "design": design, "derived": DERIVED} | changes)


def quick(runs: int) -> Study:
    """Runs of 20 steps: what they cost is what a sweep costs."""
    times = {
        "run.stop_time": "40 ms",
        "run.step_size": "2 ms",
        "run.loop": "python",
        "satellite.form": "native",
    }
    design = {"random": {"count": runs, "seed": 1, "over": OVER}}
    values = {"system": "docking-1d-uncompensated", "set": times, "design": design, "derived": DERIVED}
    return Study(values | {"step_halving": False})


def size(folder: Path) -> int:
    """Bytes of the parts of a store."""
    return sum(one.stat().st_size for one in (folder / "parts").rglob("*.parquet"))


def timed(made: Study, store: Path, **options: Any) -> tuple[Swept, float, float]:
    """A sweep, its wall time and this process's processor time [s]."""
    wall, own = perf_counter(), process_time()
    swept = made.run(store, **options)
    return swept, perf_counter() - wall, process_time() - own


def resident(process: Any) -> float:
    """Memory [MB]."""
    return process.memory_info().rss / 1e6


def efficiency(folder: Path, runs: int, changes: dict[str, Any]) -> float:
    """See the module's text; the number of cores is 2."""
    made = study(runs, **changes)
    _, one, _ = timed(made, folder / "one", jobs=1)
    _, two, _ = timed(made, folder / "two", jobs=2)
    with Store(folder / "one") as first, Store(folder / "two") as second:
        same = first.table().equals(second.table())
    print(f"efficiency: {runs} runs, one process {one:.1f} s, two {two:.1f} s: {one / (2 * two):.3f}")
    print(f"  the same table to the bit: {same}")
    return one / (2 * two)


def cost(folder: Path, runs: int, changes: dict[str, Any]) -> tuple[float, float]:
    """Seconds of a process per run, and that over the loop time of the run alone."""
    made = study(runs, step_halving=False, **changes)
    texts = [f"{path}={value}" for path, value in {**NATIVE, **changes.get("set", {})}.items()]
    prepared = prepare("docking-1d", [*texts, "run.loop=native"])
    run(prepared, halving=False)
    loops = [run(prepared, halving=False).summary["run"]["stepping_time"] for _ in range(5)]
    timed(made, folder / "cost", jobs=1)
    with Store(folder / "cost") as store:
        seconds = store.query("select median(seconds) as s from runs").column("s")[0].as_py()
        loop = store.query("select median(stepping_time) as s from runs").column("s")[0].as_py()
    print(
        f"cost: {1e3 * seconds:.1f} ms a run, of which its loop {1e3 * loop:.1f} ms; "
        f"alone {1e3 * median(loops):.1f} ms: "
        f"ratio {seconds / median(loops):.2f} ({seconds / loop:.2f} over the loops of the sweep itself)"
    )
    return seconds, seconds / median(loops)


def memory(folder: Path, runs: int) -> tuple[float, float, float]:
    """Overhead: seconds of this process per run, wall time per run of two processes, bytes per run."""
    import psutil

    own = psutil.Process()
    noted: dict[int, tuple[float, float]] = {}

    def note(done: int, of: int, failed: int) -> None:
        if done in (of // 10, of // 2, of - of // 50):
            noted[done] = resident(own), max(resident(one) for one in own.children())

    _, wall, used = timed(quick(runs), folder / "memory", jobs=2, progress=note)
    for done, (here, worker) in noted.items():
        print(f"memory: after {done} runs this process {here:.0f} MB, the largest worker {worker:.0f} MB")
    stored = size(folder / "memory") / runs
    print(
        f"overhead: {1e3 * used / runs:.2f} ms of this process and {1e3 * wall / runs:.2f} ms of wall time "
        f"a run, {stored:.0f} B on disk"
    )
    return used / runs, wall / runs, stored


def cluster(folder: Path, runs: int, changes: dict[str, Any]) -> None:
    """The same on Dask."""
    from distributed import LocalCluster

    made = study(runs, **changes)
    here = made.run(folder / "here", jobs=2).table
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as two:
        begin = perf_counter()
        there = made.run(folder / "there", scheduler=two).table
        print(
            f"cluster: {runs} runs in {perf_counter() - begin:.1f} s; "
            f"the same table to the bit: {there.equals(here)}"
        )


def outlook(seconds: float, own: float, stored: float, share: float) -> str:
    """A million runs on N workers."""
    most = seconds / own
    lines = [
        f"A million runs of {seconds:.3g} s each (step halving included), {stored / 1e3:.2g} kB each:",
        "",
        "| workers | time | store |",
        "|---|---|---|",
    ]
    for workers in (2, 16, 128, 1024):
        took = max(1e6 * seconds / (workers * share), 1e6 * own)
        text = f"{took / DAY:.1f} days" if took > DAY else f"{took / 3600:.1f} h"
        lines.append(f"| {workers} | {text} | {stored / 1e3:.2g} GB |")
    lines += [
        "",
        f"The process that keeps the store takes {1e3 * own:.2f} ms a run: it can feed {most:.0f} workers.",
    ]
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=2000)
    parser.add_argument("--quick-runs", type=int, default=10_000)
    parser.add_argument("--stop", default="13 s", help="simulated time of a run")
    parser.add_argument("--out", type=Path, help="write the outlook to this file")
    options = parser.parse_args(arguments)
    changes = {"set": NATIVE | {"run.stop_time": options.stop}}
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    with tempfile.TemporaryDirectory(prefix="sweeps-") as name:
        folder = Path(name)
        share = efficiency(folder, options.runs, changes)
        with Store(folder / "one") as store:
            pair = store.query("select median(seconds) as s from runs").column("s")[0].as_py()
        stored = size(folder / "one") / options.runs
        cost(folder, min(options.runs, 200), changes)
        own, _, _ = memory(folder, options.quick_runs)
        cluster(folder, min(options.runs, 200), changes)
        text = outlook(pair, own, stored, min(share, 1.0))
    print(text)
    if options.out:
        options.out.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
