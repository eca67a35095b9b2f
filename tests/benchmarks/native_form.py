"""CPU time per step of the Python and the native form of each Python FMU, paired in one run.

    python -m tests.benchmarks.native_form

A step is doStep alone, called in a loop of C (compiled by ziglang), so that the caller is not measured.
Inputs are those of the shipped reference, one row a step; setting them is timed by itself and taken off.
"""

from __future__ import annotations

import ctypes
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

import fmpy
from fmpy.fmi2 import FMU2Slave

FMUS = Path(__file__).parents[2] / "fmus"
STEP = 5e-4
# The controller takes one sample a step. Steps per round: enough for a few per cent.
STEPS = {"": 2000, "-native": 100000}
ROUNDS = 5
LOOP = r"""
#include <stddef.h>
#include <time.h>
typedef int Step(void *, double, double, int);
typedef int Set(void *, const unsigned *, size_t, const double *);
/* CPU seconds of n steps, from step number `first`; every step has a row of inputs. */
double loop(Step *step, Set *set, void *instance, long first, long n, double size, const unsigned *references,
            size_t n_inputs, const double *inputs, long n_rows, int *worst)
{
    struct timespec begin, end;
    double spent = 0;
    for (int pass = 0; pass < 2; pass++) { /* the first with doStep, the second without: taken off */
        clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &begin);
        for (long i = first; i < first + n; i++) {
            int status = set(instance, references, n_inputs, inputs + (i % n_rows) * (long)n_inputs);
            if (!pass && !status) status = step(instance, (double)i * size, size, 1);
            if (status > *worst) *worst = status;
        }
        clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &end);
        double took = (double)(end.tv_sec - begin.tv_sec) + 1e-9 * (double)(end.tv_nsec - begin.tv_nsec);
        spent += pass ? -took : took;
    }
    return spent;
}
"""


def compiled(folder: Path) -> ctypes.CDLL:
    """The loop, as a library."""
    (folder / "loop.c").write_text(LOOP)
    command = [sys.executable, "-m", "ziglang", "cc", "-shared", "-fPIC", "-O2", "-o", "loop.so", "loop.c"]
    subprocess.run(command, cwd=folder, check=True)
    library = ctypes.PyDLL(str(folder / "loop.so"))
    library.loop.restype = ctypes.c_double
    return library


class Timed:
    """An instance of a form, with inputs of its reference."""

    def __init__(self, name: str, form: str, folder: Path, library: ctypes.CDLL) -> None:
        path = FMUS / name / f"{name}{form}.fmu"
        description = fmpy.read_model_description(str(path))
        inputs = [variable for variable in description.modelVariables if variable.causality == "input"]
        lines = (FMUS / name / "reference.csv").read_text().splitlines()
        columns = [column.split(" [")[0] for column in lines[0].split(",")]
        places = [columns.index(variable.name) for variable in inputs]
        rows = [[float(line.split(",")[place]) for place in places] for line in lines[1:]]
        self.name, self.n_rows = f"{name}{form}", len(rows)
        self.references = (ctypes.c_uint * len(inputs))(*(variable.valueReference for variable in inputs))
        self.rows = (ctypes.c_double * (len(rows) * len(inputs)))(*(value for row in rows for value in row))
        self.loop, self.done = library.loop, 0
        self.fmu = FMU2Slave(
            guid=description.guid,
            unzipDirectory=fmpy.extract(str(path), unzipdir=str(folder / self.name)),
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName=name,
        )
        self.fmu.instantiate()
        self.fmu.setupExperiment(startTime=0.0)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()

    def run(self, number: int) -> float:
        """Make further steps; CPU time of one [s]."""
        address = [
            ctypes.cast(getattr(self.fmu.dll, f), ctypes.c_void_p) for f in ("fmi2DoStep", "fmi2SetReal")
        ]
        worst = ctypes.c_int(0)
        spent = self.loop(
            *address, ctypes.c_void_p(self.fmu.component), ctypes.c_long(self.done), ctypes.c_long(number),
            ctypes.c_double(STEP), self.references, ctypes.c_size_t(len(self.references)), self.rows,
            ctypes.c_long(self.n_rows), ctypes.byref(worst),
        )  # fmt: skip
        if worst.value:
            raise RuntimeError(f"{self.name}: status {worst.value}")
        self.done += number
        return spent / number


def main() -> None:
    """Print microseconds per step, median of a few rounds, and the ratio."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        library = compiled(folder)
        print(f"{'':24}{'python':>10}{'native':>10}{'ratio':>8}   [us of CPU per step]")
        for model in ("SatelliteDynamics", "ComplianceController", "WrenchController"):
            timed = {form: Timed(model, form, folder, library) for form in STEPS}
            rounds = [{form: one.run(STEPS[form]) for form, one in timed.items()} for _ in range(ROUNDS)]
            python, native = (1e6 * statistics.median(one[form] for one in rounds) for form in STEPS)
            print(f"{model:24}{python:10.2f}{native:10.4f}{python / native:8.0f}")


if __name__ == "__main__":
    main()
