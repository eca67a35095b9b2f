"""What a check of an FMU found."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from enum import StrEnum
from typing import Any


class Verdict(StrEnum):
    """How a check ended."""

    PASSED = "passed"
    FAILED = "failed"
    NOT_APPLICABLE = "not applicable"
    NOT_TRIED = "could not be tried"


class Level(StrEnum):
    """How much a failed check matters: errors make results wrong or crash, warnings may surprise."""

    NONE = ""
    WARNING = "warning"
    ERROR = "error"


@dataclass(frozen=True)
class Finding:
    """The outcome of one check.

    Attributes:
        check: its name.
        level: of a failed check; empty of others.
        reason: a sentence: what was seen.
        remedy: a sentence: what to do; empty where nothing is to be done.
        figures: what was measured.
    """

    check: str
    verdict: Verdict
    reason: str
    level: Level = Level.NONE
    remedy: str = ""
    figures: dict[str, Any] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            key: str(value) if isinstance(value, StrEnum) else value for key, value in asdict(self).items()
        }


def passed(check: str, reason: str, **figures: Any) -> Finding:
    """A check that found nothing wrong."""
    return Finding(check, Verdict.PASSED, reason, figures=figures)


def failed(check: str, level: Level, reason: str, remedy: str = "", **figures: Any) -> Finding:
    """A check that found something."""
    return Finding(check, Verdict.FAILED, reason, level, remedy, figures)
