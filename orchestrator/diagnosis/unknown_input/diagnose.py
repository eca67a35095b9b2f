"""From a study of a system's ports to the files that a diagnosis writes."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ...base.atomic_files import write_text
from ...base.errors import ConfigError
from ...results.file_formats import strict
from ...simulation.run_folder import folder_at
from ..study.checks import check_logs
from ..study.devices import with_devices_fed
from ..study.mistakes import WarnedOfMaster
from ..study.native import in_native_form
from ..study.reader import load_port_study
from ..study.study import PortStudy
from .answer import Answer
from .corrected import write_corrected
from .inquiry import answer
from .report import data_of, text_of

# Most that "none" is stated with where a device was not searched.
_DEVICES = 0.6


@dataclass(frozen=True)
class DiagnosedSystem:
    """The diagnosis of a system of FMUs.

    Attributes:
        study: as read. answer: see `Answer`.
        folder, files: where it was written and the files' names; None and none if it was not.
    """

    study: PortStudy
    answer: Answer
    folder: Path | None = None
    files: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Of the study."""
        return self.study.name

    @property
    def data(self) -> dict[str, Any]:
        """The content of diagnosis.json."""
        return strict(data_of(self.answer))

    def __str__(self) -> str:
        text = text_of(self.name, self.answer)
        return text if self.folder is None else f"{text}\n  written to {self.folder}: {', '.join(self.files)}"


def diagnose_system(
    study: PortStudy | Path | str,
    out: Path | str | None = None,
    *,
    report: bool = True,
    progress: Callable[[str], None] = lambda stage: None,
) -> DiagnosedSystem:
    """Find the law that a system of FMUs lacks.

    Args:
        study: or a study.yaml, or the folder that holds one.
        out: folder to write to; None: nothing is written.
        report: whether to write the page, too. progress: takes the name of each stage.
    Raises: ConfigError with all problems of the study and its logs.
    """
    progress("read")
    study = study if isinstance(study, PortStudy) else load_port_study(Path(study))
    progress("check")
    study, slow = in_native_form(study)
    refused, warned = check_logs(study)
    if refused:
        raise ConfigError(refused)
    searched, devices = with_devices_fed(study)
    if devices and check_logs(searched)[0]:  # a loop that keeps the machine in place must stay closed
        searched, devices = study, []
    found = answer(searched, progress)
    if devices and found.verdict == "none":
        found = replace(found, probability=min(found.probability, _DEVICES))
    found.remarks.extend(
        f"{one.place}: {one.what}. {one.remedy}"
        for one in (*warned, *devices, *slow)
        if found.by_master or not isinstance(one, WarnedOfMaster)
    )
    if out is None:
        return DiagnosedSystem(study, found)
    folder = Path(out)
    folder_at(folder)
    earlier = ("diagnosis.json", "report.html", "corrected.yaml", *_models(folder))
    for one in earlier:
        (folder / one).unlink(missing_ok=True)
    found.remarks.extend(write_corrected(study, found, folder))
    if report:
        # matplotlib takes a third of a second to import.
        from .page import page

        write_text(folder / "report.html", page(study.name, found))
    data = json.dumps(strict(data_of(found)), allow_nan=False, ensure_ascii=False, indent=1)
    write_text(folder / "diagnosis.json", data + "\n")
    kept = {*earlier, *_models(folder)}
    written = tuple(sorted(p.name for p in folder.iterdir() if p.name in kept))
    return DiagnosedSystem(study, found, folder, written)


def _models(folder: Path) -> list[str]:
    """Names of models and FMUs of laws and of corrected components."""
    patterns = ("law_*.*", "*_corrected.mo", "*_corrected.fmu")
    return [path.name for one in patterns for path in folder.glob(one)]
