"""Ten simulated seconds of the systems in six degrees of freedom at 1 kHz: how much faster than real time.

    python -m tests.benchmarks.six_degrees [SYSTEM ...]

"python": every bundled FMU that has a Python form in it; "native": the compiled forms in the native loop. The
time is that of a long run less that of a short one, after a first that compiles the loop: stepping,
recording and measuring. CPU time beside the clock, since machines are shared.
"""

from __future__ import annotations

import os
import sys
import time

from orchestrator.simulation.run import run

SYSTEMS = ("docking-6d", "docking-6d-arm")
PYTHON_FORM = {
    "docking-6d": ("satellites", "noise", "controller"),
    "docking-6d-arm": ("satellites", "noise", "controller", "inverse", "robot"),
}
SECONDS, SHORT = 10.0, 0.1


def measured(system: str, form: str, seconds: float = SECONDS) -> dict[str, float]:
    """Run a system at 1 kHz in one form.

    Args:
        system: name of a bundled system of PYTHON_FORM.
        form: "python" or "native".
        seconds: simulated time [s].
    Returns: simulated seconds per second of `clock` and of `cpu` time; the number of `contacts`.
    """
    overrides = ["run.step_size=1 ms", "controller.sample_period=1 ms", "noise.sample_period=1 ms"]
    overrides += [f"{name}.form={form}" for name in PYTHON_FORM[system]]
    overrides += ["run.loop=native" if form == "native" else "run.loop=auto"]
    clocks, cpus = [], []
    for length in (SHORT, SHORT, seconds):
        begin, cpu = time.perf_counter(), time.process_time()
        result = run(system, overrides=[*overrides, f"run.stop_time={length} s"], halving=False)
        clocks.append(time.perf_counter() - begin)
        cpus.append(time.process_time() - cpu)
    return {
        "clock": (seconds - SHORT) / (clocks[-1] - clocks[-2]),
        "cpu": (seconds - SHORT) / (cpus[-1] - cpus[-2]),
        "contacts": float(len(result.summary["contacts"])),
    }


def main(arguments: list[str]) -> int:
    """Print a table."""
    print(f"{SECONDS:g} s at 1 kHz, simulated seconds per second; load {os.getloadavg()[0]:.1f}")
    print(f"{'system':20}{'form':>8}{'clock':>9}{'CPU':>9}{'contacts':>10}")
    for system in arguments or SYSTEMS:
        for form in ("python", "native"):
            found = measured(system, form)
            print(
                f"{system:20}{form:>8}{found['clock']:9.2f}{found['cpu']:9.2f}{found['contacts']:10.0f}",
                flush=True,
            )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
