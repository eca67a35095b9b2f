"""Python components of a system replayed in their native form: the same numbers, much sooner."""

from __future__ import annotations

import shutil
import weakref
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...base.errors import OrchestratorError
from ...base.temporary_folders import scratch_folder
from ...fmi import CompiledFmu, load_fmu
from ...fmi.workers import Work, pool_of
from ...translate.inserted import memory_told, own_source
from .mistakes import Warned
from .replay import Replay
from .study import Array, PortStudy

_PYTHON = "PythonFMU"
# Samples of all train runs above which a build saves more time than it takes, and the longest time of a build
# [s]: it explores all paths of the code, which may be many.
_MANY, _LONGEST = 1000, 300.0
# By how much signals may differ, of their largest value: functions of numpy round in an order of their own.
_SAME = 1e-9
_OTHERWISE = "its native form gives something else"


def in_native_form(study: PortStudy) -> tuple[PortStudy, list[Warned]]:
    """The study, with FMUs of Python replayed in their native form, as far as they have one.

    Thousands of replays are made, and Python takes nearly all of their time, one replay at a time. What a
    component's code cannot be traced for, or what does not give what the Python code gives, stays as it is.

    Returns: the study, and what stays, with the reason.
    """
    fmus = {str(one.fmu.path): one.fmu for one in study.prepared.system.instances if _in_python(one.fmu)}
    if not fmus or sum(map(len, study.runs)) * study.parts < _MANY:
        return study, []
    folder = scratch_folder("native-forms-")
    made, reasons = _built(fmus, folder)
    found = replace(study, natives={Path(path): one for path, one in made.items()})
    if made and not _same(study, found):
        reasons |= dict.fromkeys(made, _OTHERWISE)
        made = {}
    if not made:
        shutil.rmtree(folder, ignore_errors=True)
        found = study
    for one in found.natives.values():
        # Each player unpacks the file again.
        weakref.finalize(one, shutil.rmtree, folder, True)
    return found, [
        Warned(
            place=one.name,
            what=f"is replayed in Python, which takes most of the time: {reasons[str(one.fmu.path)]}",
            remedy="With a native form, see docs/fmus.md, a diagnosis takes a twentieth of it.",
        )
        for one in study.prepared.system.instances
        if isinstance(one.fmu, CompiledFmu) and str(one.fmu.path) in reasons
    ]


def _built(fmus: Mapping[str, CompiledFmu], folder: Path) -> tuple[dict[str, CompiledFmu], dict[str, str]]:
    """Native forms by the path of the FMU, and for those without one the reason."""
    made: dict[str, CompiledFmu] = {}
    reasons: dict[str, str] = {}
    tasks = [(path, str(folder / f"{number}.fmu")) for number, path in enumerate(fmus)]
    try:
        for outcome in pool_of(None, None).outcomes(Work(_build, time_limit=_LONGEST), tasks):
            path, built = outcome.task
            if outcome.failure is not None:
                reasons[path] = outcome.failure.message.partition("\n")[0].removeprefix(f"{built[:-4]}.py: ")
            elif _alike(fmus[path], native := load_fmu(Path(built))):
                made[path] = native
            else:
                reasons[path] = _OTHERWISE
    except OrchestratorError as error:
        return {}, dict.fromkeys(fmus, str(error).partition("\n")[0])
    return made, reasons


def _in_python(fmu: object) -> bool:
    return (
        isinstance(fmu, CompiledFmu)
        and str(fmu.description.tool).startswith(_PYTHON)
        and not fmu.run_options.isolated
    )


def _build(context: None, task: tuple[str, str]) -> None:
    """Build the native form of an FMU for this machine, in a process of its own. Raises: BuildError."""
    from ...translate.native_form import build_native_fmu
    from ...translate.package import this_platform

    fmu, built = map(Path, task)
    script = built.with_suffix(".py")
    script.write_text(memory_told(own_source(fmu)), encoding="utf-8")
    build_native_fmu(script, built, platforms=[this_platform()])


def _alike(one: CompiledFmu, other: CompiledFmu) -> bool:
    """Whether an FMU can take the other's place: it has variables of the same names and numbers."""
    mine, others = (
        {
            name: (variable.reference, variable.causality, variable.kind, variable.unit_name)
            for name, variable in fmu.description.variables.items()
            if name != "time"
        }
        for fmu in (one, other)
    )
    return mine.items() <= others.items()


def _same(study: PortStudy, other: PortStudy) -> bool:
    """Whether both replay the first run in the same way."""
    run = study.runs[0]
    given, found = (Replay(one).signals(run) for one in (study, other))
    return all(
        np.allclose(given[port], found[port], rtol=0.0, atol=_SAME * _largest(given[port]), equal_nan=True)
        for port in given
    )


def _largest(values: Array) -> float:
    return float(np.abs(np.nan_to_num(values)).max(initial=0.0))
