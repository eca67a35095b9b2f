"""A diagnosis with its study and finding."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from .finding import Finding
from .study import Study
from .verdict import Diagnosis


@dataclass(frozen=True)
class Diagnosed:
    """A diagnosis with its study and finding.

    Attributes:
        diagnosis: content of diagnosis.json.
        folder, files: where it was written and the files' names; None and none if it was not.
    """

    study: Study
    finding: Finding
    diagnosis: Diagnosis
    folder: Path | None = None
    files: tuple[str, ...] = ()
