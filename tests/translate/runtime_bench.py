"""Hand-written models on the C runtime: compiled once per process, driven by fmpy."""

from __future__ import annotations

import re
import shutil
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Slave, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE
from fmpy.fmi3 import FMU3Slave

from orchestrator.base.temporary_folders import scratch_folder
from orchestrator.translate.package import binary_member, compile_library, runtime_sources

MODELS = Path(__file__).parent / "models"
PLATFORM = "x86_64-linux"

needs_compiler = pytest.mark.skipif(find_spec("ziglang") is None, reason="needs ziglang (the build extra)")


def write_sources(folder: Path, model: str, version: str) -> Path:
    """Put the runtime, the FMI headers and a hand-written model into a folder."""
    folder.mkdir(parents=True)
    for name, content in runtime_sources(version).items():
        (folder / name).write_bytes(content)
    shutil.copyfile(MODELS / "defaults.h", folder / "defaults.h")
    shutil.copyfile(MODELS / f"{model}.c", folder / "model.c")
    return folder


@cache
def unpacked(model: str, version: str = "2.0") -> Path:
    """Folder laid out like an unpacked FMU with the model's library for this platform."""
    root = scratch_folder(f"{model}-")
    sources = write_sources(root / "sources", model, version)
    library = root / binary_member(PLATFORM, model, version)
    library.parent.mkdir(parents=True)
    library.write_bytes(compile_library(sources, model, version, [PLATFORM])[PLATFORM])
    return root


@cache
def references(model: str) -> dict[str, int]:
    """Name -> value reference, the order of the model's table."""
    names = re.findall(r'^    \{"([^"]+)", KIND_', (MODELS / f"{model}.c").read_text(), re.MULTILINE)
    return {name: number for number, name in enumerate(names)}


class Instance:
    """An instance with variables by name, its time, and what it logged as (status, category, text)."""

    def __init__(self, model: str, version: str = "2.0", logging: bool = False) -> None:
        self.references = references(model)
        self.second = version == "2.0"
        self.time = 0.0
        self.messages: list[tuple[int, str, str]] = []
        kind = FMU2Slave if self.second else FMU3Slave
        self.fmu: Any = kind(
            guid=f"{{{model}}}",
            unzipDirectory=str(unpacked(model, version)),
            modelIdentifier=model,
            instanceName=model,
        )
        self.instantiate(loggingOn=logging)

    def instantiate(self, **options: Any) -> None:
        if self.second:
            self.callbacks = fmi2CallbackFunctions()
            self.callbacks.logger = fmi2CallbackLoggerTYPE(
                lambda environment, name, *message: self._log(*message[:3])
            )
            self.fmu.instantiate(callbacks=self.callbacks, **options)
        else:
            self.fmu.instantiate(logMessage=lambda environment, *message: self._log(*message[:3]), **options)

    def _log(self, status: int, category: bytes, text: bytes) -> None:
        self.messages.append((status, category.decode(), text.decode()))

    @property
    def texts(self) -> list[str]:
        return [text for _, _, text in self.messages]

    def enter(
        self, start: float = 0.0, stop: float | None = None, tolerance: float | None = None
    ) -> Instance:
        self.time = start
        if self.second:
            self.fmu.setupExperiment(tolerance=tolerance, startTime=start, stopTime=stop)
            self.fmu.enterInitializationMode()
        else:
            self.fmu.enterInitializationMode(tolerance=tolerance, startTime=start, stopTime=stop)
        return self

    def initialise(self, start: float = 0.0, stop: float | None = None, **values: float) -> Instance:
        self.set(**values)
        self.enter(start, stop)
        self.fmu.exitInitializationMode()
        return self

    def set(self, **values: float) -> None:
        setter = self.fmu.setReal if self.second else self.fmu.setFloat64
        for name, value in values.items():
            setter([self.references[name]], [value])

    def get(self, name: str) -> float:
        getter = self.fmu.getReal if self.second else self.fmu.getFloat64
        return getter([self.references[name]])[0]

    def step(self, size: float) -> None:
        self.fmu.doStep(currentCommunicationPoint=self.time, communicationStepSize=size)
        self.time += size

    def fails(self, call: str, *arguments: Any) -> str:
        """Call what has to be refused; return the one message it logged."""
        before = len(self.messages)
        function = getattr(self, call, None) or getattr(self.fmu, call)
        with pytest.raises(FMICallException):
            function(*arguments)
        assert len(self.messages) == before + 1
        return self.messages[-1][2]

    def save(self) -> Any:
        return self.fmu.getFMUState()

    def restore(self, state: Any, time: float) -> None:
        self.fmu.setFMUState(state)
        self.time = time

    def serialise(self, state: Any) -> bytes:
        return self.fmu.serializeFMUstate(state) if self.second else self.fmu.serializeFMUState(state)

    def deserialise(self, data: bytes) -> Any:
        return self.fmu.deSerializeFMUstate(data) if self.second else self.fmu.deserializeFMUState(data)

    def derivative(self, unknown: str, known: str) -> float:
        places = [self.references[unknown]], [self.references[known]]
        if self.second:
            return self.fmu.getDirectionalDerivative(*places, [1.0])[0]
        return self.fmu.getDirectionalDerivative(*places, [1.0], 1)[0]
