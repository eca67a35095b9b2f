"""Windows binaries of shipped FMUs, run by Wine, give what the binaries of this platform give."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orchestrator.exchange.system_fmu import export_system_fmu
from orchestrator.fmi import Point, load_fmu
from tests.clients.subjects import AMPLITUDES

DRIVER = Path(__file__).with_name("windows.c")
FMUS = [
    path
    for path in sorted((Path(__file__).parents[2] / "fmus").glob("*/*.fmu"))
    # The Python form loads the Python of its platform.
    if path.stem.endswith("-native") or not path.with_name("model.py").exists()
]
SYSTEMS = {
    "system-fmi2": ("docking-1d", "2.0"),
    "system-fmi3": ("docking-6d", "3.0"),
}
NAMES = (*(path.stem for path in FMUS), *SYSTEMS)
# Else they make no noise and no friction.
RUBBING = {"viscous": 5.0, "stiffness": 1e5, "level": 10.0}
START = {
    "SensorNoise-native": {"force_sigma": 1.0, "torque_sigma": 0.1},
    "FrictionForce": RUBBING,
    "FrictionForce-fmi3": RUBBING,
}
STEPS, SIZE = 40, 5e-4
COMMAND = shutil.which("wine64") or shutil.which("wine")
# Wine makes its folders first, which takes 15 s here.
SECONDS = 300.0

pytestmark = [
    pytest.mark.skipif(COMMAND is None or sys.platform == "win32", reason="Wine is not installed"),
    pytest.mark.skipif(find_spec("ziglang") is None, reason="building a Windows program needs ziglang"),
]


@dataclass(frozen=True)
class Task:
    """An FMU to step.

    Attributes:
        path: the FMU; folder: where it is unpacked.
        size: step size [s].
        start: values by name; inputs, outputs: names.
        fed: values of the inputs, shape (steps, inputs).
    """

    path: Path
    folder: Path
    size: float
    start: dict[str, float]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    fed: np.ndarray

    def words(self, name: str) -> Iterator[Any]:
        """What the driver reads."""
        description = load_fmu(self.path).description
        reference = {one.name: one.reference for one in description.variables.values()}
        two = description.fmi_version == "2.0"
        library = f"binaries/{'win64' if two else 'x86_64-windows'}/{description.model_identifier}.dll"
        resources = self.folder / "resources"
        yield from (name, description.fmi_version[0], f"Z:{self.folder / library}")
        yield from (f"file:///Z:{resources}" if two else f"Z:{resources}\\", description.token)
        yield len(self.start)
        for variable, value in self.start.items():
            yield from (reference[variable], repr(value))
        for names in (self.inputs, self.outputs):
            yield from (len(names), *map(reference.__getitem__, names))
        yield from (len(self.fed), repr(self.size), *map(repr, self.fed.ravel().tolist()))

    def here(self) -> np.ndarray:
        """Outputs after each step of the binary of this platform, shape (steps, outputs)."""
        instance = load_fmu(self.path).instantiate("one")
        rows = []
        try:
            instance.enter_initialisation(0.0, self.start)
            instance.exit_initialisation()
            for step, values in enumerate(self.fed.tolist()):
                instance.set_values(dict(zip(self.inputs, values, strict=True)))
                instance.do_step(Point(step, step * self.size, self.size))
                found = instance.get_values(self.outputs)
                rows.append([float(found[name]) for name in self.outputs])
        finally:
            instance.free()
        return np.array(rows)


def task(path: Path, folder: Path, size: float) -> Task:
    """What is asked of an FMU."""
    with zipfile.ZipFile(path) as archive:
        archive.extractall(folder)
    description = load_fmu(path).description
    inputs, outputs = (
        [one for one in group if one.type in ("Real", "Float64")]
        for group in (description.inputs, description.outputs)
    )
    offsets = np.array([float(one.start or 0.0) for one in inputs])
    amplitudes = np.array([AMPLITUDES.get(one.unit_name or "", 0.0) for one in inputs])
    fed = offsets + np.outer(np.sin(np.pi * np.arange(STEPS) / STEPS), amplitudes)
    names = (tuple(one.name for one in group) for group in (inputs, outputs))
    return Task(path, folder, size, START.get(path.stem, {}), *names, fed)


@pytest.fixture(scope="module")
def tasks(tmp_path_factory):
    """By name."""
    folder = tmp_path_factory.mktemp("fmus")
    found = {path.stem: task(path, folder / path.stem, SIZE) for path in FMUS}
    for name, (system, version) in SYSTEMS.items():
        report = export_system_fmu(system, folder / f"{name}.fmu", fmi_version=version)
        found[name] = task(report.path, folder / name, report.step_size)
    return found


@pytest.fixture(scope="module")
def windows(tasks, tmp_path_factory):
    """Rows of outputs by name, and what went wrong; one program runs them all, since Wine starts slowly."""
    folder = tmp_path_factory.mktemp("wine")
    program, jobs = folder / "windows.exe", folder / "jobs.txt"
    compiler = [sys.executable, "-m", "ziglang", "cc", "-target", "x86_64-windows-gnu", "-O1"]
    subprocess.run([*compiler, "-o", str(program), str(DRIVER)], check=True, capture_output=True)
    jobs.write_text("\n".join(" ".join(map(str, one.words(name))) for name, one in tasks.items()))
    settings = {**os.environ, "WINEPREFIX": str(folder / "prefix"), "WINEDEBUG": "-all", "DISPLAY": ""}
    # Else it offers to install .NET and a browser, and waits.
    settings["WINEDLLOVERRIDES"] = "mscoree,mshtml="
    # Its server outlives the program and would keep pipes open, and the test waiting: hence files.
    reported, errors = folder / "told.txt", folder / "errors.txt"
    with reported.open("wb") as out, errors.open("wb") as err:
        try:
            command = [COMMAND, str(program), f"Z:{jobs}"]
            subprocess.run(command, env=settings, stdout=out, stderr=err, timeout=SECONDS, check=True)
        finally:
            # The one of this prefix alone.
            server = [shutil.which("wineserver") or "/usr/lib/wine/wineserver64", "-k"]
            subprocess.run(server, env=settings, stdout=err, stderr=err, timeout=SECONDS, check=False)
    return rows_of(reported.read_text()), errors.read_text()


def rows_of(reported: str) -> dict[str, list[list[float]]]:
    """Those of the jobs that came to their end."""
    found: dict[str, list[list[float]]] = {}
    rows: list[list[float]] = []
    for line in reported.splitlines():
        name, _, what = line.rpartition(" ")
        if what == "begins":
            rows = []
        elif what == "ends":
            found[name] = rows
        else:
            rows.append([float(word) for word in line.split()])
    return found


@pytest.mark.parametrize("name", NAMES)
def test_the_windows_binary_gives_the_same(name, tasks, windows):
    rows, errors = windows
    assert name in rows, [line for line in errors.splitlines() if line.startswith(f"{name}: ")]
    theirs, ours = np.array(rows[name]), tasks[name].here()
    assert theirs.shape == ours.shape == (STEPS, len(tasks[name].outputs))
    assert ours.any()
    # Their mathematics libraries differ in the last bits.
    worst = np.abs(theirs - ours).max(axis=0) / np.maximum(np.abs(ours).max(axis=0), 1e-3)
    assert dict(zip(tasks[name].outputs, worst, strict=True)) == pytest.approx(
        dict.fromkeys(tasks[name].outputs, 0.0), abs=1e-9
    )
