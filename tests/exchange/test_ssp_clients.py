"""Our packages in tools that we did not write: the same trajectories as here."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import zipfile
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from orchestrator.exchange.ssp.write import write_ssp
from orchestrator.run import run

# libcosim gives start values to parameters and inputs only: no satellite that moves at the start.
PUSHED = {
    "run": {"master": "jacobi", "step_size": "0.1 ms", "stop_time": "0.2 s"},
    "instances": {
        "robot": {
            "fmu": "RobotResponse",
            "start": {"omega_n": "25 Hz", "xi_n": 0.8, "tau_m": "2 ms", "command": "7 mm"},
        },
        "contact": {"fmu": "DockingContact", "start": {"stiffness": "176 N/mm", "front": "5 mm"}},
        "sensor": {"fmu": "ForceSensor", "start": {"cutoff": "200 Hz"}},
    },
    "connections": [
        {
            "from": "robot.position",
            "to": "contact.position",
            "through": [{"gain": 1.25}, {"offset": "-1 mm"}],
        },
        "robot.velocity -> contact.velocity",
        "contact.force -> sensor.force",
    ],
}
# From rest at zero: Ecos and fmpy do not carry outputs to inputs before the first step.
FLYING = ("run.master=jacobi", "run.stop_time=0.5 s", "satellite.form=native")

_LIBCOSIM = """
import json, sys
from libcosimpy import CosimLogging
from libcosimpy.CosimEnums import CosimVariableType
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimObserver import CosimObserver
path, instance, name, steps = sys.argv[1:5]
CosimLogging.log_output_level(CosimLogging.CosimLogLevel.ERROR)
execution = CosimExecution.from_ssp_file(path)
slave = execution.slave_index_from_instance_name(instance)
(one,) = [v.reference for v in execution.slave_variables(slave) if v.name.decode() == name]
observer = CosimObserver.create_time_series(buffer_size=int(steps) + 2)
execution.add_observer(observer)
observer.start_time_series(slave, one, CosimVariableType.REAL)
execution.step(int(steps))
_, _, values = observer.time_series_real_samples(slave, one, 1, int(steps))
print(json.dumps(list(values)))
"""

_ECOS = """
import ctypes, json, sys
from importlib.metadata import files
try:
    import ecospy
except OSError:
    for one in files("tbb") or ():
        if one.name == "libtbb.so.12":
            ctypes.CDLL(str(one.locate().resolve()), mode=ctypes.RTLD_GLOBAL)
    import ecospy
path, instance, name, steps = sys.argv[1:5]
values = []
with ecospy.EcosSimulation(ssp_path=path, step_size=1e-4) as simulation:
    simulation.init(parameter_set="start")
    for _ in range(int(steps)):
        simulation.step(1)
        values.append(simulation.get_real(f"{instance}::{name}"))
print(json.dumps(values))
"""

_FMPY = """
import json, sys, zipfile
from pathlib import Path
from fmpy.ssp.simulation import simulate_ssp
from fmpy.ssp.ssd import ParameterSet, read_ssv
path, instance, name, steps = sys.argv[1:5]
start = ParameterSet(name="start")
with zipfile.ZipFile(path) as archive:
    sets = [one for one in archive.namelist() if one.endswith(".ssv")]
for one in sets:  # its simulation applies one set, by hierarchical names
    for parameter in read_ssv(path, one).parameters:
        parameter.name = f"{Path(one).stem}.{parameter.name}"
        start.parameters.append(parameter)
found = simulate_ssp(path, stop_time=(int(steps) - 0.5) * 1e-4, step_size=1e-4, parameter_set=start)
print(json.dumps(found[f"{instance}.{name}"].tolist()[: int(steps)]))
"""

_OMSIMULATOR = """
import json, sys
from OMSimulator import SSP, CRef
path, instance, name, steps = sys.argv[1:5]
model = SSP(path)
running = model.instantiate()
running.initialize()
values = []
for step in range(1, int(steps) + 1):
    running.stepUntil(step * 1e-4)
    values.append(running.getValue(CRef("default", instance, name)))
print(json.dumps(values))
"""


def client(script, path, port, steps):
    """What another tool computes of a port at the ends of the steps, in a process of its own."""
    instance, _, name = port.partition(".")
    command = [sys.executable, "-c", script, str(path), instance, name, str(steps)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240, check=False, env=os.environ)
    if "libtbb" in done.stderr:
        pytest.skip("ecospy needs libtbb.so.12, which the package tbb carries, too")
    assert done.returncode == 0, done.stderr[-2000:]
    return np.array(json.loads(done.stdout.splitlines()[-1]))


@pytest.fixture(scope="module")
def pushed(tmp_path_factory):
    """Package and results of a robot that is pushed against a contact."""
    path = tmp_path_factory.mktemp("pushed") / "X.ssp"
    assert write_ssp(PUSHED, path).lost == ()
    results = run(PUSHED, halving=False).results
    assert np.ptp(results["sensor.measured_force"]) > 100.0
    return path, results


@pytest.fixture(scope="module")
def flying(tmp_path_factory):
    """Package and results of the uncompensated docking contact."""
    path = tmp_path_factory.mktemp("flying") / "X.ssp"
    write_ssp("docking-1d-uncompensated", path, FLYING)
    results = run("docking-1d-uncompensated", overrides=FLYING, halving=False).results
    assert np.abs(results["contact.force"]).max() > 100.0
    return path, results


def agree(values, column):
    assert len(values) == len(column) - 1
    np.testing.assert_allclose(values, column[1:], rtol=1e-9, atol=1e-9 * np.abs(column).max())


@pytest.mark.skipif(find_spec("libcosimpy") is None, reason="libcosimpy is not installed")
def test_libcosim_runs_a_package_with_the_step_size_of_its_annotation(pushed, tmp_path):
    path, results = pushed
    with zipfile.ZipFile(path) as archive:
        archive.extractall(tmp_path)
    assert Path(tmp_path, "SystemStructure.ssd").is_file()
    values = client(_LIBCOSIM, tmp_path, "sensor.measured_force", 2000)
    # libcosim evaluates transformations as instances of their own, after the steps as here: no delay.
    agree(values, results["sensor.measured_force"])


@pytest.mark.skipif(find_spec("ecospy") is None, reason="ecospy is not installed")
@pytest.mark.parametrize("case", ["pushed", "flying"])
def test_ecos_runs_packages(case, request):
    path, results = request.getfixturevalue(case)
    port = {"pushed": "sensor.measured_force", "flying": "robot.position"}[case]
    agree(client(_ECOS, path, port, len(results) - 1), results[port])


def test_fmpy_runs_a_package(flying):
    path, results = flying
    values = client(_FMPY, path, "robot.position", 5000)
    agree(values, results["robot.position"])


@pytest.mark.skipif(find_spec("OMSimulator") is None, reason="OMSimulator is not installed")
def test_omsimulator_runs_a_package(flying):
    path, results = flying
    values = client(_OMSIMULATOR, path, "robot.position", 5000)
    scale = np.abs(results["robot.position"]).max()
    assert np.abs(values - results["robot.position"][1:]).max() < 1e-3 * scale


@pytest.mark.skipif(find_spec("pyssp_standard") is None, reason="pyssp-standard is not installed")
@pytest.mark.parametrize("version", ["1.0", "2.0"])
def test_what_is_written_keeps_to_the_schemas(version, tmp_path):
    from lxml import etree

    origin = find_spec("pyssp_standard").origin
    folder = Path(origin).parent / "resources" / ("ssp2" if version == "2.0" else "")
    kinds = {".ssd": "SystemStructureDescription", ".ssv": "SystemStructureParameterValues"}
    for name in ("docking-1d", "docking-6d"):
        write_ssp(name, tmp_path / "X.ssp", version=version)
        with zipfile.ZipFile(tmp_path / "X.ssp") as archive:
            for entry in archive.namelist():
                if Path(entry).suffix in kinds:
                    schema = etree.XMLSchema(file=str(folder / f"{kinds[Path(entry).suffix]}.xsd"))
                    schema.assertValid(etree.fromstring(archive.read(entry)))
