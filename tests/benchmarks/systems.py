"""The systems whose communication steps are timed, as FMUs and as a plain C program."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import fmpy

from orchestrator.fmi import load_fmu
from orchestrator.system.assembly import Part
from orchestrator.system.system import System
from orchestrator.translate.package import write_fmu
from tests.assembled import assemble

__all__ = ["CASES", "STEP_SIZE", "Case", "Plant", "build", "ring"]

HERE = Path(__file__).parent
STEP_SIZE = 1e-3  # [s]


@dataclass(frozen=True)
class Case:
    """Slaves of one FMU, each with as many inputs as outputs.

    Attributes:
        name: what it is.
        slaves, ports: how many, and inputs of each.
        lag: whether outputs follow their inputs as first-order lags instead of at once.
        sources: for each input of all slaves the output that feeds it, numbered likewise; -1: constant 1.
    """

    name: str
    slaves: int
    ports: int
    lag: bool
    sources: tuple[int, ...]

    @property
    def links(self) -> list[tuple[int, int, int, int]]:
        """Connections as slave and port of the source, slave and port of the target."""
        return [
            (*divmod(source, self.ports), *divmod(target, self.ports))
            for target, source in enumerate(self.sources)
            if source >= 0
        ]


def ring(slaves: int, ports: int) -> tuple[int, ...]:
    """Each slave is fed by the one before it, port by port, shifted by one so that all ports mix."""
    return tuple(
        (slave - 1) % slaves * ports + (port + 1) % ports for slave in range(slaves) for port in range(ports)
    )


CASES = (
    Case("(a) chain of 2 feed-through FMUs, 8 ports each", 2, 8, False, (-1,) * 8 + tuple(range(8))),
    Case("(b) closed loop of 4 FMUs, 4 ports each", 4, 4, True, ring(4, 4)),
)


@dataclass(frozen=True)
class Plant:
    """A case that is built.

    Attributes:
        fmu, library, program: the FMU, its library, and the C master.
    """

    case: Case
    fmu: Path
    library: Path
    program: Path

    @cached_property
    def system(self) -> System:
        """The system, everything recorded."""
        case = self.case
        fmu = load_fmu(self.fmu)
        fed = {(slave, port) for _, _, slave, port in case.links}
        parts = [
            Part(f"s{s}", fmu, {f"u{p}": 1.0 for p in range(case.ports) if (s, p) not in fed})
            for s in range(case.slaves)
        ]
        return assemble(parts, [f"s{a}.y{b} -> s{c}.u{d}" for a, b, c, d in case.links])


def build(case: Case, folder: Path) -> Plant:
    """Compile a case into a folder, with full optimisation."""
    library = folder / f"Lags{fmpy.sharedLibraryExtension}"
    flags = ["-shared", "-fPIC", f"-DPORTS={case.ports}", f"-DLAG={int(case.lag)}"]
    _compile([*flags, "-o", str(library), str(HERE / "lags.c")])
    program = folder / "master"
    _compile(["-o", str(program), str(HERE / "master.c"), "-ldl", "-lm"])
    members = {
        "modelDescription.xml": _description(case).encode(),
        f"binaries/{fmpy.platform}/{library.name}": library.read_bytes(),
    }
    fmu = folder / "Lags.fmu"
    write_fmu(fmu, members)
    return Plant(case, fmu, library, program)


def _compile(arguments: Sequence[str]) -> None:
    command = [sys.executable, "-m", "ziglang", "cc", "-O3", "-fno-sanitize=all", *arguments]
    subprocess.run(command, check=True, capture_output=True)


def _description(case: Case) -> str:
    n = case.ports
    variables = [
        f'<ScalarVariable name="u{i}" valueReference="{i}" causality="input"><Real start="1"/>'
        "</ScalarVariable>"
        for i in range(n)
    ] + [
        f'<ScalarVariable name="y{i}" valueReference="{n + i}" causality="output"><Real/></ScalarVariable>'
        for i in range(n)
    ]
    unknowns = [
        f'<Unknown index="{n + i + 1}" dependencies="{"" if case.lag else i + 1}"/>' for i in range(n)
    ]
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="Lags" guid="lags">
  <CoSimulation modelIdentifier="Lags" canHandleVariableCommunicationStepSize="true"/>
  <ModelVariables>{"".join(variables)}</ModelVariables>
  <ModelStructure>
    <Outputs>{"".join(unknowns)}</Outputs><InitialUnknowns>{"".join(unknowns)}</InitialUnknowns>
  </ModelStructure>
</fmiModelDescription>
"""
