"""What is inside a system that becomes one FMU: ports, FMUs and their platforms, and what keeps it out."""

from __future__ import annotations

import struct
import zipfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ..base.errors import ConfigError, Problem, listed, nearest
from ..config import Config, Places, load_config
from ..effects import Effect
from ..effects.choose import BUILT_IN, built_in
from ..fmi import Causality, Interface, Kind, Value, Variability, Variable, bundled
from ..fmi.loading import CompiledFmu
from ..master.gauss_seidel import GaussSeidel
from ..master.jacobi import Jacobi
from ..simulation.run import Prepared, prepare
from ..system import checks
from ..system.connection import Port
from ..system.signal_vector import Layout
from ..system.system import Instance, System

_PLATFORMS2 = {"linux64": ("x86_64-linux",), "win64": ("x86_64-windows",)}
_PLATFORMS3 = ("x86_64-linux", "x86_64-windows", "x86_64-darwin", "aarch64-darwin")
_MACS = {0x01000007: "x86_64-darwin", 0x0100000C: "aarch64-darwin"}
# What the FMUs' integers are made of; larger ones do not fit an Integer of the exported FMU.
_SMALL = ("Integer", "Enumeration", "Int8", "UInt8", "Int16", "UInt16", "Int32")
_PYTHON = "PythonFMU"
EFFECTS = (
    "gain", "offset", "delay", "low-pass", "sample-and-hold", "saturate", "quantise", "rate-limit",
    "dead-band", "backlash", "noise", "drift", "dropout", "jitter", "map", "relay",
)  # fmt: skip
"""Those that runtime/coupled/effects.c has, by their numbers there."""


@dataclass(frozen=True)
class Outer:
    """A variable of the exported FMU.

    Attributes:
        port: the variable of an instance that it is.
        variable: as that instance's FMU declares it.
        causality: there: input, output or parameter.
        start: start value; None for outputs.
    """

    port: Port
    variable: Variable
    causality: Causality
    start: Value | None = None

    @property
    def type(self) -> str:
        """FMI 2 type: "Real", "Integer" or "Boolean"."""
        kind = self.variable.kind
        return "Real" if kind is Kind.REAL else "Boolean" if kind is Kind.BOOLEAN else "Integer"


@dataclass(frozen=True)
class Inside:
    """A system that can become one FMU.

    Attributes:
        prepared: the config, in native forms, its master and grid.
        system, layout: with the chosen outputs recorded, and nothing else.
        order, late: schedule of the master.
        inputs, outputs, parameters: of the exported FMU.
        fmus: files of the FMUs, each once.
        platforms: for which all FMUs have binaries, keys of translate.package.PLATFORMS.
        notes: what the user should know.
    """

    prepared: Prepared
    system: System
    layout: Layout
    order: tuple[int, ...]
    late: bool
    inputs: tuple[Outer, ...]
    outputs: tuple[Outer, ...]
    parameters: tuple[Outer, ...]
    fmus: tuple[Path, ...]
    platforms: tuple[str, ...]
    notes: tuple[str, ...]


def effect_number(effect: Effect) -> int | None:
    """The number of an effect in `EFFECTS`; None if it is none of them."""
    kinds = {built_in(name): number for number, name in enumerate(EFFECTS) if name in BUILT_IN}
    return kinds.get(type(effect))


def native_config(config: Config) -> Config:
    """The config with the native form of every bundled FMU that has one and whose form is not said."""
    changes = []
    for name, instance in config.model.instances.items():
        own = (config.folder / instance.fmu).is_file()
        if instance.form is None and not own and "native" in bundled.fmu_forms(instance.fmu):
            changes.append(f"instances.{name}.form=native")
    return load_config(config, changes)


def look_inside(
    config: Config, ports: Sequence[str] | None = None, inputs: Sequence[str] | None = None
) -> Inside:
    """Check that a config can become one FMU.

    Args:
        config: with native forms, see `native_config`.
        ports: its outputs, as instance.variable; None: every numeric output of every instance.
        inputs: its inputs among those that nothing feeds; None: all of these.
    Raises: ConfigError with all problems.
    """
    prepared = prepare(config)
    system, places = prepared.system, prepared.config.places
    problems: list[Problem] = []
    notes: list[str] = []
    schedule = _schedule(prepared, problems)
    for one in system.instances:
        problems += _unfit(one, places)
    for connection in system.connections:
        if system.variable(connection.target).carried:
            what = f"{connection} carries no number"
            problems.append(Problem(places.text(("connections",)), what, "only numbers are passed on inside"))
        for link in connection.wire.links if connection.wire else ():
            if effect_number(link.effect) is None:
                what = f"effect {link.name} on {connection} is Python code"
                allowed = (
                    f"these work inside an FMU: {listed([name for name in EFFECTS if name in BUILT_IN])}"
                )
                problems.append(Problem(places.text(("connections",)), what, allowed))
    chosen_inputs = _inputs(system, inputs, problems, notes)
    outputs = _outputs(system, ports, problems, notes)
    if problems or schedule is None:
        raise ConfigError(problems)
    recorded = tuple(one.port for one in outputs)
    system = replace(system, recorded=recorded, bonds=())
    order, late = schedule
    fmus = tuple(dict.fromkeys(Path(one.fmu.path) for one in system.instances if one.fmu.path))
    platforms = _common(system, fmus, problems, notes)
    if problems:
        raise ConfigError(problems)
    return Inside(
        prepared=prepared,
        system=system,
        layout=Layout.of(system),
        order=order,
        late=late,
        inputs=chosen_inputs,
        outputs=outputs,
        parameters=tuple(_parameters(system)),
        fmus=fmus,
        platforms=platforms,
        notes=tuple(notes),
    )


def _schedule(prepared: Prepared, problems: list[Problem]) -> tuple[tuple[int, ...], bool] | None:
    """Order of stepping, and whether inputs are fed right before each step."""
    master, system = prepared.master, prepared.system
    place = prepared.config.places.text(("run", "master"))
    allowed = "jacobi and gauss-seidel run inside an FMU, with inputs held over a step"
    if getattr(master, "extrapolation", 0):
        what = f"extrapolation {getattr(master, 'extrapolation', 0)} cannot become part of an FMU"
        problems.append(Problem(place, what, allowed, "Set run.master.extrapolation to 0."))
    elif type(master) is Jacobi:
        return tuple(range(len(system.instances))), False
    elif type(master) is GaussSeidel:
        return system.order, True
    else:
        what = f"the master {prepared.config.model.run.master_name} cannot become part of an FMU"
        problems.append(Problem(place, what, allowed, "Set run.master to gauss-seidel."))
    return None


def _unfit(one: Instance, places: Places) -> list[Problem]:
    """Why an instance cannot be part of an FMU."""
    description = one.fmu.description
    what = f"{one.name} ({description.name}) cannot become part of an FMU"
    place = places.text(("instances", one.name))
    if description.tool.startswith(_PYTHON):
        remedy = "Take its native form: orchestrator build MODEL.py --form native."
        return [Problem(place, what, "it is Python code, which would not run in other tools", remedy)]
    if description.fmi_version.startswith("1"):
        return [Problem(place, what, f"it is of FMI {description.fmi_version}; 2.0 and 3.0 can")]
    if description.interface is not Interface.CO_SIMULATION:
        return [Problem(place, what, "it runs as model exchange; co-simulation can")]
    run_options = one.fmu.run_options if isinstance(one.fmu, CompiledFmu) else None
    if run_options is None:
        return [Problem(place, what, "it is no FMU of a file, but lives outside of the run")]
    if run_options.event_mode:
        remedy = f"Leave instances.{one.name}.event_mode out."
        return [Problem(place, what, "it runs with event_mode, which the inner master does not have", remedy)]
    if run_options.tolerance is not None:
        remedy = f"Leave instances.{one.name}.tolerance out."
        return [Problem(place, what, "it needs a tolerance, which the inner master does not pass on", remedy)]
    return []


def _inputs(
    system: System, chosen: Sequence[str] | None, problems: list[Problem], notes: list[str]
) -> tuple[Outer, ...]:
    """Inputs that nothing feeds, or those of them that are chosen."""
    fed = {connection.target: str(connection) for connection in system.connections}
    free: dict[str, Outer] = {}
    for one in system.instances:
        for variable in one.fmu.description.inputs:
            port = Port(one.name, variable.name)
            if port in fed or variable.shape or not variable.kind.numeric or not variable.settable:
                continue
            if variable.kind is Kind.INTEGER and variable.type not in _SMALL:
                notes.append(f"input {port} ({variable.type}) keeps its start value: too large for Integer")
                continue
            start = one.start.get(variable.name, variable.start)
            free[str(port)] = Outer(port, variable, Causality.INPUT, 0 if start is None else start)
    if chosen is None:
        return tuple(free.values())
    for name in chosen:
        if name in free:
            continue
        what = f"{name!r} cannot be an input of the FMU"
        why = [text for port, text in fed.items() if str(port) == name]
        allowed = f"{why[0]} feeds it" if why else f"inputs that nothing feeds: {listed(free)}"
        problems.append(Problem("--inputs", what, allowed, "" if why else nearest(name, list(free))))
    return tuple(free[name] for name in dict.fromkeys(chosen) if name in free)


def _outputs(
    system: System, chosen: Sequence[str] | None, problems: list[Problem], notes: list[str]
) -> tuple[Outer, ...]:
    descriptions = {one.name: one.fmu.description for one in system.instances}
    outputs = []
    if chosen is None:
        for one in system.instances:
            for variable in one.fmu.description.outputs:
                port = Port(one.name, variable.name)
                if not variable.kind.numeric or variable.shape:
                    notes.append(f"output {port} ({variable.type}) is left out: no number")
                elif variable.kind is Kind.INTEGER and variable.type not in _SMALL:
                    notes.append(f"output {port} ({variable.type}) is left out: too large for Integer")
                else:
                    outputs.append(Outer(port, variable, Causality.OUTPUT))
        return tuple(outputs)
    for name in dict.fromkeys(chosen):
        port = Port.of(name)
        problem = checks.recordable(port.instance, port.variable, descriptions, "--ports")
        if problem is not None:
            problems.append(problem)
            continue
        variable = system.variable(port)
        if variable.kind is Kind.INTEGER and variable.type not in _SMALL:
            what = f"{port} cannot be an output of the FMU"
            problems.append(Problem("--ports", what, f"it is of type {variable.type}, larger than Int32"))
            continue
        outputs.append(Outer(port, variable, Causality.OUTPUT))
    return tuple(outputs)


def _parameters(system: System) -> Iterable[Outer]:
    for one in system.instances:
        for variable in one.fmu.description.parameters:
            start = one.start.get(variable.name, variable.start)
            small = variable.kind is not Kind.INTEGER or variable.type in _SMALL
            plain = variable.elements == 1 and not variable.shape and variable.kind.numeric and small
            if (
                plain
                and start is not None
                and variable.variability in (Variability.FIXED, Variability.TUNABLE)
            ):
                yield Outer(Port(one.name, variable.name), variable, Causality.PARAMETER, start)


def platforms_of(path: Path, fmi_version: str) -> tuple[str, ...]:
    """Platforms that an FMU has binaries for, as keys of translate.package.PLATFORMS."""
    found: dict[str, None] = {}
    with zipfile.ZipFile(path) as archive:
        for name in archive.namelist():
            parts = name.split("/")
            if len(parts) != 3 or parts[0] != "binaries" or not parts[2]:
                continue
            if fmi_version.startswith("3"):
                found |= dict.fromkeys(one for one in _PLATFORMS3 if one == parts[1])
            elif parts[1] == "darwin64" and parts[2].endswith(".dylib"):
                with archive.open(name) as file:
                    found |= dict.fromkeys(_processors(file.read(4096)))
            else:
                found |= dict.fromkeys(_PLATFORMS2.get(parts[1], ()))
    return tuple(one for one in _PLATFORMS3 if one in found)


def _processors(head: bytes) -> list[str]:
    """What kinds of Mac a Mach-O library is for (layout: Apple's mach-o/fat.h and loader.h)."""
    if head[:4] == b"\xca\xfe\xba\xbe":
        (count,) = struct.unpack(">I", head[4:8])
        kinds = [struct.unpack(">I", head[8 + 20 * n : 12 + 20 * n])[0] for n in range(min(count, 16))]
    else:
        kinds = [struct.unpack("<I", head[4:8])[0]] if len(head) >= 8 else []
    return [_MACS[kind] for kind in kinds if kind in _MACS]


def _common(
    system: System, fmus: Sequence[Path], problems: list[Problem], notes: list[str]
) -> tuple[str, ...]:
    """Platforms that all FMUs have binaries for; says which FMU has none for others."""
    versions = {one.fmu.path: one.fmu.description.fmi_version for one in system.instances}
    have = {path: platforms_of(path, versions[path]) for path in fmus}
    common = tuple(one for one in _PLATFORMS3 if all(one in found for found in have.values()))
    for missing in (one for one in _PLATFORMS3 if one not in common):
        without = [path.name for path, found in have.items() if missing not in found]
        notes.append(f"not for {missing}, for which these have no binary: {listed(without)}")
    if not common:
        held = [f"{path.name}: {listed(found) if found else 'none'}" for path, found in have.items()]
        problems.append(
            Problem("instances", "there is no platform for which all FMUs have a binary", "; ".join(held))
        )
    return common
