"""Diagnose every case of a challenge."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path

from ....base.errors import ConfigError, Problem
from ....config import parse
from ....fmi.workers import Work, pool_of
from ..verdict import NAME
from .cases import check_record, note_cases
from .verdict import read_verdict

OURS = "orchestrator.diagnosis.rig.challenge.run:ours"
_REFUSED = "refused.json"


def ours(case: Path, out: Path) -> None:
    """Diagnose a case by this package; figures and page are left out."""
    # Imported late: a challenge can be made and scored without it.
    from ..diagnose import diagnose

    diagnose(case, out, report=False)


def diagnose_all(
    folder: Path,
    verdicts: Path,
    jobs: int = 1,
    by: str = OURS,
    progress: Callable[[str], None] = lambda name: None,
    scheduler: object = None,
) -> tuple[int, Sequence[tuple[str, str]]]:
    """Diagnose the cases that have no verdict yet; the sealed truth is not touched.

    Args:
        verdicts: where <case>/diagnosis.json go; which cases they are of is kept there, too.
        by: `module:function`, called with the folder of a case and that of its verdict.
        progress: called with the name of each case when it is done, or has a verdict already.
        scheduler: a Dask cluster in place of `jobs` processes; its workers have to see both folders.
    Returns: how many were diagnosed, and the name and the error of those that failed.
    Raises: ConfigError if there are no cases, no such function, or no such cluster, or if there are verdicts
        of other cases.
    """
    _function(by)
    cases = sorted(path.parent for path in folder.glob("*/case.yaml"))
    if not cases:
        raise ConfigError(
            [Problem(str(folder), "holds no cases", remedy="Make some by `orchestrator challenge make`.")]
        )
    check_record(cases, verdicts)
    left = [case for case in cases if not (verdicts / case.name / NAME).is_file()]
    known, failed = len(cases) - len(left), list[tuple[str, str]]()
    for case in cases:
        if case not in left:
            progress(case.name)
    # What cannot be read is refused before a process loads what diagnoses.
    for case in list(left):
        try:
            parse((case / "case.yaml").read_text(encoding="utf-8"), str(case / "case.yaml"))
        except (ConfigError, OSError, UnicodeDecodeError) as error:
            failed.append((case.name, f"{type(error).__name__}: {error}"))
            left.remove(case)
            progress(case.name)
    if left:
        note_cases(left, verdicts)
        pool = pool_of(scheduler, min(jobs, len(left)))
        work = Work(_one, payload=(verdicts.resolve(), by))
        for outcome in pool.outcomes(work, [case.resolve() for case in left]):
            name = outcome.task.name
            error = outcome.value if outcome.failure is None else outcome.failure.message
            if error:
                failed.append((name, error))
            progress(name)
    return len(cases) - known - len(failed), sorted(failed)


def _one(context: tuple[Path, str], case: Path) -> str:
    """Diagnose a case. Returns: the error, if any."""
    verdicts, by = context
    try:
        _function(by)(case, verdicts / case.name)
    except Exception as error:  # whatever a diagnosis raises: the other cases go on
        return f"{type(error).__name__}: {error}"
    path = verdicts / case.name / NAME
    if not path.is_file():
        return f"{by} wrote no {NAME}"
    try:
        read_verdict(path)
    except ConfigError as error:
        # Kept for who wrote it, but no verdict: the next run diagnoses the case again.
        path.replace(path.with_name(_REFUSED))
        return f"{by} wrote no verdict, kept as {_REFUSED}: {error}"
    return ""


def _function(by: str) -> Callable[[Path, Path], object]:
    module, _, name = by.partition(":")
    try:
        found = getattr(import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise ConfigError([Problem("--by", f"{by}: {error}", "module:function")]) from None
    return found
