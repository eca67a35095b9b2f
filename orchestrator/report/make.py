"""Finds out what a folder holds, and makes its page."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..errors import ConfigError, Problem, listed
from .folder import is_run, read_run
from .run_page import BUDGET

__all__ = ["report"]

_ALLOWED = "what run --out, sweep --store, reproduce or diagnose wrote, or several run folders"


def report(folders: Sequence[Path | str], *, budget: int = BUDGET) -> str:
    """The page of what commands wrote to folders, as HTML.

    Args:
        folders: one of any kind; or several of runs, which are compared. A folder of run folders stands for
            these.
        budget: what recorded signals may take in the page [B].
    Raises: ConfigError if a folder holds nothing that a page can be made of; OrchestratorError if what it
        holds cannot be read.
    """
    paths = [Path(one) for one in folders]
    if len(paths) == 1:
        made = _special(paths[0])
        if made is not None:
            return made
    runs, problems = [], []
    for path in paths:
        found = _runs(path)
        if not found:
            what = "holds no run" if path.is_dir() else "is no folder"
            problems.append(Problem(str(path), what, _ALLOWED))
        runs += found
    names = [run.resolve().name for run in runs]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        problems.append(Problem("", f"several runs are called {listed(twice)}", "one folder name for each"))
    if problems or not runs:
        raise ConfigError(problems or [Problem("", "no folder is given", _ALLOWED)])
    read = [read_run(run) for run in runs]
    if len(read) == 1:
        from .run_page import page

        return page(read[0], budget)
    from .runs_page import page as together

    return together(read, budget)


def _runs(path: Path) -> list[Path]:
    if not path.is_dir():
        return []
    return [path] if is_run(path) else sorted(one for one in path.iterdir() if one.is_dir() and is_run(one))


def _special(folder: Path) -> str | None:
    """The page of what is no run; None if it is one, or nothing that is known."""
    if (folder / "store.json").is_file():
        from .store_page import page as store_page

        return store_page(folder)
    if (folder / "diagnosis.json").is_file():
        return _diagnosis(folder / "report.html")
    summary = _summary(folder / "summary.json")
    if "experiments" in summary:
        from ..docking.reproduction.page import page_of_folder as reproduction_page

        return reproduction_page(folder, summary)
    return None


def _diagnosis(path: Path) -> str:
    """The page that `diagnose` made: its figures need the logs, which do not stand in the folder."""
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        remedy = "Run `orchestrator diagnose` again, without --no-report."
        problem = Problem(str(path), f"the diagnosis' page cannot be read ({error.strerror})", remedy=remedy)
        raise ConfigError([problem]) from None


def _summary(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}
