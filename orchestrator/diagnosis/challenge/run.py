"""Has every case of a challenge diagnosed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from pathlib import Path

from ...errors import ConfigError, Problem
from .make import workers

__all__ = ["OURS", "diagnose_all"]

OURS = "orchestrator.diagnosis.challenge.run:ours"


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
) -> tuple[int, Sequence[tuple[str, str]]]:
    """Diagnose the cases that have no verdict yet; the sealed truth is not touched.

    Args:
        verdicts: where <case>/diagnosis.json go.
        by: `module:function`, called with the folder of a case and that of its verdict.
        progress: called with the name of each case when it is done.
    Returns: how many were diagnosed, and the name and the error of those that failed.
    Raises: ConfigError if there are no cases, or no such function.
    """
    _function(by)
    cases = sorted(path.parent for path in folder.glob("*/case.yaml"))
    if not cases:
        raise ConfigError(
            [Problem(str(folder), "holds no cases", remedy="Make some by `orchestrator challenge make`.")]
        )
    left = [case for case in cases if not (verdicts / case.name / "diagnosis.json").is_file()]
    failed = []
    if left:
        with workers(min(jobs, len(left))) as mapped:
            for name, error in mapped(partial(_one, verdicts, by), left):
                if error:
                    failed.append((name, error))
                progress(name)
    return len(left) - len(failed), failed


def _one(verdicts: Path, by: str, case: Path) -> tuple[str, str]:
    try:
        _function(by)(case, verdicts / case.name)
    except Exception as error:  # whatever a diagnosis raises: the other cases go on
        return case.name, f"{type(error).__name__}: {error}"
    if not (verdicts / case.name / "diagnosis.json").is_file():
        return case.name, f"{by} wrote no diagnosis.json"
    return case.name, ""


def _function(by: str) -> Callable[[Path, Path], object]:
    module, _, name = by.partition(":")
    try:
        found = getattr(import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise ConfigError([Problem("--by", f"{by}: {error}", "module:function")]) from None
    return found
