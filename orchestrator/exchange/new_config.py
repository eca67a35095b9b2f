"""A config to start from, made of FMUs: instances, their ports as comments, and plain connections."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import yaml

from ..base.errors import ConfigError, FmuError, Problem
from ..base.units import ONE
from ..config.text import flow
from ..fmi import Causality, Interface, ModelDescription, Variable, load_fmu
from ..fmi.bundled import find_fmu
from .single_fmu import instance_name, times_of, written

_WIDTH = 110


class _Member(NamedTuple):
    name: str
    path: Path
    description: ModelDescription


def starting_config(paths: Sequence[Path], output: Path) -> str:
    """The text of a config of FMUs.

    A connection stands where name, type and unit of an output fit an input, and those of no other output do.
    Where type and unit alone fit in one way, it stands as a comment.

    Args:
        paths: of the FMUs, or names of bundled ones; one that is named twice makes two instances.
        output: the file that the text is for; it names the FMUs relative to its folder.
    Raises: ConfigError with all files that are no FMUs.
    """
    members: list[_Member] = []
    problems = []
    for path in paths:
        try:
            description = load_fmu(_file(path)).description
        except FmuError as error:
            problems.append(Problem("", " ".join(str(error).split())))
            continue
        name = instance_name(description.name or path.stem, (one.name for one in members))
        members.append(_Member(name, path, description))
    if problems:
        raise ConfigError(problems)
    times = times_of([one.description for one in members])
    lines = ["# Check it: orchestrator check " + output.name, f"# Times: {'; '.join(times.notes)}."]
    lines.append(f"run: {flow({'master': 'gauss-seidel'} | written(times))}")
    lines.append("instances:")
    for one in members:
        lines += _instance(one, output)
    sure, perhaps = _connections(members)
    lines.append("connections:" if sure else "connections: []")
    lines += [f"  - {one}" for one in sure]
    if perhaps:
        lines.append("  # Type and unit fit, the names differ:")
        lines += [f"  # - {one}" for one in perhaps]
    return "\n".join(lines) + "\n"


def _file(path: Path) -> Path:
    """The FMU's file, which for the name of a bundled one is elsewhere."""
    return path if path.is_file() else find_fmu(str(path)) or path


def _instance(member: _Member, output: Path) -> list[str]:
    description = member.description
    kind = "model exchange" if description.interface is Interface.MODEL_EXCHANGE else "co-simulation"
    own = member.path == _file(member.path)
    file = Path(os.path.relpath(member.path, output.parent)).as_posix() if own else str(member.path)
    text = yaml.safe_dump(file, default_flow_style=True, width=10_000).partition("\n")[0]
    lines = [f"  {member.name}:", f"    fmu: {text}  # FMI {description.fmi_version}, {kind}"]
    for title, causality in (("inputs", Causality.INPUT), ("outputs", Causality.OUTPUT)):
        ports = [one for one in description.variables.values() if one.causality is causality]
        lines += [f"    # {title}:"] if ports else []
        lines += [f"    #   {_port_text(one)}"[:_WIDTH] for one in ports]
    own = [one for one in description.variables.values() if one.causality is Causality.PARAMETER]
    given = {one.name: one.written(one.start) for one in own if one.start is not None}
    if given:
        lines.append("    # parameters and their values; set under `start:` what is to differ:")
        lines += [f"    #   {' '.join(flow({name: value})[1:-1].split())}" for name, value in given.items()]
    return lines


def _port_text(variable: Variable) -> str:
    unit = f" [{variable.unit_name}]" if variable.unit_name else ""
    start = "" if variable.start is None else f", start {variable.start!r}"
    more = f": {' '.join(variable.description.split())}" if variable.description else ""
    return f"{variable.name}{unit}, {variable.kind}{start}{more}"


def _connections(members: Sequence[_Member]) -> tuple[list[str], list[str]]:
    """Connections that leave no doubt, and those whose type and unit fit in one way only."""
    outputs = [(one.name, port) for one in members for port in one.description.outputs]
    inputs = [(one.name, port) for one in members for port in one.description.inputs]
    sure: dict[str, str] = {}
    taken: set[str] = set()
    for name, port in inputs:
        fitting = [
            (other, source)
            for other, source in outputs
            if other != name and source.name.casefold() == port.name.casefold() and _fits(source, port)
        ]
        if len(fitting) == 1:
            source = f"{fitting[0][0]}.{fitting[0][1].name}"
            sure[f"{name}.{port.name}"] = source
            taken.add(source)
    perhaps: dict[str, str] = {}
    for name, port in inputs:
        target = f"{name}.{port.name}"
        if target in sure or port.unit in (None, ONE):
            continue
        fitting = [
            f"{other}.{source.name}"
            for other, source in outputs
            if other != name and _fits(source, port) and f"{other}.{source.name}" not in taken
        ]
        if len(fitting) == 1:
            perhaps[target] = fitting[0]
    return _lines(sure), _lines(perhaps)


def _fits(source: Variable, target: Variable) -> bool:
    if source.kind is not target.kind or bool(source.shape) != bool(target.shape):
        return False
    if source.unit is None or target.unit is None:
        return source.unit is target.unit
    return source.unit.same_dimension(target.unit)


def _lines(found: dict[str, str]) -> list[str]:
    return [f"{source} -> {target}" for target, source in found.items()]
