"""Those who run the timed systems.

Each takes a plant, whether to record, and a number of steps.
"""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Callable
from ctypes import CDLL, RTLD_GLOBAL
from fractions import Fraction
from importlib import import_module
from pathlib import Path
from time import perf_counter, process_time
from typing import NamedTuple

from orchestrator.master import create_master
from orchestrator.results.recorders import Recorder
from orchestrator.simulation.grid import Grid
from orchestrator.simulation.loop import simulate

from .systems import STEP_SIZE, Plant

__all__ = ["CONTENDERS", "Outcome"]


class Outcome(NamedTuple):
    """CPU time of all threads [s], the outputs at the end, the time on the clock [s] where it was taken."""

    cpu: float
    outputs: list[float] | None
    wall: float | None = None


def plain_c(plant: Plant, record: bool, steps: int, check: bool = False) -> Outcome:
    """The C program of master.c."""
    case = plant.case
    numbers = [case.slaves, case.ports, steps, STEP_SIZE, int(record), int(check), *case.sources]
    command = [str(plant.program), str(plant.library), *map(str, numbers)]
    seconds, *outputs = map(float, subprocess.run(command, check=True, capture_output=True).stdout.split())
    return Outcome(seconds, outputs)


def plain_c_checked(plant: Plant, record: bool, steps: int) -> Outcome:
    """The same, which stops at values that are not finite, as the orchestrator does."""
    return plain_c(plant, record, steps, True)


def _orchestrator(loop: str, disk: bool = False, text: bool = False) -> Callable[[Plant, bool, int], Outcome]:
    """Recorded in memory, or on disk, there in CSV, too; the time includes what makes columns of it."""

    def run(plant: Plant, record: bool, steps: int) -> Outcome:
        last: list[float] = []
        with tempfile.TemporaryDirectory() as folder:

            def spent(count: int) -> tuple[float, float]:
                grid = Grid(Fraction(0), Fraction(STEP_SIZE).limit_denominator(10**6), count)
                begin, clock = process_time(), perf_counter()
                path = Path(folder) / "results.arrow" if disk else None
                recorder = Recorder(plant.system, path=path, points=len(grid)) if record else None
                observers = [] if recorder is None else [recorder]
                simulate(plant.system, create_master("jacobi"), grid, observers, loop=loop)
                if recorder is not None:
                    recorder.close()
                    results = None if disk and not text else recorder.results()
                    if results is not None and text:
                        results.to_csv(Path(folder) / "results.csv")
                times = process_time() - begin, perf_counter() - clock
                if recorder is not None:
                    last[:] = [float(column[-1]) for column in recorder.results().signals.values()]
                return times

            spent(1)  # importing, once
            start = spent(1)  # loading and initialising
            cpu, wall = (one - other for one, other in zip(spent(steps), start, strict=True))
        return Outcome(cpu, last or None, wall)

    return run


def fmpy_loop(plant: Plant, record: bool, steps: int) -> Outcome:
    """What one writes with FMPy's API: wrapped calls with lists of numbers."""
    from fmpy import extract
    from fmpy.fmi2 import FMU2Slave

    case = plant.case
    folder = extract(str(plant.fmu))
    slaves = []
    inputs, outputs = list(range(case.ports)), list(range(case.ports, 2 * case.ports))
    for index in range(case.slaves):
        names = {"guid": "lags", "modelIdentifier": "Lags", "instanceName": f"s{index}"}
        slave = FMU2Slave(unzipDirectory=folder, **names)
        slave.instantiate()
        slave.setupExperiment(startTime=0.0)
        slave.enterInitializationMode()
        slave.setReal(inputs, [1.0] * case.ports)
        slave.exitInitializationMode()
        slaves.append(slave)
    y = [value for slave in slaves for value in slave.getReal(outputs)]
    u = [1.0] * len(y)
    rows = []
    begin = process_time()
    for index in range(steps):
        time = index * STEP_SIZE
        if record:
            rows.append((time, *y))
        for target, source in enumerate(case.sources):
            if source >= 0:
                u[target] = y[source]
        for number, slave in enumerate(slaves):
            slave.setReal(inputs, u[number * case.ports : (number + 1) * case.ports])
            slave.doStep(currentCommunicationPoint=time, communicationStepSize=STEP_SIZE)
            y[number * case.ports : (number + 1) * case.ports] = slave.getReal(outputs)
    seconds = process_time() - begin
    for slave in slaves:
        slave.terminate()
        slave.freeInstance()
    return Outcome(seconds, y)


def libcosim(plant: Plant, record: bool, steps: int) -> Outcome:
    """Libcosim's fixed-step algorithm through libcosimpy; recorded by its time-series observer, in memory."""
    from libcosimpy import CosimLogging
    from libcosimpy.CosimEnums import CosimVariableType
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    CosimLogging.log_output_level(CosimLogging.CosimLogLevel.ERROR)
    case = plant.case
    execution = CosimExecution.from_step_size(STEP_SIZE * 1e9)
    slaves = [CosimLocalSlave(str(plant.fmu), f"s{index}") for index in range(case.slaves)]
    numbers = [execution.add_local_slave(slave) for slave in slaves]
    for a, b, c, d in case.links:
        execution.connect_real_variables(numbers[a], case.ports + b, numbers[c], d)
    observer = CosimObserver.create_time_series(buffer_size=steps + 2) if record else None
    if observer is not None:
        execution.add_observer(observer)
        for number in numbers:
            for port in range(case.ports):
                observer.start_time_series(number, case.ports + port, CosimVariableType.REAL)
    execution.step(1)
    begin = process_time()
    execution.step(steps - 1)
    seconds = process_time() - begin
    last = None
    if observer is not None:
        last = [
            observer.time_series_real_samples(number, case.ports + port, steps, 1)[2][-1]
            for number in numbers
            for port in range(case.ports)
        ]
    return Outcome(seconds * steps / (steps - 1), last)


def ecos(plant: Plant, record: bool, steps: int) -> Outcome:
    """Ecos's fixed-step algorithm through ecospy; recorded by its CSV writer, the only recorder it has."""
    ecospy = _ecospy()
    case = plant.case
    with tempfile.TemporaryDirectory() as folder, ecospy.EcosSimulationStructure() as structure:
        for index in range(case.slaves):
            structure.add_model(f"s{index}", str(plant.fmu))
        for a, b, c, d in case.links:
            structure.make_real_connection(f"s{a}::y{b}", f"s{c}::u{d}")
        with ecospy.EcosSimulation(structure=structure, step_size=STEP_SIZE) as simulation:
            if record:
                names = [f"s{s}::y{p}" for s in range(case.slaves) for p in range(case.ports)]
                simulation.add_csv_writer(str(Path(folder) / "results.csv"), identifiers=names)
            simulation.init()
            simulation.step(1)
            begin = process_time()
            simulation.step(steps - 1)
            seconds = process_time() - begin
            last = [simulation.get_real(f"s{s}::y{p}") for s in range(case.slaves) for p in range(case.ports)]
    return Outcome(seconds * steps / (steps - 1), last)


def _ecospy():
    """ecospy; the library libtbb.so.12 that it needs may come from the package tbb."""
    try:
        return import_module("ecospy")
    except OSError:
        from importlib.metadata import files

        for one in files("tbb") or ():
            if one.name == "libtbb.so.12":
                CDLL(str(one.locate().resolve()), mode=RTLD_GLOBAL)
        return import_module("ecospy")


# Name -> who runs it, and for how many steps; the first is what the others are compared with.
CONTENDERS: dict[str, tuple[Callable[[Plant, bool, int], Outcome], int]] = {
    "plain C master": (plain_c, 1_000_000),
    "plain C master, checking values": (plain_c_checked, 1_000_000),
    "orchestrator, native loop": (_orchestrator("native"), 500_000),
    "orchestrator, native loop, to disk": (_orchestrator("native", disk=True), 500_000),
    "orchestrator, native loop, and to CSV": (_orchestrator("native", disk=True, text=True), 50_000),
    "orchestrator, python loop": (_orchestrator("python"), 5_000),
    "FMPy loop": (fmpy_loop, 5_000),
    "libcosim (libcosimpy)": (libcosim, 5_000),
    "Ecos (ecospy)": (ecos, 20_000),
}
