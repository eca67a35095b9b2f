"""Run the Modelica Association's Reference FMUs and compare with the results that they carry.

    python -m tests.benchmarks.reference_fmus CHECKOUT

CHECKOUT is a clone of github.com/modelica/Reference-FMUs in which the FMUs were built: for each version
`cmake -S . -B build-fmi3 -DFMI_VERSION=3 && cmake --build build-fmi3`. Prints the table of docs/fmus.md.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path
from typing import Any

import numpy as np

from orchestrator.base.errors import OrchestratorError
from orchestrator.exchange.single_fmu import load_lone_fmu
from orchestrator.simulation.run import run


def reference(path: Path) -> dict[str, list[str]]:
    """Columns of a CSV file by name."""
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    return {name: [row[n] for row in rows[1:]] for n, name in enumerate(rows[0])}


def numbers(column: list[str]) -> np.ndarray | None:
    """The rows of a column as numbers, shape (rows, elements); None where it holds text."""
    words = {"true": "1", "false": "0"}
    try:
        return np.array([[float(words.get(one, one)) for one in text.split()] for text in column])
    except ValueError:
        return None


def largest_deviation(fmu: Path, model: Path, interface: str) -> tuple[float, str, int, str]:
    """The largest deviation over a signal's range, of which signal, of how many that vary, and a remark."""
    data: dict[str, Any] = load_lone_fmu(fmu).data
    wanted = reference(model / f"{model.name}_out.csv")
    times = np.array([float(one) for one in wanted["time"]])
    if model.name == "Roberts":
        raise OrchestratorError("its reference results belong to another model")
    (name,) = data["instances"]
    data["instances"][name] |= {"fmu": str(fmu), "interface": interface}
    step = float(np.median(np.diff(times)))
    stop = step * round(times[-1] / step)
    data["run"] |= {"step_size": f"{step:.12g} s", "stop_time": f"{stop:.12g} s"}
    made = run(data, halving=False)
    rows = [int(np.argmin(abs(made.results.time - time))) for time in times]
    rows = [row for row, time in zip(rows, times, strict=True) if abs(made.results.time[row] - time) < 1e-6]
    worst, where, varying = 0.0, "", 0
    for signal, column in wanted.items():
        values = numbers(column)
        if signal == "time" or values is None:
            continue
        for n, expected in enumerate(values[: len(rows)].T, 1):
            port = (
                f"{name}.{signal}" if f"{name}.{signal}" in made.results.signals else f"{name}.{signal}[{n}]"
            )
            if port not in made.results.signals:
                continue
            got = made.results[port][rows].astype(float)
            spread = float(np.ptp(expected)) or max(abs(float(expected[0])), 1.0)
            varying += bool(np.ptp(expected) > 0.0)
            apart = float(abs(got - expected).max()) / spread
            if apart >= worst:
                worst, where = apart, signal
    ended = made.summary["run"].get("ended")
    return worst, where, varying, f"ends the run at {ended['time']:g} s" if ended else ""


def main() -> None:
    """Print the table."""
    checkout = Path(sys.argv[1])
    print("| FMU | FMI | co-simulation | model exchange | |")
    print("|---|---|---|---|---|")
    for fmu in sorted(checkout.glob("*/fmus/*.fmu"), key=lambda path: (path.stem, str(path))):
        version = "2.0" if "2" in fmu.parts[-3] else "3.0"
        cells, remarks = [], []
        for interface in ("co-simulation", "model-exchange"):
            try:
                worst, where, varying, remark = largest_deviation(fmu, checkout / fmu.stem, interface)
                count = f"of {varying}"
                cells.append(f"{worst:.1e} ({where}, {count})" if worst else f"0 ({count})")
                remarks.append(remark)
            except (OrchestratorError, OSError) as error:
                cells.append("-")
                remarks.append(" ".join(str(error).replace(str(fmu), fmu.name).split())[:120])
        reported = "; ".join(dict.fromkeys(one for one in remarks if one))
        print(f"| {fmu.stem} | {version} | {cells[0]} | {cells[1]} | {reported} |")


if __name__ == "__main__":
    main()
