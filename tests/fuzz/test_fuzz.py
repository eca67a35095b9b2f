"""Changed inputs of every sort: each command ends with 0, 1 or 2, in time, and writes nowhere else.

FUZZ=n sets how many inputs of each sort are tried, FUZZ_SEED=s from which seed on. A failure names sort and
seed, and keeps the input.
"""

from __future__ import annotations

import gzip
import json
import os
import subprocess
import sys
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

import foreign
import pytest
import yaml

from orchestrator.cli.main import main
from orchestrator.fmi import bundled

from . import mutations

COUNT, SEED = int(os.environ.get("FUZZ", "30")), int(os.environ.get("FUZZ_SEED", "1"))
# Of processor time, for one command [s], and of memory that it adds [B].
MOST_SECONDS, MOST_MEMORY = 30.0, 2 * 2**30
# Stage of a diagnosis before which it is stopped: checks of the data take seconds.
STOP = "calibration" if COUNT > 30 else "check"
ROOT = Path(__file__).parents[2]

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="limits of memory and time are POSIX")


class Sort(NamedTuple):
    """A sort of input.

    Attributes:
        suffix: of the file.
        seeds: right inputs.
        changed: what changes one.
        commands: what is run with the file; "{}" stands for it.
        beside: further files in its folder, by name.
    """

    suffix: str
    seeds: list[bytes]
    changed: Callable[[Random, bytes], bytes]
    commands: list[list[str]]
    beside: Mapping[str, bytes] = {}


STUDY = """
format: sweep/1
system: docking-1d-uncompensated
set: {run.stop_time: 0.8 s, run.step_size: 8 ms, run.loop: python}
design:
  grid: {robot.tau_m: [4 ms, 8 ms], satellite.mass: {from: 200 kg, to: 300 kg, count: 3}}
derived: {peak: max(abs(contact.force)), end: "final(contact.force) / robot.tau_m"}
record: {every: 10, signals: [contact.force]}
"""
PORTS = """
format: port-study/1
system: docking-1d-uncompensated
set: [run.step_size=4 ms]
columns:
  time: t
  robot.command: {column: x, unit: mm}
  contact.force: {column: f, unit: N, noise: 1 N, feed: false}
calibrated:
  robot.omega_n: {tolerance: 1 Hz}
  contact.stiffness: {tolerance: 5 N/mm}
settle: 20 ms
runs:
  - {file: LOG, role: train, to: 0.6 s}
  - {file: LOG, role: validation, from: 0.6 s}
candidates: {without: [robot.*.quantise]}
"""
EFFECTS = """
run: {master: {name: iterative, tolerance: 1e-8}, step_size: 1 ms, stop_time: 1 s, record: [contact.force]}
instances:
  satellite: {fmu: SatelliteDynamics, start: {mass: 279.07 kg, velocity: 20 mm/s}}
  robot: {fmu: RobotResponse, start: {omega_n: 75 Hz, xi_n: 0.8, tau_m: 2 ms}, step_size: 0.5 ms}
  contact: {fmu: DockingContact, start: {stiffness: 176 N/mm, front: 5 mm, rear: -5 mm}}
connections:
  - {from: satellite.position, to: robot.command, through: [{delay: 1 ms}, {rate-limit: 2 m/s}]}
  - {from: robot.position, to: contact.position, through: [{effect: quantise, resolution: 1 um}]}
  - robot.velocity -> contact.velocity
  - {from: [{port: contact.force, gain: 1}], to: satellite.force, through: [{low-pass: 200 Hz}]}
measures: {docking: {satellite: satellite, robot: robot, contact: contact}}
"""
MODELICA = """
model Tank "A tank that empties"
  parameter Real area(unit = "m2", min = 0) = 2 "cross section";
  parameter Integer n = 3;
  constant Real g = 9.81;
  input Real inflow(unit = "m3/s", start = 0);
  output Real level(unit = "m", start = 1, fixed = true);
  Real x[n](each start = 0, each fixed = true);
protected
  Real outflow;
equation
  outflow = if level > 0 then 0.01 * sqrt(2 * g * level) else 0;
  area * der(level) = inflow - outflow;
  for i in 1:n loop
    der(x[i]) = -i * x[i] + level;
  end for;
  assert(level < 10, "overflow");
end Tank;
"""


def _inside(random: Random, name: str, data: bytes) -> bytes:
    """Content of an entry of an archive, changed."""
    if name.endswith((".xml", ".ssd", ".ssv", ".ssm")):
        return mutations.xml_changed(random, data)
    return mutations.text_changed(random, data)


def _description(fmu: bytes, folder: Path) -> Callable[[Random, bytes], bytes]:
    """What changes nothing but the model description of an FMU."""

    def changed(random: Random, data: bytes) -> bytes:
        path = folder / "seed.fmu"
        path.write_bytes(data)
        with zipfile.ZipFile(path) as archive:
            entries = [(one, archive.read(one)) for one in archive.infolist()]
        out = folder / "made.fmu"
        with zipfile.ZipFile(out, "w") as archive:
            for info, content in entries:
                own = info.filename == "modelDescription.xml"
                archive.writestr(info, mutations.xml_changed(random, content) if own else content)
        return out.read_bytes()

    return changed


@pytest.fixture(scope="module")
def sorts(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Sort]:
    """All sorts of input."""
    folder = tmp_path_factory.mktemp("seeds")
    fmus = [foreign.bounce(folder / f"{version}.fmu", version).read_bytes() for version in (1, 2, 3)]
    fmus += [
        foreign.arrays(folder / "arrays.fmu").read_bytes(),
        foreign.flexible(folder / "f.fmu").read_bytes(),
    ]
    config = bundled.find_system("docking-1d")
    assert config is not None
    made = folder / "system.ssp"
    (folder / "effects.yaml").write_text(EFFECTS)
    assert main(["export", "docking-1d-uncompensated", "-o", str(made)]) == 0

    def archive(random: Random, data: bytes) -> bytes:
        return mutations.archive_changed(random, data, str(folder / "outside.txt"), _inside)

    log = folder / "log.csv"
    times = [0.004 * n for n in range(300)]
    rows = (f"{t:.3f},{20 * t:.6f},{min(0.0, 176 * (5 - 20 * t)):.3f}" for t in times)
    log.write_text("t [s],x [mm],f [N]\n" + "\n".join(rows) + "\n")
    study = PORTS.replace("LOG", str(log)).encode()
    # Of few candidates, since clocks are weighed against all of them.
    few = PORTS.replace("without: [robot.*.quantise]", "only: [contact.force.gain, robot.command.delay]")
    of_case = few.replace("LOG", "input.csv.gz").encode()
    configs = [config.read_bytes(), EFFECTS.encode()]
    whole = yaml.safe_load(bundled.find_system("docking-1d-uncompensated").read_text())
    configs.append(yaml.safe_dump(whole).encode())
    return {
        "config": Sort(".yaml", configs, mutations.yaml_changed, [["check", "{}", "--json"]]),
        "sweep": Sort(".yaml", [STUDY.encode()], mutations.yaml_changed, [["sweep", "{}", "--check"]]),
        "diagnosis": Sort(".yaml", [study], mutations.yaml_changed, [["diagnose", "{}", "--quiet"]]),
        "description": Sort(
            ".fmu", fmus, _description(fmus[0], folder), [["check", "{}"], ["fmu", "inspect", "{}"]]
        ),
        "fmu": Sort(".fmu", fmus, archive, [["check", "{}"], ["fmu", "inspect", "{}", "--json"]]),
        "ssp": Sort(
            ".ssp", [made.read_bytes()], archive,
            [["check", "{}"], ["import", "{}", "-o", "made.yaml", "--overwrite"]],
        ),
        "log": Sort(
            ".csv.gz", [gzip.compress(log.read_bytes(), mtime=0)], mutations.packed_changed,
            [["diagnose", "study.yaml", "--quiet"]], {"study.yaml": of_case},
        ),
        "modelica": Sort(
            ".mo", [MODELICA.encode()], mutations.text_changed,
            [["build", "{}", "-o", "made.fmu", "--platforms", "none"]],
        ),
    }  # fmt: skip


class Worker:
    """A process that runs commands; begun anew where one ends it."""

    def __init__(self, room: Path) -> None:
        self.room = room
        self._process: subprocess.Popen[str] | None = None

    def run(self, arguments: list[str], folder: Path) -> dict[str, Any]:
        """What became of a command: see worker.py."""
        output = folder / "output.txt"
        if self._process is None:
            cache = self.room / "cache"
            cache.mkdir(exist_ok=True)
            temporary = self.room / "temporary"
            temporary.mkdir(exist_ok=True)
            environment = os.environ | {"NUMBA_CACHE_DIR": str(cache), "TMPDIR": str(temporary)}
            self._process = subprocess.Popen(
                [sys.executable, "-m", "tests.fuzz.worker", str(self.room)],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT, env=environment,
            )  # fmt: skip
        process = self._process
        assert process.stdin is not None and process.stdout is not None
        order = {"arguments": arguments, "folder": str(folder), "output": str(output), "stop": STOP}
        process.stdin.write(json.dumps(order) + "\n")
        process.stdin.flush()
        line = process.stdout.readline()
        reported = output.read_text(errors="replace") if output.exists() else ""
        if not line:
            self._process = None
            return {"status": f"ended by {process.wait()}", "output": reported}
        return {**json.loads(line), "output": reported}

    def close(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()


def _faults(found: dict[str, Any]) -> list[str]:
    """What a command may not do."""
    wrong = [] if found["status"] in (0, 1, 2) else [f"status {found['status']}"]
    if "Traceback (most recent call last)" in found["output"]:
        wrong.append("a traceback")
    if found.get("written"):
        wrong.append(f"written outside: {found['written']}")
    if found.get("seconds", 0.0) > MOST_SECONDS:
        wrong.append(f"{found['seconds']:.0f} s of processor time")
    if found.get("memory", 0) > MOST_MEMORY:
        wrong.append(f"{found['memory'] >> 20} MiB of memory")
    return wrong


@pytest.mark.parametrize(
    "name", ["config", "sweep", "diagnosis", "description", "fmu", "ssp", "log", "modelica"]
)
def test_commands_refuse_or_take_whatever_they_are_given(name, sorts, tmp_path):
    sort, worker = sorts[name], Worker(tmp_path)
    codes: dict[Any, int] = {}
    faults: list[str] = []
    try:
        for data in sort.seeds:
            for command in sort.commands:
                found = _tried(worker, tmp_path / "seed", sort, data, command)
                assert not _faults(found), found
                assert found["status"] == 0, found["output"]
        for number in range(COUNT):
            random = Random(f"{name} {SEED + number}")
            data = sort.changed(random, random.choice(sort.seeds))
            for command in sort.commands:
                folder = tmp_path / f"{SEED + number}"
                found = _tried(worker, folder, sort, data, command)
                codes[found["status"]] = codes.get(found["status"], 0) + 1
                if wrong := _faults(found):
                    last = found["output"].strip().splitlines()[-6:]
                    faults.append(
                        f"{name}, seed {SEED + number}, {command[0]}: {'; '.join(wrong)}; {folder}\n  "
                        + "\n  ".join(last)
                    )
    finally:
        worker.close()
    print(f"{name}: {COUNT} inputs, commands by exit code: {dict(sorted(codes.items(), key=str))}")
    assert not faults, f"{len(faults)} faults\n" + "\n".join(faults[:20])
    refused = codes.get(2, 0) + codes.get(1, 0)
    if COUNT >= 30:  # inputs are neither all broken nor all as they were
        assert refused > 0 and codes.get(0, 0) > 0 and sum(codes.values()) == COUNT * len(sort.commands)
    assert not (tmp_path.parent / "escaped.txt").exists()


def _tried(worker: Worker, folder: Path, sort: Sort, data: bytes, command: list[str]) -> dict[str, Any]:
    folder.mkdir(exist_ok=True)
    path = folder / f"input{sort.suffix}"
    path.write_bytes(data)
    for other, content in sort.beside.items():
        (folder / other).write_bytes(content)
    found = worker.run([one.replace("{}", str(path)) for one in command], folder)
    if not _faults(found):
        for one in folder.iterdir():
            if one.is_file():
                one.unlink()
    return found
