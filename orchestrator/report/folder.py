"""What a run left in its folder, finished, failed, killed or still running."""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

from ..base.errors import ConfigError, OrchestratorError
from ..base.folder_lock import NAME as LOCK
from ..base.folder_lock import locked
from ..config import Config, load_config
from ..results.measures import ChosenMeasure, choose_measures
from ..results.recorders import Results, read_results

_RESULTS = ("results.arrow", "results.csv")


class State(Enum):
    """How a run ended."""

    DONE = "done"
    FAILED = "failed"
    INTERRUPTED = "interrupted"
    KILLED = "killed"
    RUNNING = "running"


@dataclass(frozen=True)
class RunFolder:
    """A run, read from its folder.

    Attributes:
        name: of the folder.
        summary: as in summary.json; empty where the run did not come to write it.
        results: what was recorded; None where nothing can be read.
        config: as run; None where it cannot be read any more.
        measures: those of the config.
        coupling: energies of the power bonds over time [J]; None where the run kept none.
        missing: what could not be read, and why.
    """

    folder: Path
    name: str
    state: State
    summary: dict[str, Any]
    results: Results | None
    config: Config | None
    measures: tuple[ChosenMeasure, ...]
    coupling: Results | None = None
    missing: tuple[str, ...] = ()

    @property
    def title(self) -> str:
        """Of the system, or the folder's name."""
        given = self.config.model.title if self.config is not None else self.summary.get("title")
        return given or self.name

    @property
    def units(self) -> dict[str, str]:
        """Of the measures' numbers."""
        return {key: unit for one in self.measures for key, unit in getattr(one.measure, "units", {}).items()}


def is_run(folder: Path) -> bool:
    """Whether a run has written to a folder."""
    return (folder / "config.yaml").is_file() and (
        (folder / "summary.json").is_file() or any((folder / one).is_file() for one in _RESULTS)
    )


def read_run(folder: Path) -> RunFolder:
    """Read what there is. Raises: OrchestratorError if neither summary nor results can be read."""
    missing: list[str] = []
    summary: dict[str, Any] = {}
    path = folder / "summary.json"
    if path.is_file():
        try:
            summary = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            missing.append(f"summary.json cannot be read ({error})")
    results = config = None
    try:
        results = read_results(folder)
    except OrchestratorError as error:
        missing.append(str(error))
    if not summary and results is None:
        raise OrchestratorError(f"{folder}: nothing of the run can be read\n  " + "\n  ".join(missing))
    coupling = None
    if (folder / "coupling.csv").is_file():
        try:
            coupling = read_results(folder / "coupling.csv")
        except OrchestratorError as error:
            missing.append(str(error))
    measures: tuple[ChosenMeasure, ...] = ()
    try:
        config = load_config(folder / "config.yaml")
        measures = choose_measures(config)
    except ConfigError as error:
        missing.append(f"config.yaml: {error}")
    return RunFolder(
        folder,
        folder.resolve().name,
        _state(folder, summary),
        summary,
        results,
        config,
        measures,
        coupling if coupling is not None and len(coupling) and coupling.signals else None,
        tuple(missing),
    )


def _state(folder: Path, summary: dict[str, Any]) -> State:
    error = summary.get("error")
    if error:
        return State.INTERRUPTED if error.get("kind") == "Interrupted" else State.FAILED
    if summary:
        return State.DONE
    if (folder / LOCK).exists():
        with suppress(ConfigError), locked(folder):
            return State.KILLED
        return State.RUNNING
    return State.KILLED
