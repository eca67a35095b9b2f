"""What a build gave."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

__all__ = ["BuildReport"]


@dataclass(frozen=True)
class BuildReport:
    """What was built.

    Attributes:
        path: the FMU.
        model: qualified name of the model.
        fmi_version: "2.0" or "3.0".
        platforms: for which it holds binaries.
        counts: number of states, inputs, outputs, parameters, delays, relations by those names.
        notes: what the author of the model should know, one sentence each.
    """

    path: Path
    model: str
    fmi_version: str
    platforms: tuple[str, ...]
    counts: dict[str, int]
    notes: tuple[str, ...] = ()
