"""A configured system as one co-simulation FMU: its FMUs, connections as data, and the same master inside.

The FMU carries the inner FMUs whole, under resources/, and one binary per platform that loads them; that one
is shipped, so that no compiler is needed. Its signals are those of `orchestrator run`, to the bit.
"""

from __future__ import annotations

import re
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path, PurePosixPath
from typing import Any, cast

from ..base.errors import BuildError, ConfigError, Problem
from ..base.text_tables import html_table
from ..config import Config, load_config
from ..simulation.run import prepare
from ..translate.coupled import binary
from ..translate.package import FmiVersion, binary_member, content_token, join_macs, write_fmu
from ..translate.presentation import dress
from .system_contents import Inside, look_inside, native_config
from .system_description import describe_system
from .system_text import system_text

_TOKEN = "{token}"
# Of an inner FMU; its sources, and what only shows it, stay behind.
_LEFT_OUT = ("sources", "extra", "terminalsAndIcons", "model.png")


@dataclass(frozen=True)
class SystemReport:
    """What was exported.

    Attributes:
        path: the FMU.
        fmi_version: "2.0" or "3.0".
        platforms: for which it holds binaries.
        inputs, outputs, parameters: names of its variables.
        step_size: its own step [s].
        notes: what the user should know, one sentence each.
    """

    path: Path
    fmi_version: str
    platforms: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    parameters: tuple[str, ...]
    step_size: float
    notes: tuple[str, ...]


def export_system_fmu(
    config: str | Path | Mapping[str, Any] | Config,
    output: Path,
    *,
    overrides: Sequence[str] = (),
    fmi_version: str = "2.0",
    ports: Sequence[str] | None = None,
    inputs: Sequence[str] | None = None,
) -> SystemReport:
    """Export a system as one FMU; the same config and FMUs give the same bytes.

    Args:
        config, overrides: see `load_config`. Bundled FMUs go in in their native form.
        output: the .fmu to write; replaced only when complete.
        fmi_version: of the exported FMU, "2.0" or "3.0"; its parts may be of either.
        ports: its outputs, as instance.variable; None: every numeric output of every instance.
        inputs: its inputs among those that nothing feeds; None: all of these. Others keep their start values.
    Returns: what was exported.
    Raises: ConfigError with all that keeps the system from becoming an FMU; BuildError for a wrong option.
    """
    output = Path(output)
    if fmi_version not in ("2.0", "3.0"):
        raise BuildError(f"FMI version {fmi_version!r} is not supported; choose 2.0 or 3.0")
    if not output.parent.is_dir():
        raise BuildError(f"{output}: the folder {output.parent} does not exist; create it first")
    try:
        loaded = native_config(load_config(config, overrides))
    except ConfigError:
        prepare(config, overrides)  # raises, with what else is wrong
        raise
    inside = look_inside(loaded, ports, inputs)
    name = loaded.name
    version = cast(FmiVersion, fmi_version)
    identifier = re.sub(r"\W", "_", name, flags=re.ASCII)
    if not identifier or identifier[0].isdigit():
        identifier = f"_{identifier}"
    members = _members(inside, loaded, name, identifier, version)
    write_fmu(output, members)
    return SystemReport(
        output,
        fmi_version,
        inside.platforms,
        tuple(str(one.port) for one in inside.inputs),
        tuple(str(one.port) for one in inside.outputs),
        tuple(str(one.port) for one in inside.parameters),
        float(inside.prepared.grid.step_size),
        inside.notes,
    )


def _members(
    inside: Inside, config: Config, name: str, identifier: str, version: FmiVersion
) -> dict[str, bytes]:
    folders = _folders(inside)
    members: dict[str, bytes] = {}
    for path, folder in zip(inside.fmus, folders, strict=True):
        members |= _inner(path, f"resources/{folder}")
    libraries = {platform: binary(platform, version) for platform in inside.platforms}
    if version == "2.0":
        libraries = join_macs(libraries)
    for platform, content in libraries.items():
        members[binary_member(platform, identifier, version)] = content
    members["extra/orchestrator/system.yaml"] = config.text().encode()
    parts = [part for key in sorted(members) for part in (key.encode(), members[key])]
    parts += [system_text(inside, name, _TOKEN, folders).encode()]
    parts += [describe_system(inside, name, identifier, _TOKEN, version)]
    token = content_token(parts)
    members["resources/system.txt"] = system_text(inside, name, token, folders).encode()
    xml = members["modelDescription.xml"] = describe_system(inside, name, identifier, token, version)
    fmus = {one.name: one.fmu.checksum() for one in inside.system.instances}
    return members | dress(xml, [("System", _system(inside))], {"fmus": fmus})


def _system(inside: Inside) -> str:
    """What the page says about the system: its instances, its connections, and how it is stepped."""
    system, run = inside.system, inside.prepared.config.model.run
    heads = ("instance", "model", "FMI", "description")
    fmus = ((one.name, one.fmu.description) for one in system.instances)
    rows = [(name, fmu.name, fmu.fmi_version, fmu.description) for name, fmu in fmus]
    connections = escape("\n".join(map(str, system.connections)))
    return (
        f"<p>The FMUs below are stepped together, by the master {run.master_name}, every {run.step_size}; "
        "communication steps are whole multiples of that. Connected inputs hold their values over a step, "
        "inputs of this FMU over a communication step. An importer's tolerance is not passed on.</p>\n"
        f"{html_table(rows, heads)}\n<pre>\n{connections}</pre>"
    )


def _folders(inside: Inside) -> list[str]:
    """Folders of the FMUs below resources/: their files' names, made distinct, whatever their case."""
    folders: list[str] = []
    for path in inside.fmus:
        name = re.sub(r"[^A-Za-z0-9_-]", "_", path.stem)
        number, found = 2, f"fmus/{name}"
        while found.casefold() in (one.casefold() for one in folders):
            found, number = f"fmus/{name}_{number}", number + 1
        folders.append(found)
    return folders


def _inner(path: Path, folder: str) -> dict[str, bytes]:
    """The files of an inner FMU, below `folder`."""
    members = {}
    with zipfile.ZipFile(path) as archive:
        for entry in archive.infolist():
            place = PurePosixPath(entry.filename.replace("\\", "/"))
            if entry.is_dir() or place.parts[0] in _LEFT_OUT:
                continue
            if place.is_absolute() or ".." in place.parts:
                what = f"{path}: refused, its entry {entry.filename!r} would be written elsewhere"
                raise ConfigError([Problem("instances", what)])
            members[f"{folder}/{place}"] = archive.read(entry)
    return members
