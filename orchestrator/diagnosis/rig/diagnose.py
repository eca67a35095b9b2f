"""Diagnose a study and write the results: effects, places, closure, next experiment."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from time import perf_counter
from typing import Any

from ...base.atomic_files import write_text
from ...base.errors import ConfigError
from ...simulation.run_folder import folder_at
from ..study.mistakes import Warned
from .augmented import augmented_config
from .checks import check_logs
from .content import content, named_files, provenance
from .diagnosed import Diagnosed
from .finding import Finding
from .study import Role, Study, case_file, load_study
from .verdict import AUGMENTED, NAME, PAGE, Diagnosis, Runnable

# What a diagnosis writes.
_FILES = (NAME, PAGE, AUGMENTED)
# Analyses by stage: modules, which bring machine code along, and their functions; all but `weigh` receive the
# finding, too.
_ANALYSES = {
    "weigh": ("weigh:weigh",),
    "where": ("shapley:where", "residual_ledger:ledger", "energy:energy"),
    "how far": ("closure:how_far",),
    "what next": ("experiments:next_experiment",),
    "numerics": ("numerics:numerics",),
}
# What runs that no fit saw say about something outside the catalogue.
_JUDGED = "judging_by_held_out_runs"

Report = Callable[[str], None]


def diagnose(
    study: Study | Path | str,
    out: Path | str | None = None,
    *,
    parts: Mapping[str, Callable[..., Any]] | None = None,
    report: bool = True,
    progress: Report = lambda stage: None,
) -> Diagnosed:
    """Diagnose the gap between a docking rig and its simulation.

    Args:
        study: or the folder of a case, or its study.yaml.
        out: folder to write to; nothing is written without it.
        parts: the analyses by name; those of this package by default.
        report: whether to write the page, too.
        progress: receives the name of each stage as it begins.
    Raises: ConfigError with all problems of the study and its logs; OrchestratorError if an analysis fails.
    """
    begin = perf_counter()
    progress("read")
    source = None if isinstance(study, Study) else Path(study)
    study = study if isinstance(study, Study) else load_study(Path(study))
    progress("check")
    refused, warned = check_logs(study)
    if refused:
        raise ConfigError(refused)
    progress("weigh")
    parts = parts or _analyses()
    finding = parts["weigh"](study)
    results, left_out = _analysed(parts, study, finding, progress)
    config = augmented_config(study, finding)
    changed, missing = list(config.changed), dict(config.left_out)
    augmented = Runnable(file=AUGMENTED, run=config.run, changed=changed, left_out=missing)
    known = [Warned(place=one.place, what=one.what, remedy=one.remedy or one.allowed) for one in warned]
    origins = provenance({} if source is None else _files(study, source))
    diagnosis = content(study.name, finding, study.nominal, results, left_out, known, augmented, origins)
    progress("write")
    if out is None:
        return Diagnosed(study, finding, diagnosis)
    diagnosis.provenance["seconds"] = round(perf_counter() - begin, 3)
    folder, files = _write(Diagnosed(study, finding, diagnosis), Path(out), report, config.text)
    return Diagnosed(study, finding, diagnosis, folder, files)


def _analyses() -> dict[str, Callable[..., Any]]:
    """The analyses of this package by name."""
    homes = [home.partition(":") for some in _ANALYSES.values() for home in some]
    return {name: getattr(import_module(f".{module}", __package__), name) for module, _, name in homes}


def _analysed(
    parts: Mapping[str, Callable[..., Any]], study: Study, finding: Finding, progress: Report
) -> tuple[dict[str, Any], dict[str, str]]:
    """Results of the analyses of a finding, and why others have none."""
    found: dict[str, Any] = {}
    left_out = {_JUDGED: finding.unjudged} if finding.unjudged else {}
    for stage, homes in _ANALYSES.items():
        if stage == "weigh":
            continue
        progress(stage)
        for name in (home.partition(":")[2] for home in homes):
            if name in ("where", "how_far") and not study.of(Role.HELDOUT):
                left_out[name] = "no run has the role heldout"
            elif name in parts:
                found[name] = parts[name](study, finding)
    return found, left_out


def _files(study: Study, source: Path) -> dict[str, Path]:
    """The study's file and its logs, by name; other files of its folder are not opened."""
    file = case_file(source)
    return named_files(file.parent, [file, *(run.path for run in study.runs if run.path is not None)])


def _write(diagnosed: Diagnosed, out: Path, report: bool, config: str) -> tuple[Path, tuple[str, ...]]:
    """Write everything; diagnosis.json last, so that its presence shows a complete result."""
    _cleared(out)
    files = [NAME, AUGMENTED]
    write_text(out / AUGMENTED, config)
    if report:
        # matplotlib takes a third of a second to import.
        from .report import page

        write_text(out / PAGE, page(diagnosed.study, diagnosed.diagnosis, diagnosed.finding.answer))
        files.append(PAGE)
    write_text(out / NAME, _json(diagnosed.diagnosis))
    return out, tuple(files)


def _cleared(folder: Path) -> None:
    """Make the folder and remove files of an earlier diagnosis. Raises: ConfigError."""
    folder_at(folder)
    for name in _FILES:
        (folder / name).unlink(missing_ok=True)


def _json(diagnosis: Diagnosis) -> str:
    return json.dumps(diagnosis.data_of(), indent=2, allow_nan=False, ensure_ascii=False) + "\n"
