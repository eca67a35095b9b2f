"""CPU time of stiff Modelica models against SUNDIALS CVODE at the same accuracy.

    python -m tests.benchmarks.stiff_models [--rounds N]

Each model is built with an event and without, so that both routes choose a method. FMU and CVODE (in CasADi,
which evaluates the equations and their sparse Jacobian) solve the same equations in turns; the median of the
ratios of each round is printed. CVODE gets the largest tolerance with which it is as accurate as the FMU.
Errors are those against scipy's Radau, tolerance 1e-11.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave
from scipy.integrate import solve_ivp

from orchestrator.translate.build import build
from orchestrator.translate.package import this_platform

Slopes = Callable[[Any, Any], list[Any]]
EVENT = "Boolean late(start=false, fixed=true);\nequation\nwhen time > 1e9 then late = true; end when;\n"


def _robertson(_: Any, y: Any) -> list[Any]:
    a, b = 0.04 * y[0], 1e4 * y[1] * y[2]
    c = 3e7 * y[1] * y[1]
    return [b - a, a - b - c, c]


def _network(_: Any, y: Any) -> list[Any]:
    """200 bodies in a row, which also radiate."""
    n = 200
    left = [1.0, *[y[k] for k in range(n - 1)]]
    right = [*[y[k] for k in range(1, n)], y[n - 1]]
    return [400 * (left[k] - 2 * y[k] + right[k]) - y[k] * y[k] * y[k] * y[k] for k in range(n)]


def _ladder(_: Any, y: Any) -> list[Any]:
    """100 resistors and capacitors from a source; capacitors of 1 and 100 in turns."""
    n = 100
    left = [1.0, *[y[k] for k in range(n - 1)]]
    right = [*[y[k] for k in range(1, n)], y[n - 1]]
    return [(left[k] - 2 * y[k] + right[k]) * (1e3 if k % 2 else 10.0) for k in range(n)]


MODELS: dict[str, tuple[str, Slopes, list[float], float]] = {
    "Robertson, 3 states": (
        "Real y[3](start={1, 0, 0}, each fixed=true);\n"
        + EVENT
        + "der(y[1]) = 1e4*y[2]*y[3] - 0.04*y[1];\nder(y[2]) = 0.04*y[1] - 1e4*y[2]*y[3] - 3e7*y[2]*y[2];\n"
        "der(y[3]) = 3e7*y[2]*y[2];\n",
        _robertson, [1.0, 0.0, 0.0], 1e4,
    ),
    "thermal network, 200 states": (
        "Real y[200](each start=0, each fixed=true);\n"
        + EVENT
        + "der(y[1]) = 400*(1 - 2*y[1] + y[2]) - y[1]^4;\n"
        "for i in 2:199 loop\nder(y[i]) = 400*(y[i - 1] - 2*y[i] + y[i + 1]) - y[i]^4;\nend for;\n"
        "der(y[200]) = 400*(y[199] - y[200]) - y[200]^4;\n",
        _network, [0.0] * 200, 10.0,
    ),
    "RC ladder, 100 states": (
        "Real y[100](each start=0, each fixed=true);\n"
        "parameter Real g[100] = {if mod(i, 2) == 0 then 1e3 else 10 for i in 1:100};\n"
        + EVENT
        + "der(y[1]) = g[1]*(1 - 2*y[1] + y[2]);\n"
        "for i in 2:99 loop\nder(y[i]) = g[i]*(y[i - 1] - 2*y[i] + y[i + 1]);\nend for;\n"
        "der(y[100]) = g[100]*(y[99] - y[100]);\n",
        _ladder, [0.0] * 100, 10.0,
    ),
}  # fmt: skip


def fmu_run(folder: Path, text: str, n: int, stop: float) -> Callable[[], tuple[float, np.ndarray]]:
    """A model's FMU over one step to `stop` [s]; it returns the time that took [s], and y[1] to y[n]."""
    source = folder / "M.mo"
    source.write_text(f"model M\n{text}annotation(experiment(StopTime={stop}));\nend M;\n")
    build(source, folder / "M.fmu", platforms=(this_platform(),))
    unzipped = extract(str(folder / "M.fmu"))
    about = read_model_description(unzipped)
    numbers = {one.name: one.valueReference for one in about.modelVariables}

    def run() -> tuple[float, np.ndarray]:
        slave = FMU2Slave(
            guid=about.guid, unzipDirectory=unzipped, instanceName="m",
            modelIdentifier=about.coSimulation.modelIdentifier,
        )  # fmt: skip
        slave.instantiate()
        slave.setupExperiment(startTime=0.0)
        slave.enterInitializationMode()
        slave.exitInitializationMode()
        begin = time.process_time()
        slave.doStep(0.0, stop)
        taken = time.process_time() - begin
        found = slave.getReal([numbers[f"y[{k + 1}]"] for k in range(n)])
        slave.terminate()
        slave.freeInstance()
        return taken, np.array(found)

    return run


def _cvode_run(
    slopes: Slopes, start: list[float], stop: float, tolerance: float
) -> Callable[[], tuple[float, np.ndarray]]:
    import casadi

    y = casadi.SX.sym("y", len(start))
    options = {"reltol": tolerance, "abstol": 1e-3 * tolerance, "max_num_steps": 1_000_000}
    solver = casadi.integrator(
        "s", "cvodes", {"x": y, "ode": casadi.vertcat(*slopes(0, y))}, 0, stop, options
    )

    def run() -> tuple[float, np.ndarray]:
        begin = time.process_time()
        found = solver(x0=start)["xf"]
        return time.process_time() - begin, np.array(found).ravel()

    return run


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=7)
    rounds = parser.parse_args(arguments).rounds
    print("| model | FMU | CVODE | ratio | error FMU | error CVODE |\n|---|---|---|---|---|---|")
    with_and_without = [
        (f"{name}, {kind} event", text.replace(EVENT, put), *rest)
        for name, (text, *rest) in MODELS.items()
        for kind, put in (("with an", EVENT), ("without", "equation\n"))
    ]
    for name, text, slopes, start, stop in with_and_without:
        exact = solve_ivp(slopes, (0, stop), start, method="Radau", rtol=1e-11, atol=1e-14).y[:, -1]

        def error(found: np.ndarray, exact: np.ndarray = exact) -> float:
            return float((np.abs(found - exact) / (np.abs(exact) + 1e-3)).max())

        with tempfile.TemporaryDirectory() as folder:
            ours = fmu_run(Path(folder), text, len(start), stop)
            reached = error(ours()[1])
            for exponent in np.arange(-4, -12.1, -0.5):
                other = _cvode_run(slopes, start, stop, float(10**exponent))
                if error(other()[1]) <= reached:
                    break
            pairs = [(ours()[0], other()[0]) for _ in range(rounds)]
        times = [1e3 * median(one) for one in zip(*pairs, strict=True)]
        ratio = median(a / b for a, b in pairs)
        print(
            f"| {name} | {times[0]:.1f} ms | {times[1]:.1f} ms | {ratio:.1f} | {reached:.1e} "
            f"| {error(other()[1]):.1e} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
