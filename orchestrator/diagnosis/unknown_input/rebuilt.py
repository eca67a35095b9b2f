"""Components built again from the Modelica files beside their FMUs."""

from __future__ import annotations

import json
import re
import shutil
import weakref
from dataclasses import replace
from pathlib import Path
from zipfile import ZipFile

from ...base.atomic_files import write_text
from ...base.errors import OrchestratorError
from ...base.temporary_folders import scratch_folder
from ...fmi import CompiledFmu, load_fmu
from ...system.connection import Port
from ...translate.build import check_options, compiled, model_identifier, translate
from ...translate.opened import Opening, opened_model
from ...translate.package import this_platform, write_fmu
from ...translate.presentation import PROVENANCE, source_digest
from ..study.study import PortStudy

# The name of a component's variable in a flat model, or of its derivative.
_QUOTED = re.compile(r"""\bname="(der\()?'\w[\w.,\[\]]*'\)?\"""")


def source_of(fmu: Path) -> tuple[Path, str] | str:
    """The Modelica file that an FMU was built from, with the model's name; or why it is not known.

    The FMU names its files with their digests. They are looked for beside the FMU and one folder above.
    """
    with ZipFile(fmu) as archive:
        if PROVENANCE not in archive.namelist():
            return f"{fmu.name} does not say which model it was built from"
        about = json.loads(archive.read(PROVENANCE))
    name, found = str(about["modelName"]), []
    for file, digest in about.get("sources", {}).items():
        places = (fmu.parent / file, fmu.parent / Path(file).name, fmu.parent.parent / file)
        same = [one for one in places if one.is_file() and source_digest(one.read_bytes()) == digest]
        if not same or same[0].suffix != ".mo":
            return f"{file}, from which {fmu.name} was built, is not beside it, or differs"
        found.append(same[0])
    last = name.rpartition(".")[2]
    main = [one for one in found if one.stem == last] or found
    return (main[0], name) if main else f"{fmu.name} names no file that it was built from"


def build_flat(model: Path, fmu: Path, version: str) -> None:
    """Build a flat model, whose variables get the names that they have in the model with components."""
    members, report = translate(model, fmi_version=version, model=model.stem)
    description = members["modelDescription.xml"].decode()
    members["modelDescription.xml"] = _QUOTED.sub(
        lambda found: found[0].replace("'", ""), description
    ).encode()
    checked, platforms = check_options(version, [this_platform()])
    write_fmu(fmu, members | compiled(members, model_identifier(report.model), checked, platforms))


def with_openings(study: PortStudy) -> PortStudy | None:
    """The study with inputs inside its components; None if no component takes any.

    Components with states are opened whose FMUs were built from Modelica files that still lie beside them.
    """
    folder = scratch_folder("opened-")
    instances, openings = [], dict[Port, Opening]()
    built: dict[Path, tuple[CompiledFmu, tuple[Opening, ...]] | None] = {}
    for one in study.prepared.system.instances:
        fmu = one.fmu
        if isinstance(fmu, CompiledFmu) and fmu.path not in built:
            built[fmu.path] = _opened(fmu, folder / f"{len(built)}")
        found = built.get(fmu.path) if isinstance(fmu, CompiledFmu) else None
        if found is not None:
            about = found[0].description
            through, initial = dict(about.feedthrough), dict(about.initial_feedthrough)
            one = replace(one, fmu=found[0], feedthrough=through, initial_feedthrough=initial)
            openings |= {Port(one.name, each.name): each for each in found[1]}
        instances.append(one)
    if not openings:
        shutil.rmtree(folder, ignore_errors=True)
        return None
    system = replace(study.prepared.system, instances=tuple(instances))
    made = replace(study, prepared=replace(study.prepared, system=system), openings=openings)
    weakref.finalize(system, shutil.rmtree, folder, True)
    return made


def _opened(fmu: CompiledFmu, folder: Path) -> tuple[CompiledFmu, tuple[Opening, ...]] | None:
    """An FMU with inputs inside, and which these are."""
    if not fmu.description.states:
        return None
    source = source_of(fmu.path)
    if isinstance(source, str):
        return None
    try:
        text, openings = opened_model(source[0], model=source[1])
        if not openings:
            return None
        folder.mkdir()
        model = folder / f"{source[1].rpartition('.')[2]}.mo"
        write_text(model, text)
        build_flat(model, model.with_suffix(".fmu"), fmu.description.fmi_version)
        return load_fmu(model.with_suffix(".fmu")), openings
    except (OrchestratorError, ImportError):
        return None  # a model that cannot be built so is searched from outside only
