"""Masters that others wrote, each asked to run a job.

None of them carries what is connected to inputs before the first step as ours does, hence `Job.initial`.
"""

from __future__ import annotations

import tempfile
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from ctypes import CDLL, RTLD_GLOBAL
from dataclasses import dataclass
from importlib import import_module, metadata
from importlib.util import find_spec
from pathlib import Path

from .job import Job, Part

__all__ = ["CLIENTS", "Client", "Unable"]

Values = dict[str, list[float]]


class Unable(Exception):
    """What a tool has no words for."""


@dataclass(frozen=True)
class Client:
    """A tool.

    Attributes:
        name: as its makers write it.
        package: on the Python Package Index; module: what is imported.
        run: runs a job and gives the watched outputs at the ends of the steps.
        needs: what its import does beyond importing.
        master: which of ours exchanges signals in the same order.
        reads: whether it takes system structure packages.
    """

    name: str
    package: str
    module: str
    run: Callable[[Job], Values]
    needs: Callable[[], object] = lambda: None
    master: str = "jacobi"
    reads: bool = False

    def version(self) -> str:
        """That is installed. Raises: PackageNotFoundError."""
        return metadata.version(self.package)

    def absent(self) -> str:
        """Why it cannot run here; empty if it can."""
        if find_spec(self.module) is None:
            return f"{self.package} is not installed"
        try:
            self.needs()
        except OSError as error:
            return f"{self.package} does not load: {error}"
        return ""

    def warm_up(self) -> None:
        """Import what its jobs need, once for all of them."""
        self.needs()
        import_module(self.module)
        for name in ("filterpy.kalman", "pinocchio"):  # of our Python FMUs
            with suppress(ImportError):
                import_module(name)


def split(port: str) -> tuple[str, str]:
    """Instance and variable."""
    instance, _, variable = port.partition(".")
    return instance, variable


def starts(job: Job) -> dict[str, dict[str, object]]:
    """Start values by instance, of connected inputs, too."""
    found: dict[str, dict[str, object]] = {part.name: dict(part.start) for part in job.parts}
    for port, value in job.initial.items():
        instance, variable = split(port)
        found[instance][variable] = value
    return found


# FMPy.


def fmpy_fmu(job: Job) -> Values:
    """simulate_fmu: one FMU, its inputs as a table; simulate_ssp: a package."""
    import fmpy
    import numpy as np

    if job.package:
        return fmpy_ssp(job)
    part, signals = driven(job)
    # The end of a step is reached within rounding; half a step more ends the run after it.
    found = fmpy.simulate_fmu(
        part.path,
        start_values=part.start,
        input=table(job, signals) if signals else None,
        output=[split(port)[1] for port in job.watched],
        step_size=job.step_size,
        output_interval=job.step_size,
        stop_time=job.step_size * job.steps,
        fmi_type="CoSimulation",
    )
    return {port: np.asarray(found[split(port)[1]], float)[1:].tolist() for port in job.watched}


def fmpy_ssp(job: Job) -> Values:
    """Its simulation applies one parameter set, by hierarchical names, and no bindings."""
    from fmpy.ssp.simulation import simulate_ssp
    from fmpy.ssp.ssd import ParameterSet, read_ssv

    start = ParameterSet(name="start")
    with zipfile.ZipFile(job.package) as archive:
        sets = [one for one in archive.namelist() if one.endswith(".ssv")]
    for one in sets:
        for parameter in read_ssv(job.package, one).parameters:
            parameter.name = f"{Path(one).stem}.{parameter.name}"
            start.parameters.append(parameter)
    stop = (job.steps - 0.5) * job.step_size
    found = simulate_ssp(job.package, stop_time=stop, step_size=job.step_size, parameter_set=start)
    return {port: found[port].tolist()[: job.steps] for port in job.watched}


def driven(job: Job) -> tuple[Part, dict[str, list[float]]]:
    """The one FMU of a job and what its inputs get, where everything else only drives it."""
    targets = {split(port)[0] for _, port in job.links} or {job.parts[0].name}
    if len(targets) != 1 or any(split(source)[0] in targets for source, _ in job.links):
        raise Unable("runs single FMUs")
    (one,) = [part for part in job.parts if part.name in targets]
    return one, {split(target)[1]: job.driven[source] for source, target in job.links}


def table(job: Job, signals: dict[str, list[float]]):
    """Inputs as FMPy takes them."""
    import numpy as np

    rows = np.zeros(job.steps + 1, dtype=[("time", float), *((name, float) for name in signals)])
    rows["time"] = np.arange(job.steps + 1) * job.step_size
    for name, values in signals.items():
        rows[name] = values
    return rows


# libcosim.


def libcosim(job: Job) -> Values:
    """Its fixed-step algorithm."""
    from libcosimpy import CosimLogging
    from libcosimpy.CosimEnums import CosimVariableType
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    CosimLogging.log_output_level(CosimLogging.CosimLogLevel.FATAL)
    if job.package:
        with zipfile.ZipFile(job.package) as archive:
            archive.extractall("package")
        execution = CosimExecution.from_ssp_file("package")  # with the step size of its annotation
        numbers = {part.name: execution.slave_index_from_instance_name(part.name) for part in job.parts}
    else:
        execution = CosimExecution.from_step_size(job.step_size * 1e9)
        slaves = {part.name: CosimLocalSlave(part.path, part.name) for part in job.parts}
        numbers = {name: execution.add_local_slave(slave) for name, slave in slaves.items()}
    if min(numbers.values()) < 0:
        raise RuntimeError(_cosim_error())
    variables = {name: execution.slave_variables(number) for name, number in numbers.items()}
    references = {
        f"{name}.{variable.name.decode()}": (variable.reference, variable.type)
        for name, group in variables.items()
        for variable in group
    }
    parts = {part.name: part for part in job.parts}
    given = {
        0: execution.real_initial_value,
        1: execution.integer_initial_value,
        2: execution.string_initial_value,
        3: execution.boolean_initial_value,
    }
    for name, values in starts(job).items():
        for variable, value in values.items():
            if job.package and variable in parts[name].start:
                continue  # is in the package
            if f"{name}.{variable}" not in references:
                raise Unable(f"does not see {variable}")
            reference, kind = references[f"{name}.{variable}"]
            if not given[int(kind)](numbers[name], reference, value):
                raise RuntimeError(f"start value of {variable}: {_cosim_error()}")
    for source, target in () if job.package else job.links:
        (a, b), (c, d) = ((numbers[split(port)[0]], references[port][0]) for port in (source, target))
        if execution.connect_real_variables(a, b, c, d):  # 0 means done
            raise RuntimeError(f"{source} -> {target}: {_cosim_error()}")
    observer = CosimObserver.create_time_series(buffer_size=job.steps + 2)
    execution.add_observer(observer)
    for port in job.watched:
        observer.start_time_series(numbers[split(port)[0]], references[port][0], CosimVariableType.REAL)
    if not execution.step(job.steps):
        raise RuntimeError(_cosim_error())
    found = {}
    for port in job.watched:
        number, reference = numbers[split(port)[0]], references[port][0]
        found[port] = list(observer.time_series_real_samples(number, reference, 1, job.steps)[2])
    return found


def _cosim_error() -> str:
    from libcosimpy._internal import get_last_error_message

    return get_last_error_message()


# Ecos.


def load_tbb() -> None:
    """The library libtbb.so.12 that ecospy needs may come from the package tbb."""
    try:
        import_module("ecospy")
    except OSError:
        with suppress(metadata.PackageNotFoundError):
            for one in metadata.files("tbb") or ():
                if one.name == "libtbb.so.12":
                    CDLL(str(one.locate().resolve()), mode=RTLD_GLOBAL)
        import_module("ecospy")


def ecos(job: Job) -> Values:
    """Its fixed-step algorithm.

    Outputs are shown after inputs are exchanged, those with direct feedthrough evaluated anew; the inputs
    that they feed get what they were before. Hence inputs are read; an output that feeds nothing
    feeds a sink.
    """
    import ecospy

    fed = dict(job.links)
    if job.package:
        with ecospy.EcosSimulation(ssp_path=job.package, step_size=job.step_size) as simulation:
            return _ecos_values(simulation, job, {port: fed.get(port, port) for port in job.watched}, "start")
    loose = [port for port in job.watched if port not in fed]
    sunk = {port: f"sink.u[{number}]" for number, port in enumerate(loose, 1)}
    with ecospy.EcosSimulationStructure() as structure:
        for part in job.parts:
            structure.add_model(part.name, part.path)
        structure.add_model("sink", job.bench)
        for source, target in (*job.links, *sunk.items()):
            structure.make_real_connection(_ecos_name(source), _ecos_name(target))
        given = {
            f"{name}::{variable}": value
            for name, values in starts(job).items()
            for variable, value in values.items()
        }
        structure.add_parameter_set("start", given)
        with ecospy.EcosSimulation(structure=structure, step_size=job.step_size) as simulation:
            shown = {port: fed.get(port) or sunk[port] for port in job.watched}
            return _ecos_values(simulation, job, shown, "start")


def _ecos_values(simulation, job: Job, shown: dict[str, str], parameters: str) -> Values:
    simulation.init(parameter_set=parameters)
    found: Values = {port: [] for port in job.watched}
    for _ in range(job.steps):
        simulation.step(1)
        for port, values in found.items():
            values.append(simulation.get_real(_ecos_name(shown[port])))
    return found


def _ecos_name(port: str) -> str:
    return port.replace(".", "::", 1)


# FMU containers.


def container(job: Job) -> Values:
    """A container made of the FMUs, its own master inside; run by FMPy, which is its only host here."""
    import shutil

    import fmpy
    import numpy as np
    from fmu_manipulation_toolbox.assembly import AssemblyNode

    folder = Path.cwd()
    if job.package:
        raise Unable("reads packages in its command line alone")
    node = AssemblyNode("all.fmu", job.step_size, auto_link=False, auto_output=False)
    # A container tells its parts apart by their file names.
    files = {part.name: f"{part.name}.fmu" for part in job.parts}
    for part in job.parts:
        shutil.copy(part.path, folder / files[part.name])
        node.add_fmu(files[part.name])
    for source, target in job.links:
        (a, b), (c, d) = split(source), split(target)
        node.add_link(files[a], b, files[c], d)
    for name, values in starts(job).items():
        for variable, value in values.items():
            node.add_start_value(files[name], variable, str(value).lower() if value is True else str(value))
    for port in job.watched:
        instance, variable = split(port)
        node.add_output(files[instance], variable, f"watched {port}")  # links take the plain names
    node.make_fmu(folder)
    found = fmpy.simulate_fmu(
        str(folder / "all.fmu"),
        output=[f"watched {port}" for port in job.watched],
        step_size=job.step_size,
        output_interval=job.step_size,
        stop_time=job.step_size * job.steps,
    )
    return {port: np.asarray(found[f"watched {port}"], float)[1:].tolist() for port in job.watched}


# CoFMUPy.


def cofmupy(job: Job) -> Values:
    """Its Jacobi algorithm, all instances as one group."""
    from cofmupy.master import DefaultMaster

    given = starts(job)
    connections: dict[tuple[str, str], list[tuple[str, str]]] = {}
    for source, target in job.links:
        connections.setdefault(split(source), []).append(split(target))
    parts = [{"id": part.name, "path": part.path, "initialization": given[part.name]} for part in job.parts]
    with quiet():
        master = DefaultMaster(parts, connections, [[part.name for part in job.parts]], "jacobi")
        master.init_simulation()
        for _ in range(job.steps):
            master.do_step(job.step_size)
    results = master.get_results()
    return {port: list(map(float, results[split(port)])) for port in job.watched}


@contextmanager
def quiet() -> Iterator[None]:
    """Nothing printed."""
    with tempfile.TemporaryFile("w") as sink, redirect_stdout(sink):
        yield


# PathSim.


def pathsim(job: Job) -> Values:
    """Blocks of its toolbox for FMI, stepped by its scheduled events, one after the other in their order."""
    from pathsim import Connection, Simulation
    from pathsim_fmi.blocks import CoSimulationFMU

    given = starts(job)
    blocks = {
        part.name: CoSimulationFMU(part.path, part.name, given[part.name], job.step_size)
        for part in job.parts
    }
    wires = [
        Connection(blocks[split(source)[0]][split(source)[1]], blocks[split(target)[0]][split(target)[1]])
        for source, target in job.links
    ]
    simulation = Simulation(list(blocks.values()), wires, dt=job.step_size, log=False)
    # An event at its start takes a step: after that at time 0, outputs are those of the first step's end.
    found: Values = {port: [] for port in job.watched}
    for _ in range(job.steps):
        simulation.timestep(job.step_size)
        for port, values in found.items():
            name, variable = split(port)
            values.append(float(blocks[name].outputs[variable]))
    return found


CLIENTS = {
    client.package: client
    for client in (
        Client("FMPy", "fmpy", "fmpy", fmpy_fmu, reads=True),
        Client("libcosim", "libcosimpy", "libcosimpy", libcosim, reads=True),
        Client("Ecos", "ecospy", "ecospy", ecos, load_tbb, reads=True),
        Client("FMU containers", "fmu-manipulation-toolbox", "fmu_manipulation_toolbox", container),
        Client("PathSim", "pathsim-fmi", "pathsim_fmi", pathsim, master="gauss-seidel"),
        Client("CoFMUPy", "cofmupy", "cofmupy", cofmupy),
    )
}
