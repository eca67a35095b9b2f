"""CPU time of a non-stiff Modelica model against the same model and method written by hand in C.

    python -m tests.benchmarks.chain_speed [--rounds N]

Eight masses on springs that stiffen, without and with an event in the model. Both sides run in turns and
are compiled by the same compiler; the median of the ratios of each round is printed. The C program gets the
largest tolerance with which it is as accurate as the FMU. Errors are those against scipy's DOP853, tolerance
1e-13.
"""

from __future__ import annotations

import argparse
import ctypes
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from .stiff_models import EVENT, fmu_run

MASSES, STOP = 8, 200.0
START = [*([0.0] * (MASSES - 1)), 1.0, *([0.0] * MASSES)]


def _text(event: bool) -> str:
    n = MASSES
    starts = "{" + ", ".join(map(str, START)) + "}"
    return (
        f"Real y[{2 * n}](start={starts}, each fixed=true);\nReal s[{n + 1}];\n"
        + (EVENT if event else "equation\n")
        + f"s[1] = y[1];\ns[{n + 1}] = -y[{n}];\nfor i in 2:{n} loop\ns[i] = y[i] - y[i - 1];\nend for;\n"
        f"for i in 1:{n} loop\nder(y[i]) = y[{n} + i];\n"
        f"der(y[{n} + i]) = s[i + 1] + s[i + 1]^3 - s[i] - s[i]^3;\nend for;\n"
    )


def _slopes(_: float, y: Any) -> np.ndarray:
    s = np.diff(np.concatenate([[0.0], y[:MASSES], [0.0]]))
    force = s + s**3
    return np.concatenate([y[MASSES:], np.diff(force)])


def _c_run(folder: Path) -> Callable[[float], tuple[float, np.ndarray]]:
    library = folder / "chain.so"
    source = Path(__file__).parent / "chain.c"
    command = [
        sys.executable,
        "-m",
        "ziglang",
        "cc",
        "-O2",
        "-shared",
        "-fPIC",
        str(source),
        "-o",
        str(library),
    ]
    subprocess.run(command, check=True)
    integrate = ctypes.CDLL(str(library)).integrate
    integrate.argtypes = [ctypes.c_void_p, ctypes.c_double, ctypes.c_double]

    def run(tolerance: float) -> tuple[float, np.ndarray]:
        y = np.array(START)
        begin = time.process_time()
        integrate(y.ctypes.data, STOP, tolerance)
        return time.process_time() - begin, y

    return run


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=9)
    rounds = parser.parse_args(arguments).rounds
    exact = solve_ivp(_slopes, (0, STOP), START, method="DOP853", rtol=1e-13, atol=1e-15).y[:, -1]
    print("| model | FMU | C | ratio | error FMU | error C |\n|---|---|---|---|---|---|")
    for event in (False, True):
        with tempfile.TemporaryDirectory() as folder:
            ours, other = fmu_run(Path(folder), _text(event), 2 * MASSES, STOP), _c_run(Path(folder))
            reached = np.abs(ours()[1] - exact).max()
            for exponent in np.arange(-3, -13.1, -0.05):
                tolerance = float(10**exponent)
                if (error := np.abs(other(tolerance)[1] - exact).max()) <= reached:
                    break
            pairs = [(ours()[0], other(tolerance)[0]) for _ in range(rounds)]
        times = [1e3 * median(one) for one in zip(*pairs, strict=True)]
        ratio = median(a / b for a, b in pairs)
        name = "with an event" if event else "without events"
        print(
            f"| {name} | {times[0]:.1f} ms | {times[1]:.1f} ms | {ratio:.1f} | {reached:.1e} | {error:.1e} |"
        )


if __name__ == "__main__":
    main()
