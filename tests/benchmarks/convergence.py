"""Error against cost of every master: python -m tests.benchmarks.convergence [--out FOLDER] [--quick]

Two problems with a known solution: two masses between walls, tied to one another by a spring, in closed form;
and the docking loop, against the same loop as one model (UncompensatedDocking), whose delay-differential
equation is integrated with events and knows no communication step. Cost is counted in FMU steps and measured
in CPU time of the interpreter's loop, start-up left out. Observed orders are slopes of the error over the
step size, or over the tolerance.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from orchestrator.fmi import Array
from orchestrator.fmi.bundled import find_fmu
from orchestrator.master import create_master
from orchestrator.master.running_instances import instantiate
from orchestrator.simulation.grid import Grid
from orchestrator.simulation.run import prepare
from orchestrator.system.assembly import Part
from orchestrator.system.signal_vector import Layout
from orchestrator.system.system import System
from tests.assembled import assemble
from tests.doubles import FakeFmu, mass

Options = str | Mapping[str, Any]


@dataclass(frozen=True)
class Run:
    """One run: the step size or tolerance that was varied, the error, FMU steps and CPU time [s]."""

    control: float
    error: float
    steps: int
    cpu: float


@dataclass(frozen=True)
class Problem:
    """A system with a known solution.

    Attributes:
        system: makes it.
        error: of the recorded signals, given times, shape (n,) [s], and signals by name.
        stop: of the run [s].
        unit: of the error.
    """

    title: str
    system: Callable[[], System]
    error: Callable[[Array, Mapping[str, Array]], float]
    stop: Fraction
    unit: str


@dataclass(frozen=True)
class Series:
    """A master and what is varied: step sizes [s], or tolerances at a step size."""

    label: str
    master: Callable[[float], Options]
    controls: tuple[float, ...]
    step: Callable[[float], Fraction]


def measure(problem: Problem, series: Series) -> list[Run]:
    """Run a series."""
    return [
        _measure(problem, series.master(control), series.step(control), control)
        for control in series.controls
    ]


def _measure(problem: Problem, options: Options, step: Fraction, control: float) -> Run:
    system, master = problem.system(), create_master(options)
    grid = Grid(Fraction(0), step, int(problem.stop / step))
    counts = 0
    times: list[float] = []
    rows: list[Array] = []
    with instantiate(system) as instances:
        signals = instances.initialise(0.0, float(grid.stop))
        plain = instances._do_step

        def counted(*given: Any) -> Any:
            nonlocal counts
            counts += 1
            return plain(*given)

        instances._do_step = counted  # type: ignore[method-assign]
        begin = process_time()
        for point in grid:
            times.append(point.time)
            rows.append(signals.values)
            if not point.last:
                signals, info = master.step(system, instances, point, signals)
                info.raise_on_failure(point)
        cpu = process_time() - begin
    names = [str(port) for port in Layout.of(system).index]
    values = dict(zip(names, np.array(rows).T, strict=True))
    return Run(control, problem.error(np.array(times), values), counts, cpu)


# Two masses.


def two_masses() -> Problem:
    """Unit masses, tied to walls by unit springs and to one another by one of stiffness 4.

    From x = (1, 0): x1 = (cos t + cos 3t)/2.
    """
    inputs = ["one", "other"]
    link = FakeFmu(
        name="Link",
        inputs=dict.fromkeys(inputs, "m"),
        outputs={"on_one": "N", "on_other": "N"},
        feedthrough={"on_one": inputs, "on_other": inputs},
        output=lambda v: {
            "on_one": -v["one"] + 4.0 * (v["other"] - v["one"]),
            "on_other": -v["other"] + 4.0 * (v["one"] - v["other"]),
        },
    )

    def system() -> System:
        return assemble(
            [Part("a", mass(), {"position": "1 m"}), Part("b", mass()), Part("link", link)],
            [
                "a.position -> link.one",
                "b.position -> link.other",
                "link.on_one -> a.force",
                "link.on_other -> b.force",
            ],
        )

    def error(time: Array, signals: Mapping[str, Array]) -> float:
        return float(np.abs(signals["a.position"] - (np.cos(time) + np.cos(3 * time)) / 2).max())

    return Problem("two masses", system, error, Fraction(4), "m")


# The docking loop.


def docking(stop: Fraction = Fraction(6, 5)) -> Problem:
    """Two contacts of the uncompensated loop; the error is the force's largest, every 10 ms."""
    import fmpy

    every = Fraction(1, 100)
    reference = fmpy.simulate_fmu(
        str(find_fmu("UncompensatedDocking")),
        stop_time=float(stop),
        output_interval=float(every),
        output=["force"],
        relative_tolerance=1e-10,
    )["force"]

    def system() -> System:
        return prepare("docking-1d-uncompensated", ["satellite.form=native"]).system

    def error(time: Array, signals: Mapping[str, Array]) -> float:
        apart = (len(time) - 1) // (len(reference) - 1)
        return float(np.abs(signals["contact.force"][::apart] - reference).max())

    return Problem("docking loop", system, error, stop, "N")


def fixed(label: str, master: Options, coarsest: Fraction, count: int) -> Series:
    """A master of fixed steps, each half as long as the one before."""
    sizes = [coarsest / 2**n for n in range(count)]
    steps = {float(size): size for size in sizes}
    return Series(label, lambda _: master, tuple(steps), steps.__getitem__)


def adaptive(
    label: str, master: Callable[[float], Options], tolerances: Sequence[float], step: Fraction
) -> Series:
    """The adaptive master at several tolerances."""
    return Series(label, master, tuple(tolerances), lambda _: step)


def masters(coarsest: Fraction, count: int, tight: float) -> list[Series]:
    """All masters of fixed steps; `tight` is the tolerance of the iteration."""
    iterative = {"name": "iterative", "tolerance": tight}
    return [
        fixed("jacobi", "jacobi", coarsest, count),
        fixed("gauss-seidel", "gauss-seidel", coarsest, count),
        fixed("jacobi, extrapolation 1", {"name": "jacobi", "extrapolation": 1}, coarsest, count),
        fixed("gauss-seidel, extrapolation 1", {"name": "gauss-seidel", "extrapolation": 1}, coarsest, count),
        fixed("gauss-seidel, extrapolation 2", {"name": "gauss-seidel", "extrapolation": 2}, coarsest, count),
        fixed("iterative", iterative, coarsest, count),
        fixed("iterative, interpolation 1", {**iterative, "interpolation": 1}, coarsest, count),
    ]


def dividing(signal: str, step: Fraction, forces: Sequence[float], energies: Sequence[float]) -> list[Series]:
    """The adaptive master by inputs [N] and by power [J], on Gauss-Seidel with extrapolation 2."""
    base = {"name": "adaptive", "base": {"name": "gauss-seidel", "extrapolation": 2}}

    def by_inputs(tolerance: float) -> Options:
        return {**base, "estimate": "inputs", "tolerance": {signal: f"{tolerance!r} N"}}

    def by_power(tolerance: float) -> Options:
        return {**base, "estimate": "power", "rollback": True, "tolerance": f"{tolerance!r} J"}

    return [
        adaptive("adaptive, inputs", by_inputs, forces, step),
        adaptive("adaptive, power", by_power, energies, step),
    ]


def orders(runs: Iterable[Run]) -> list[float]:
    """Observed orders between runs that follow one another: log(error ratio)/log(step ratio)."""
    return [
        math.log(one.error / other.error) / math.log(one.control / other.control)
        for one, other in pairwise(runs)
    ]


def draw(problem: Problem, found: Mapping[str, list[Run]], path: Path) -> None:
    """Error against FMU steps and against CPU time, both logarithmic."""
    from matplotlib.figure import Figure

    from orchestrator.plotting.figures import COLORS, save

    figure = Figure(figsize=(11.0, 5.0), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    for number, (label, runs) in enumerate(found.items()):
        style = {
            "color": COLORS[number % len(COLORS)],
            "linestyle": "--" if number >= len(COLORS) else "-",
            "marker": "s" if label.startswith("adaptive") else "o",
            "linewidth": 2.4 if label.startswith("adaptive") else 1.4,
            "markersize": 4,
            "label": label,
        }
        axes[0].loglog([run.steps for run in runs], [run.error for run in runs], **style)
        axes[1].loglog([run.cpu for run in runs], [run.error for run in runs], **style)
    axes[0].set_xlabel("steps of FMUs")
    axes[1].set_xlabel("CPU time [s]")
    axes[0].set_ylabel(f"largest error [{problem.unit}]")
    for one in axes:
        one.grid(alpha=0.3, which="both")
    axes[1].legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize="small")
    figure.suptitle(f"Error against cost: {problem.title}")
    save(figure, path)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, print and draw."""
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=formatter)
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="write a figure of each problem there")
    parser.add_argument("--quick", action="store_true", help="three step sizes of each instead of five")
    args = parser.parse_args(arguments)
    count = 3 if args.quick else 5
    forces, energies = [1.0, 0.1, 0.01, 1e-3][:count], [1e-5, 1e-6, 1e-7, 1e-8][:count]
    smaller = [0.1 * one for one in forces]
    cases = [
        (
            two_masses(),
            [
                *masters(Fraction(1, 25), count, 1e-12),
                *dividing("link.on_one", Fraction(1, 5), smaller, [100.0 * one for one in energies]),
            ],
        ),
        (
            docking(),
            [
                *masters(Fraction(1, 1000), count, 1e-8),
                *dividing("contact.force", Fraction(1, 100), forces, energies),
            ],
        ),
    ]
    for problem, series in cases:
        print(f"\n{problem.title}, {float(problem.stop):g} s")
        unit = f"error [{problem.unit}]"
        print(f"{'master':32} {'control':>9} {unit:>11} {'FMU steps':>10} {'CPU [s]':>9}  order")
        found = {}
        for one in series:
            found[one.label] = runs = measure(problem, one)
            observed = ["", *(f"{order:5.2f}" for order in orders(runs))]
            for run, order in zip(runs, observed, strict=True):
                numbers = f"{run.control:9.2g} {run.error:11.3g} {run.steps:10d} {run.cpu:9.3f}"
                print(f"{one.label:32} {numbers}  {order}")
        if args.out is not None:
            args.out.mkdir(parents=True, exist_ok=True)
            draw(problem, found, args.out / f"convergence-{problem.title.replace(' ', '-')}.png")


if __name__ == "__main__":
    main()
