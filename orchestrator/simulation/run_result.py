"""What a run gave."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..results.recorders import Results
from .preparation import Prepared

__all__ = ["RunResult"]


@dataclass
class RunResult:
    """What a run gave.

    Attributes:
        results: the recorded signals.
        summary: as in summary.json.
        prepared: what ran.
        folder: where files were written; None if they were not.
        files: names of the files written.
        coupling: energies of the power bonds over time, at the recorded points; None without bonds.
    """

    results: Results
    summary: dict[str, Any]
    prepared: Prepared
    folder: Path | None = None
    files: list[str] = field(default_factory=list)
    coupling: Results | None = None
