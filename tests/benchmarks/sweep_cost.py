"""What a sweep costs beyond its runs, and an outlook on a million of them.

    python -m tests.benchmarks.sweep_cost [--runs N] [--quick-runs N] [--stop TIME] [--out FILE]

Measured with `docking-1d` in its native forms, delays and stiffness drawn by Latin hypercube:

efficiency  wall time of the command `orchestrator sweep` with one process over twice that with two, from its
            start to its end: imports, checking the study, starting processes, loading machine code, writing
            the store and making its parts are included. The one process shares its cores with nobody but the
            process that keeps the store, which has the other one: the harder comparison.
cluster     whether a Dask cluster of three workers on this machine gives the same table to the bit.
cost        wall time of a process per run, over the loop time (`run.stepping_time`) of the same run alone;
            without step halving, so that both are one run. Start-up is left out: it is paid once per process.
memory      of this process and of a worker, after a tenth, a half and nearly all of many quick runs.
storage     what a run takes in the store: numbers alone, and with all signals.
outlook     time and storage of a million runs, from these figures.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from statistics import median
from time import perf_counter, process_time
from typing import Any

from orchestrator.campaign import Store, Study
from orchestrator.campaign.sweep import Swept
from orchestrator.simulation.run import prepare, run

ROOT = Path(__file__).parents[2]
NATIVE = {"controller.form": "native", "satellite.form": "native"}
OVER = {
    "robot.tau_m": {"uniform": ["0.5 ms", "6 ms"]},
    "contact.stiffness": {"log-uniform": ["50 N/mm", "500 N/mm"]},
}
DERIVED = {"peak": "max(abs(contact.force))", "last": "final(satellite.velocity)"}
DAY = 86_400.0


def values(runs: int, **changes: Any) -> dict[str, Any]:
    """Runs of `docking-1d`, drawn: what a study file holds."""
    design = {"latin-hypercube": {"count": runs, "seed": 1, "over": OVER}}
    given = {"format": "sweep/1", "system": "docking-1d", "set": NATIVE, "design": design, "derived": DERIVED}
    return given | changes


def quick(runs: int) -> Study:
    """Runs of 20 steps: what they cost is what a sweep costs."""
    times = {
        "run.stop_time": "40 ms",
        "run.step_size": "2 ms",
        "run.loop": "python",
        "satellite.form": "native",
    }
    design = {"random": {"count": runs, "seed": 1, "over": OVER}}
    given = {"system": "docking-1d-uncompensated", "set": times, "design": design, "derived": DERIVED}
    return Study(given | {"step_halving": False})


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


def commanded(file: Path, store: Path, jobs: int) -> tuple[float, float]:
    """Wall time of the command, and processor time of all its processes [s]."""
    command = [sys.executable, "-m", "orchestrator", "sweep", str(file), "--store", str(store), "--quiet"]
    begin, used = perf_counter(), os.times()
    subprocess.run([*command, "--jobs", str(jobs)], cwd=ROOT, check=True)
    now = os.times()
    took = now.children_user - used.children_user + now.children_system - used.children_system
    return perf_counter() - begin, took


def each_run(folder: Path) -> float:
    """Median wall time of a worker per run [s]."""
    with Store(folder) as store:
        return store.query("select median(seconds) as s from runs").column("s")[0].as_py()


def efficiency(folder: Path, runs: int, changes: dict[str, Any]) -> tuple[float, list[str]]:
    """See the module's text; the number of cores is 2."""
    file = folder / "study.yaml"
    file.write_text(json.dumps(values(runs, **changes)), encoding="utf-8")
    one, one_used = commanded(file, folder / "one", 1)
    two, two_used = commanded(file, folder / "two", 2)
    with Store(folder / "one") as first, Store(folder / "two") as second:
        same = first.table().equals(second.table())
    share = one / (2 * two)
    alone, beside = each_run(folder / "one"), each_run(folder / "two")
    return share, [
        f"{runs} runs, each repeated with half the step: one process {one:.1f} s, two {two:.1f} s, "
        f"efficiency **{share:.3f}**; {_same(same)}",
        f"time of a pair of runs: {1e3 * alone:.1f} ms in a single process and {1e3 * beside:.1f} ms beside "
        f"another one ({alone / beside:.3f}); this loss is due to hardware that the cores share",
        f"share of the two processes' time outside runs: {1 - runs * beside / (2 * two):.1%}",
        f"processor time of all processes of the command: {one_used:.1f} s with one, {two_used:.1f} s with "
        f"two, {two_used / (2 * two):.1%} of the two cores",
    ]


def _same(same: bool) -> str:
    return "the tables are the same to the bit" if same else "THE TABLES DIFFER"


def cost(folder: Path, runs: int, changes: dict[str, Any]) -> list[str]:
    """Seconds of a process per run, and that over the loop time of the run alone."""
    made = Study(values(runs, step_halving=False, **changes))
    texts = [f"{path}={value}" for path, value in {**NATIVE, **changes.get("set", {})}.items()]
    prepared = prepare("docking-1d", [*texts, "run.loop=native"])
    run(prepared, halving=False)
    loops = [run(prepared, halving=False).summary["run"]["stepping_time"] for _ in range(5)]
    timed(made, folder / "cost", jobs=1)
    seconds = each_run(folder / "cost")
    with Store(folder / "cost") as store:
        loop = store.query("select median(stepping_time) as s from runs").column("s")[0].as_py()
    return [
        f"time of a single run in a sweep: {1e3 * seconds:.1f} ms, with {1e3 * loop:.1f} ms in its loop; "
        f"loop of the same run alone: {1e3 * median(loops):.1f} ms; ratio **{seconds / median(loops):.2f}** "
        f"({seconds / loop:.2f} to the loops of the sweep itself)"
    ]


def memory(folder: Path, runs: int) -> tuple[float, list[str]]:
    """Overhead: seconds of this process per run; and what became of memory."""
    import psutil

    own = psutil.Process()
    noted: dict[int, tuple[float, float]] = {}

    def note(done: int, of: int, failed: int) -> None:
        if done in (of // 10, of // 2, of - of // 50):
            noted[done] = resident(own), max(resident(one) for one in own.children())

    _, wall, used = timed(quick(runs), folder / "memory", jobs=2, progress=note)
    resident_sizes = "; ".join(
        f"after {done} runs {here:.0f} MB and {worker:.0f} MB" for done, (here, worker) in noted.items()
    )
    return used / runs, [
        f"{runs} runs of 20 steps: memory of the process that writes the store, and of its largest worker: "
        f"{resident_sizes}",
        f"the process takes {1e3 * used / runs:.2f} ms of processor time per run ({1e3 * wall / runs:.2f} ms "
        "of wall time with two workers)",
    ]


def cluster(folder: Path, runs: int, changes: dict[str, Any]) -> list[str]:
    """The study of `efficiency` on Dask."""
    from distributed import LocalCluster

    with (
        LocalCluster(n_workers=3, threads_per_worker=1, dashboard_address=None) as three,
        Store(folder / "two") as store,
    ):
        made, wall, _ = timed(Study(values(runs, **changes)), folder / "there", scheduler=three)
        same = made.table.equals(store.table())
    where = "on a Dask cluster of three workers on the two cores"
    return [f"the same {runs} runs {where}: {wall:.1f} s; {_same(same)}"]


def storage(folder: Path, runs: int, changes: dict[str, Any]) -> tuple[float, list[str]]:
    """Bytes of a run in the store."""
    few = 20
    timed(Study(values(few, record="all", step_halving=False, **changes)), folder / "all", jobs=2)
    plain, whole = size(folder / "two") / runs, size(folder / "all") / few
    with Store(folder / "two") as store:
        numbers = store.query("select count(*) as n from numbers").column("n")[0].as_py() / runs
    return plain, [
        f"a run takes {plain / 1e3:.1f} kB in the store ({numbers:.0f} numbers); with `record: all` "
        f"{whole / 1e6:.2f} MB more"
    ]


def outlook(seconds: float, own: float, stored: float, share: float) -> list[str]:
    """A million runs on N workers."""
    lines = ["| workers | time | store |", "|---|---|---|"]
    for workers in (1, 2, 16, 128, 1024):
        took = max(1e6 * seconds / (workers * (share if workers > 1 else 1.0)), 1e6 * own)
        hours = f"{took / 3600:.1f} h" if took > 7200 else f"{took / 60:.0f} min"
        text = f"{took / DAY:.1f} days" if took > 2 * DAY else hours
        lines.append(f"| {workers} | {text} | {stored / 1e3:.2g} GB |")
    return [
        f"A million runs of this kind, {seconds:.3g} s each with half the step, at an efficiency of "
        f"{share:.2f}:",
        "",
        *lines,
        "",
        f"The process that writes the store takes {1e3 * own:.2f} ms per run, so it can serve "
        f"{seconds / own:.0f} workers. With more workers its own time is the limit: "
        f"{1e6 * own / 60:.0f} min.",
        "More than two cores were not available: the table is computed from the measurements above.",
    ]


def machine() -> str:
    """What this runs on, and when."""
    model = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        model = next(line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        pass
    when = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    return (
        f"{when}, {os.cpu_count()} virtual cores of {model}, {platform.system()}, Python "
        f"{platform.python_version()}, load before it began {os.getloadavg()[0]:.1f}"
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=2000)
    parser.add_argument("--quick-runs", type=int, default=10_000)
    parser.add_argument("--stop", default="13 s", help="simulated time of a run")
    parser.add_argument("--out", type=Path, help="write the page to this file, too")
    options = parser.parse_args(arguments)
    changes = {"set": NATIVE | {"run.stop_time": options.stop}}
    lines = [
        "# What many runs cost",
        "",
        "[Entry page](../README.md#contents) · before: [Many runs](campaigns.md) · "
        "next: [The native loop](speed.md)",
        "",
        f"Measured by `python -m tests.benchmarks.sweep_cost`: {machine()}.",
    ]
    lines += [f"Runs of `docking-1d`, native forms, {options.stop} of simulated time each.", ""]
    print(*lines, sep="\n", flush=True)

    def tell(more: Sequence[str], mark: str = "- ") -> None:
        lines.extend(f"{mark}{one}" for one in more)
        print(*(f"{mark}{one}" for one in more), sep="\n", flush=True)

    with tempfile.TemporaryDirectory(prefix="sweeps-") as name:
        folder = Path(name)
        share, reported = efficiency(folder, options.runs, changes)
        tell(reported)
        tell(cluster(folder, options.runs, changes))
        tell(cost(folder, min(options.runs, 200), changes))
        stored, reported = storage(folder, options.runs, changes)
        tell(reported)
        own, reported = memory(folder, options.quick_runs)
        tell(reported)
        tell(["", *outlook(each_run(folder / "one"), own, stored, min(share, 1.0))], "")
    if options.out:
        options.out.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
