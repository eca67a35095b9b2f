"""Python models loaded in-process, and their FMUs driven by fmpy alone."""

from __future__ import annotations

import functools
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import fmpy
import pytest
from fmpy import calloc, free
from fmpy.fmi2 import (
    FMU2Slave,
    fmi2CallbackAllocateMemoryTYPE,
    fmi2CallbackFreeMemoryTYPE,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
)

from orchestrator.translate.shared_source import assembled

FMUS = Path(__file__).parents[2] / "fmus"


@functools.cache
def load_model(name: str) -> ModuleType:
    """fmus/<name>/model.py with what it shares, as a module of its own: all files are called model."""
    module = ModuleType(f"model_{name}")
    sys.modules[module.__name__] = module
    text = assembled(FMUS / name / "model.py")
    exec(compile(text, f"<{name}>", "exec", dont_inherit=True), vars(module))
    return module


@pytest.fixture(scope="session")
def controller_model() -> ModuleType:
    return load_model("ComplianceController")


@pytest.fixture(scope="session")
def wrench_model() -> ModuleType:
    return load_model("WrenchController")


@pytest.fixture(scope="session")
def satellite_model() -> ModuleType:
    return load_model("SatelliteDynamics")


class Instance:
    """One instance of an FMU, by variable names; `log` holds (status, message)."""

    def __init__(self, description: Any, folder: str, name: str, log: list | None = None) -> None:
        self.log: list[tuple[int, str]] = [] if log is None else log
        self.variables = {variable.name: variable for variable in description.modelVariables}
        callbacks = fmi2CallbackFunctions()
        callbacks.logger = fmi2CallbackLoggerTYPE(
            lambda _, name, status, category, message: self.log.append((status, message.decode()))
        )
        callbacks.allocateMemory = fmi2CallbackAllocateMemoryTYPE(calloc)
        callbacks.freeMemory = fmi2CallbackFreeMemoryTYPE(free)
        self.fmu = FMU2Slave(
            guid=description.guid,
            unzipDirectory=folder,
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName=name,
        )
        self.fmu.instantiate(callbacks=callbacks, loggingOn=True)

    def initialise(self, start_time: float = 0.0, **start: Any) -> Instance:
        self.set(**start)
        self.fmu.setupExperiment(startTime=start_time)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()
        return self

    def set(self, **values: Any) -> None:
        for name, value in values.items():
            variable = self.variables[name]
            kind = "Integer" if variable.type == "Enumeration" else variable.type
            getattr(self.fmu, f"set{kind}")([variable.valueReference], [value])

    def get(self, *names: str) -> tuple[Any, ...]:
        values = []
        for name in names:
            variable = self.variables[name]
            kind = "Integer" if variable.type == "Enumeration" else variable.type
            values.append(getattr(self.fmu, f"get{kind}")([variable.valueReference])[0])
        return tuple(values)

    def get_all(self) -> dict[str, Any]:
        return dict(zip(self.variables, self.get(*self.variables), strict=True))


@pytest.fixture
def instantiate(tmp_path: Path) -> Iterator[Callable[..., Instance]]:
    """Make instances of a shipped FMU by name and form ("" or "-native"); freed when the test ends."""
    made: list[Instance] = []
    unpacked: dict[str, tuple[Any, str]] = {}

    def make(name: str, form: str = "") -> Instance:
        file = f"{name}{form}"
        if file not in unpacked:
            path = FMUS / name / f"{file}.fmu"
            folder = fmpy.extract(str(path), unzipdir=str(tmp_path / file))
            unpacked[file] = fmpy.read_model_description(str(path)), folder
        made.append(Instance(*unpacked[file], name=f"{name}_{len(made)}"))
        return made[-1]

    yield make
    for instance in made:
        instance.fmu.freeInstance()
    for _, folder in unpacked.values():
        shutil.rmtree(folder, ignore_errors=True)
