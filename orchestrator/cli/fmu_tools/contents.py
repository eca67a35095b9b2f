"""What is in an FMU, without running any of it."""

from __future__ import annotations

import zipfile
import zlib
from collections import Counter
from collections.abc import Collection, Iterable
from dataclasses import asdict
from pathlib import Path, PurePosixPath
from typing import Any

from ...base.errors import FmuError
from ...fmi import Causality, Kind, ModelDescription, Variable, load_fmu
from ...fmi.archive import binary_folder, checked_members
from .binaries import Image, is_system_library, platform_names, read_images
from .functions import core_functions, exported_name, fmi_functions

_LIBRARIES = (".so", ".dll", ".dylib")
_SHOWN = (Causality.INPUT, Causality.OUTPUT, Causality.PARAMETER, Causality.CALCULATED_PARAMETER)


class Binary:
    """The library of one platform.

    Attributes:
        platform: folder under binaries/.
        file: path in the archive.
        images: empty where it is no object file, and `problem` says so.
        missing_core, missing: FMI functions that some image does not export: those without which it cannot
            be run, and the rest.
        beside: other files of that folder.
    """

    def __init__(
        self, file: str, data: bytes, description: ModelDescription, beside: tuple[str, ...]
    ) -> None:
        self.file = file
        self.platform = PurePosixPath(file).parts[1]
        self.size = len(data)
        self.beside = beside
        self.problem = ""
        self.images: tuple[Image, ...] = ()
        try:
            self.images = read_images(data)
        except ValueError as error:
            self.problem = str(error)
        version, interface = description.fmi_version, description.interface
        core = core_functions(version, interface)
        lacking = {
            name
            for image in self.images
            for name in fmi_functions(version, interface)
            if exported_name(name, version, description.model_identifier) not in image.exports
        }
        self.missing_core = tuple(sorted(lacking & core))
        self.missing = tuple(sorted(lacking - core))
        self.exported = len(fmi_functions(version, interface)) - len(lacking) if self.images else 0

    @property
    def foreign_needs(self) -> tuple[str, ...]:
        """Libraries that neither the system nor the FMU brings."""
        own = {name.lower() for name in self.beside}
        found = {
            need
            for image in self.images
            for need in image.needs
            if not is_system_library(image.kind, need) and PurePosixPath(need).name.lower() not in own
        }
        return tuple(sorted(found))

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        older, names = platform_names(self.platform, [image.architecture for image in self.images])
        return {
            "file": self.file,
            "fmi2_platform": older,
            "fmi3_platforms": list(names),
            "size": self.size,
            "problem": self.problem,
            "images": [image.as_dict() for image in self.images],
            "functions_exported": self.exported,
            "functions_missing": [*self.missing_core, *self.missing],
            "needs_beyond_the_system": list(self.foreign_needs),
            "beside": list(self.beside),
        }


def binaries(path: Path, description: ModelDescription) -> list[Binary]:
    """The FMU's libraries, one a platform. Raises: FmuError if the archive cannot be read."""
    checked_members(path)
    found = []
    try:
        with zipfile.ZipFile(path) as archive:
            names = [PurePosixPath(name) for name in archive.namelist()]
            for name in names:
                if len(name.parts) != 3 or name.parts[0] != "binaries" or name.suffix not in _LIBRARIES:
                    continue
                if name.stem != description.model_identifier:
                    continue
                beside = tuple(one.name for one in names if one.parent == name.parent and one != name)
                found.append(Binary(str(name), archive.read(str(name)), description, beside))
    except (zipfile.BadZipFile, zlib.error, OSError, EOFError, RuntimeError) as error:
        raise FmuError(f"{path}: cannot be read ({error})") from error
    return sorted(found, key=lambda binary: binary.platform)


def _without_library(names: Iterable[str], known: Collection[str]) -> dict[str, list[str]]:
    """Files of folders under binaries/ that hold no library of the model, by folder.

    Args:
        names: of the archive's files; known: folders that do.
    """
    found: dict[str, list[str]] = {}
    for path in map(PurePosixPath, names):
        if len(path.parts) > 2 and path.parts[0] == "binaries" and path.parts[1] not in known:
            found.setdefault(path.parts[1], []).append("/".join(path.parts[2:]))
    return found


def inspect_fmu(path: Path) -> dict[str, Any]:
    """All information about an FMU without running it, for JSON.

    Raises: FmuError if it cannot be read.
    """
    fmu = load_fmu(path)
    found = fmu.description
    members = checked_members(path)
    sizes: Counter[str] = Counter()
    for member in members:
        parts = PurePosixPath(member.filename).parts
        sizes[parts[0] if len(parts) > 1 else "."] += member.file_size
    names = [member.filename for member in members if not member.is_dir()]
    libraries = binaries(path, found)
    return {
        "file": str(path),
        "size": path.stat().st_size,
        "checksum": fmu.checksum(),
        "name": found.name,
        "description": found.description,
        "fmi_version": found.fmi_version,
        "interfaces": _interfaces(path),
        "tool": found.tool,
        "token": found.token,
        "model_identifier": found.model_identifier,
        "this_platform": binary_folder(found.fmi_version),
        "binaries": {binary.platform: binary.as_dict() for binary in libraries},
        "platforms_without_library": _without_library(names, {one.platform for one in libraries}),
        "capabilities": asdict(found.capabilities),
        "experiment": {
            "step_size": found.default_step,
            "fixed_step_size": found.own_step,
            "tolerance": found.tolerance,
        },
        "states": found.states,
        "event_indicators": found.event_indicators,
        "deviations": list(found.deviations),
        "counts": _counts(found),
        "variables": [
            _variable(one, found) for one in found.variables.values() if one.causality in _SHOWN
        ],
        "sources": [name for name in names if name.startswith("sources/")],
        "documentation": [name for name in names if name.startswith("documentation/")],
        "resources": [name for name in names if name.startswith("resources/")],
        "sizes": dict(sorted(sizes.items())),
    }  # fmt: skip


def _interfaces(path: Path) -> list[str]:
    from ...fmi.safe_xml import read_markup

    root = read_markup(path)
    if root.get("fmiVersion") == "1.0":
        return ["co-simulation" if root.find("Implementation") is not None else "model-exchange"]
    names = {
        "CoSimulation": "co-simulation",
        "ModelExchange": "model-exchange",
        "ScheduledExecution": "scheduled-execution",
    }
    return [capability for name, capability in names.items() if root.find(name) is not None]


def _counts(found: ModelDescription) -> dict[str, int]:
    counts = Counter(str(one.causality) for one in found.variables.values())
    return {"all": len(found.variables), **dict(sorted(counts.items()))}


def _variable(one: Variable, found: ModelDescription) -> dict[str, Any]:
    document: dict[str, Any] = {
        "name": one.name,
        "causality": str(one.causality),
        "variability": str(one.variability),
        "type": one.type,
        "unit": one.unit_name,
        "start": one.start,
        "minimum": one.minimum,
        "maximum": one.maximum,
        "nominal": one.nominal if one.kind is Kind.REAL else None,
        "shape": list(one.shape),
        "description": one.description,
    }
    if one.causality is Causality.OUTPUT:
        document["depends_on"] = None if one.name in found.assumed else list(found.feedthrough[one.name])
    return document
