"""What a build gave."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, repr=False)
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

    def __repr__(self) -> str:
        lines = [f"{self.path}: {self.model}, FMI {self.fmi_version} co-simulation"]
        if self.counts:
            counts = self.counts.items()
            shown = [_count(number, what) for what, number in counts if number or what in _ALWAYS]
            lines.append("  " + ", ".join(shown))
        if self.platforms:
            lines.append(f"  binaries: {', '.join(self.platforms)}")
        return "\n".join([*lines, *(f"  {note}" for note in self.notes)])


_ALWAYS = ("states", "inputs", "outputs", "parameters")


def _count(number: int, what: str) -> str:
    """A number of things, as "1 block of equations"."""
    first, *rest = what.replace("and steps", "or step").split() if number == 1 else (what,)
    return " ".join([str(number), first.removesuffix("s") if number == 1 else first, *rest])
