"""Finds out what a folder holds, and makes its page."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..base.errors import ConfigError, OrchestratorError, Problem, listed
from .folder import is_run, read_run
from .run_page import BUDGET

# Of the page, where it is not named.
NAME = "report.html"

# Other contents of a folder than a run, by the file that identifies them.
_FILES = {"store": "store.json", "diagnosis": "diagnosis.json", "reproduction": "reproduction.json"}
_ALLOWED = "what run --out, sweep --store, reproduce or diagnose wrote, or several run folders"


def report(folders: Sequence[Path | str], *, budget: int = BUDGET) -> str:
    """The page of what commands wrote to folders, as HTML.

    Args:
        folders: one of any kind; or several of runs, which are compared. A folder of run folders stands for
            these. Of one that several commands wrote to, a part is shown: see `left_out`.
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
    read, notes = [read_run(run) for run in runs], [f"Left out: {one}" for one in left_out(paths)]
    if len(read) == 1:
        from .run_page import page

        return page(read[0], budget, notes)
    from .runs_page import page as together

    return together(read, budget, notes)


def left_out(folders: Sequence[Path | str]) -> tuple[str, ...]:
    """What else the folders hold that their page does not show, and where it is to be seen.

    Commands that write to one folder leave each other's files alone, and which of them a page is wanted of
    cannot be distinguished from their files: files that were copied have lost their times.
    """
    paths = [Path(one) for one in folders]
    shown = {run.resolve() for path in paths for run in _runs(path)}
    notes = []
    for path in paths:
        words = {
            "store": "the store of a sweep",
            "run": "a run; give each command a folder of its own",
            "diagnosis": f"a diagnosis: see {path / NAME}",
            "reproduction": f"a reproduction: see {path / 'reproduction.html'}",
        }
        kind = _kind(path) if len(paths) == 1 else "run"
        held = {*_specials(path), *(["run"] if _runs(path) else [])}
        notes += [f"{path} also holds {text}" for one, text in words.items() if one in held and one != kind]
        within = [run for run in _within(path) if run.resolve() not in shown]
        if kind == "run" and within:
            names, command = listed(run.name for run in within), " ".join(map(str, within))
            notes.append(f"{path} also holds runs in folders ({names}): see `orchestrator report {command}`")
    return tuple(notes)


def page_name(folder: Path) -> str:
    """How the page of a folder is called in it: a diagnosis' own page is not written over by a run's."""
    return NAME if _kind(folder) == "diagnosis" or "diagnosis" not in _specials(folder) else "runs.html"


def _runs(path: Path) -> list[Path]:
    return [path] if is_run(path) else _within(path)


def _within(path: Path) -> list[Path]:
    return sorted(one for one in path.iterdir() if one.is_dir() and is_run(one)) if path.is_dir() else []


def _specials(folder: Path) -> list[str]:
    """What a folder holds that is no run."""
    return [name for name, file in _FILES.items() if (folder / file).is_file()]


def _kind(folder: Path) -> str:
    """The content of a folder that its page shows; empty if there is none.

    A diagnosis and a reproduction come last: they have pages of their own.
    """
    held = _specials(folder)
    if "store" in held:
        return "store"
    return "run" if _runs(folder) else next(iter(held), "")


def _special(folder: Path) -> str | None:
    """The page of what is no run; None if it is one, or nothing that is known."""
    kind = _kind(folder)
    if kind == "store":
        from .store_page import page as store_page

        return store_page(folder)
    if kind == "diagnosis":
        return _diagnosis(folder / NAME)
    if kind == "reproduction":
        from ..docking.reproduction.page import page_of_folder as reproduction_page

        return reproduction_page(folder, _reproduced(folder / _FILES[kind]))
    return None


def _diagnosis(path: Path) -> str:
    """The page that `diagnose` made: its figures need the logs, which do not stand in the folder."""
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        remedy = "Run `orchestrator diagnose` again, without --no-report."
        problem = Problem(str(path), f"the diagnosis' page cannot be read ({error.strerror})", remedy=remedy)
        raise ConfigError([problem]) from None


def _reproduced(path: Path) -> dict[str, Any]:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise OrchestratorError(f"{path}: the reproduction cannot be read ({error})") from error
