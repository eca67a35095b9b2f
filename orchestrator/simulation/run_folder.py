"""What a run writes to its folder."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ..base.errors import ConfigError, OrchestratorError, Problem
from ..config import Config, load_config, move_effects
from ..fmi.log_file import LOG_FOLDER, clear_logs
from ..results.file_formats import FORMATS
from ..results.measures import FIGURES

if TYPE_CHECKING:
    from .run_result import RunResult

# What a run writes, the config aside. Its figures are those that it draws itself, and its measures'.
_WRITTEN = (
    "summary.json",
    "coupling.csv",
    *(f"results.{suffix}" for suffix in FORMATS),
    *(f"{name}.png" for name in ("signals", "realtime", "coupling", *FIGURES)),
)


def folder_at(out: Path | str | None) -> Path | None:
    """The folder, made if need be. Raises: ConfigError if it cannot be made."""
    if out is None:
        return None
    folder = Path(out)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError([Problem("", f"cannot make the folder {folder} ({error})")]) from error
    return folder


def begin_folder(folder: Path, config: Config) -> None:
    """Clear what an earlier run left, which is not to be taken for this one's, and keep the config.

    Raises: ConfigError if the folder cannot be written to.
    """
    try:
        for name in _WRITTEN:
            (folder / name).unlink(missing_ok=True)
        clear_logs(folder)
        (folder / "config.yaml").write_text(_moved(config, folder).text(), encoding="utf-8")
    except OSError as error:
        raise ConfigError([Problem("", f"cannot write to the folder {folder} ({error})")]) from error


def incomplete(folder: Path, error: OSError) -> OrchestratorError:
    """The error of a run that was recorded whole, while other files could not be written."""
    return OrchestratorError(
        f"{folder}: not all files could be written ({error}); what was recorded is in results.arrow"
    )


def _moved(config: Config, folder: Path) -> Config:
    """The same config for another folder: relative paths in it lead to the same files.

    FMUs that were unpacked for this process only are kept in the folder.
    """
    data = config.model.to_data()
    for instance in data["instances"].values():
        path = config.folder / instance["fmu"]
        if config.unpacked is not None and path.is_relative_to(config.unpacked):
            kept = folder / "fmus" / path.relative_to(config.unpacked)
            kept.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, kept)
            instance["fmu"] = kept.relative_to(folder).as_posix()
        elif path.is_file() and not Path(instance["fmu"]).is_absolute():
            instance["fmu"] = Path(os.path.relpath(path, folder)).as_posix()

    def moved(file: str) -> str:
        path = config.folder / file
        if Path(file).is_absolute() or not path.is_file():
            return file
        return Path(os.path.relpath(path, folder)).as_posix()

    move_effects(data, moved)
    return load_config(data)


def write_run(result: RunResult, formats: Sequence[str], figures: bool) -> None:
    """Write everything but results.arrow, which was streamed.

    Raises: OSError if the disk does not take it; OrchestratorError if a figure fails.
    """
    folder = result.folder
    assert folder is not None
    result.files = ["config.yaml", "results.arrow", "summary.json"]
    result.files += sorted(path.relative_to(folder).as_posix() for path in folder.glob(f"{LOG_FOLDER}/*.log"))
    text = json.dumps(result.summary, indent=2, allow_nan=False, ensure_ascii=False)
    try:
        (folder / "summary.json").write_text(text + "\n", encoding="utf-8")
    except OSError:
        (folder / "summary.json").unlink(missing_ok=True)  # half a summary is none
        raise
    for suffix in dict.fromkeys(formats):
        if suffix != "arrow":
            result.results.write(folder / f"results.{suffix}")
            result.files.append(f"results.{suffix}")
    if result.coupling is not None:
        result.coupling.to_csv(folder / "coupling.csv")
        result.files.append("coupling.csv")
    if not figures:
        return
    # matplotlib takes longer to import than a short run takes.
    from ..plotting import figures as plotting

    prepared = result.prepared
    drawn = {"signals": plotting.draw_signals(result.results, prepared.config.model.title)}
    if "realtime" in result.summary["run"]:
        drawn["realtime"] = plotting.draw_punctuality(
            result.summary["run"]["realtime"], result.summary["run"]["step_size"], prepared.config.model.title
        )
    if result.coupling is not None:
        drawn["coupling"] = plotting.draw_coupling(result.coupling, prepared.config.model.title)
    for one in prepared.measures:
        try:
            drawn |= one.measure.figures(result.results, one.options)
        except Exception as error:
            raise OrchestratorError(f"figures of measure {one.name} failed: {error}") from error
    for name, figure in drawn.items():
        plotting.save(figure, folder / f"{name}.png")
        result.files.append(f"{name}.png")
