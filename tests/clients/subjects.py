"""What the clients are given: every shipped FMU, driven by sines, and whole systems."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import yaml

from orchestrator.exchange.ssp.write import write_ssp
from orchestrator.exchange.system_fmu import export_system_fmu
from orchestrator.fmi import bundled, load_fmu
from orchestrator.results.recorders import Results
from orchestrator.simulation.run import prepare, run
from orchestrator.translate.build import build

from .job import Job, Part, job_of

__all__ = ["GROUPS", "SYSTEMS", "WHOLE", "bench", "groups", "packages", "shipped", "systems", "whole"]

HERE = Path(__file__).parent
STEPS = 60
# Amplitudes of the sines by unit; other inputs are held at their start values.
AMPLITUDES = {"m": 0.006, "m/s": 0.05, "N": 150.0, "N.m": 5.0, "rad": 0.05, "rad/s": 0.1}

# The contact starts compressed and pushes the rod off: for tools that give start values to parameters alone.
_RELEASED = ("contact.front=-1 mm", "contact.rear=-11 mm", "satellite.velocity=0 mm/s", "run.stop_time=0.2 s")
SYSTEMS: dict[str, tuple[str, tuple[str, ...]]] = {
    "docking-1d-uncompensated": ("docking-1d-uncompensated", ("run.stop_time=0.5 s",)),
    "docking-1d": ("docking-1d", ("run.stop_time=0.7 s",)),
    "docking-1d-uncompensated, released": ("docking-1d-uncompensated", _RELEASED),
    "docking-1d, released": ("docking-1d", _RELEASED),
}
# What is exported as one FMU: system, FMI version, stop time, outputs.
_SPACE = tuple(f"{name}[{axis}]" for name in ("contact.force", "satellites.position") for axis in (1, 2, 3))
_LINE = ("robot.position", "contact.force", "satellite.position", "satellite.velocity")
WHOLE: dict[str, tuple[str, str, str, tuple[str, ...]]] = {
    "docking-1d-uncompensated.fmu": ("docking-1d-uncompensated", "2.0", "0.7 s", _LINE),
    "docking-1d.fmu": ("docking-1d", "2.0", "0.7 s", _LINE),
    "docking-1d-fmi3.fmu": ("docking-1d", "3.0", "0.7 s", _LINE),
    "docking-6d.fmu": ("docking-6d", "2.0", "0.7 s", _SPACE),
    "docking-6d-fmi3.fmu": ("docking-6d", "3.0", "0.7 s", _SPACE),
    "docking-6d-arm.fmu": ("docking-6d-arm", "2.0", "0.7 s", _SPACE),
    "docking-lab.fmu": ("docking-lab", "2.0", "0.5 s", ("contact.force", "robot.position")),
    "emps.fmu": ("emps", "2.0", "2 s", ("drive.position", "drive.velocity")),
}


def bench(folder: Path) -> Path:
    """The FMU of Bench.mo."""
    path = folder / "Bench.fmu"
    build(HERE / "Bench.mo", path, platforms=["x86_64-linux"])
    return path


def shipped(source: Path, master: str = "jacobi") -> Iterator[tuple[Job, Results]]:
    """Every shipped FMU in all its forms, alone with what drives it."""
    for name in bundled.fmu_names():
        for form, path in (bundled.fmu_forms(name) or {"": bundled.find_fmu(name)}).items():
            reported = f"{name} ({form})" if form else name
            yield job_of(reported, _driven(path, source), master=master, watched="one", bench=source)


def _driven(path: Path, source: Path) -> dict[str, Any]:
    """A config: an FMU whose inputs follow sines about their start values."""
    description = load_fmu(path).description
    start: dict[str, float] = {f"u[{number}]": 0.0 for number in range(1, 65)}
    links = []
    for number, variable in enumerate(description.inputs, 1):
        start[f"offset[{number}]"] = float(variable.start or 0.0)
        start[f"amplitude[{number}]"] = AMPLITUDES.get(variable.unit_name or "", 0.0)
        links.append(f"source.y[{number}] -> one.{variable.name}")
    instances: dict[str, Any] = {"one": {"fmu": str(path)}}
    if links:
        instances["source"] = {"fmu": str(source), "start": start}
    return {
        "run": {"master": "jacobi", "step_size": "0.5 ms", "stop_time": f"{STEPS * 0.5:g} ms"},
        "instances": instances,
        "connections": links,
    }


def _system(name: str) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Config and overrides; FMUs that need no Python.

    No measures, which want a satellite that flies in, and no enumeration, which few tools can set.
    """
    system, overrides = SYSTEMS[name]
    config = yaml.safe_load(bundled.find_system(system).read_text(encoding="utf-8"))
    del config["measures"]
    if "controller" in config["instances"]:
        assert config["instances"]["controller"]["start"].pop("mode") == "active"  # the default
    forms = [f"{one}.form=native" for one in ("satellite", "controller") if one in config["instances"]]
    return config, (*overrides, *forms, "run.step_size=0.5 ms")


def systems(source: Path, master: str = "jacobi") -> Iterator[tuple[Job, Results]]:
    """Whole systems, FMU by FMU."""
    for name in SYSTEMS:
        yield job_of(name, *_system(name), master=master, bench=source)


def packages(folder: Path) -> Iterator[tuple[Job, Results]]:
    """The same as system structure packages."""
    for number, name in enumerate(SYSTEMS):
        path = folder / f"system{number}.ssp"
        config, overrides = _system(name)
        write_ssp(config, path, (*overrides, "run.master=jacobi"))
        yield job_of(f"{name} (SSP)", config, overrides, package=path)


def whole(folder: Path, source: Path) -> Iterator[tuple[Job, Results]]:
    """Systems as one FMU each, and what `run` makes of the same config, with its own master."""
    for name, (system, version, stop, ports) in WHOLE.items():
        path, overrides = folder / name, (f"run.stop_time={stop}",)
        if not path.exists():
            export_system_fmu(system, path, overrides=overrides, fmi_version=version, ports=ports, inputs=())
        prepared = prepare(system, (*overrides, "run.loop=python"))
        results = run(prepared, halving=False, figures=False).results
        steps, size = len(results) - 1, float(prepared.grid.step_size)
        watched = {f"one.{port}": port for port in ports}
        parts = (Part("one", str(path), {}),)
        job = Job(name, parts, (), size, steps, tuple(watched), bench=str(source))
        yield job, {there: results[here] for there, here in watched.items()}


GROUPS = (
    "FMUs made from Modelica, FMI 2.0",
    "FMUs made from Modelica, FMI 3.0",
    "FMUs made from Python, native form",
    "FMUs made from Python, Python form",
    "systems, FMU by FMU",
    "systems as SSP",
    "systems as one FMU",
)


def group(job: Job) -> str:
    """To which of the first four groups a shipped FMU belongs."""
    (one,) = [part for part in job.parts if part.name == "one"]
    if Path(one.path).with_name("model.py").exists():
        return GROUPS[2 if "(native)" in job.name else 3]
    return GROUPS[1 if one.path.endswith("-fmi3.fmu") else 0]


@cache
def groups(folder: Path, master: str) -> dict[str, list[tuple[Job, Results]]]:
    """All there is, with our results under a master; kept.

    Args:
        folder: for what is built.
    """
    source = folder / "Bench.fmu"
    if not source.exists():
        bench(folder)
    found: dict[str, list[tuple[Job, Results]]] = {name: [] for name in GROUPS}
    for one in shipped(source, master):
        found[group(one[0])].append(one)
    found[GROUPS[4]] = list(systems(source, master))
    found[GROUPS[5]] = list(packages(folder))
    found[GROUPS[6]] = list(whole(folder, source))
    return found
