"""Diagnose a study and write the results: effects, places, closure, next experiment."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any

from ...base.atomic_files import write_text
from ...base.errors import ConfigError
from ...simulation.run_folder import folder_at
from ..study.mistakes import Warned
from .analyses import Analyses
from .augmented import AugmentedConfig, augmented_config, is_docking_lab
from .checks import check_logs
from .content import AnalysisResults, content, named_files, provenance
from .diagnosed import Diagnosed
from .finding import Finding
from .study import Role, Study, case_file, load_study
from .verdict import AUGMENTED, NAME, PAGE, Diagnosis, Runnable

# What a diagnosis writes.
_FILES = (NAME, PAGE, AUGMENTED)
# What runs that no fit saw say about something outside the catalogue.
_JUDGED = "judging_by_held_out_runs"

Report = Callable[[str], None]


def diagnose(
    study: Study | Path | str,
    out: Path | str | None = None,
    *,
    parts: Analyses | None = None,
    report: bool = True,
    progress: Report = lambda stage: None,
) -> Diagnosed:
    """Diagnose the gap between a docking rig and its simulation.

    Args:
        study: or the folder of a case, or its study.yaml.
        out: folder to write to; nothing is written without it.
        parts: the analyses; all of this package by default.
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
    parts = parts or Analyses.standard()
    finding = parts.weigh(study)
    results = _analysed(parts, study, finding, progress)
    config = augmented_config(study, finding) if is_docking_lab(study) else None
    augmented = None
    if config is not None:
        changed, missing = list(config.changed), dict(config.left_out)
        augmented = Runnable(file=AUGMENTED, run=config.run, changed=changed, left_out=missing)
    known = [Warned(place=one.place, what=one.what, remedy=one.remedy or one.allowed) for one in warned]
    origins = provenance({} if source is None else _files(study, source))
    diagnosis = content(study.name, finding, study.nominal, results, known, augmented, origins)
    progress("write")
    if out is None:
        return Diagnosed(study, finding, diagnosis)
    diagnosis.provenance["seconds"] = round(perf_counter() - begin, 3)
    folder, files = _write(Diagnosed(study, finding, diagnosis), Path(out), report, config)
    return Diagnosed(study, finding, diagnosis, folder, files)


def _analysed(parts: Analyses, study: Study, finding: Finding, progress: Report) -> AnalysisResults:
    """Results of all analyses of a finding."""
    found: dict[str, Any] = {}
    left_out = {_JUDGED: finding.unjudged} if finding.unjudged else {}
    for stage, analyses in (
        ("where", ("where", "ledger", "energy")),
        ("how far", ("how_far",)),
        ("what next", ("next_experiment",)),
        ("numerics", ("numerics",)),
    ):
        progress(stage)
        for name in analyses:
            reason = _missing(name, getattr(parts, name), study)
            if reason:
                left_out[name] = reason
            else:
                found[name] = getattr(parts, name)(study, finding)
    return AnalysisResults(**found, left_out=left_out)


def _missing(name: str, part: Callable[..., Any] | None, study: Study) -> str:
    """Why an analysis cannot be made; "" if it can."""
    if part is None:
        return "this installation has no such analysis"
    if name in ("where", "how_far") and not study.of(Role.HELDOUT):
        return "no run has the role heldout"
    return ""


def _files(study: Study, source: Path) -> dict[str, Path]:
    """The study's file and its logs, by name; other files of its folder are not opened."""
    file = case_file(source)
    return named_files(file.parent, [file, *(run.path for run in study.runs if run.path is not None)])


def _write(
    diagnosed: Diagnosed, out: Path, report: bool, config: AugmentedConfig | None
) -> tuple[Path, tuple[str, ...]]:
    """Write everything; diagnosis.json last, so that its presence shows a complete result."""
    _cleared(out)
    files = [NAME]
    if config is not None:
        write_text(out / AUGMENTED, config.text)
        files.append(AUGMENTED)
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
