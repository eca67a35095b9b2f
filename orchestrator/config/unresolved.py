"""What is not known of a config, because of problems that are reported already."""

from __future__ import annotations

from collections.abc import Container, Iterable
from dataclasses import dataclass

from .text import Path

# In place of a key: an entry that may be there as well.
FURTHER = "*"


@dataclass(frozen=True)
class Gaps:
    """Paths of a config whose values are unreliable; a check there would report a problem twice.

    Attributes:
        paths: of values that are not known, with all beneath them; (..., FURTHER) where a mapping or a list
            may have more entries than are known.
    """

    paths: frozenset[Path] = frozenset()

    def knows(self, *path: str | int) -> bool:
        """Whether what stands at a path, or that nothing does, can be relied on."""
        return not any(path[:length] in self.paths for length in range(len(path) + 1))

    def whole(self, *path: str | int) -> bool:
        """Whether that also holds for everything beneath it."""
        return self.knows(*path) and not any(one[: len(path)] == path for one in self.paths)

    def further(self, *path: str | int) -> bool:
        """Whether a mapping or a list may have entries that are not known."""
        return not self.knows(*path) or (*path, FURTHER) in self.paths

    def beneath(self, *path: str) -> frozenset[str]:
        """Keys of a mapping whose values are not known."""
        keys = (one[-1] for one in self.paths if len(one) == len(path) + 1 and one[:-1] == path)
        return frozenset(str(key) for key in keys if key != FURTHER)


@dataclass(frozen=True)
class Absent:
    """Names of unknown instances; nothing that concerns them is checked.

    Attributes:
        names: of those that are there, and have a problem of their own.
        known: names of all others; None if every name that does not exist is a mistake.
    """

    names: frozenset[str] = frozenset()
    known: Container[str] | None = None

    def __contains__(self, name: object) -> bool:
        return name in self.names or (self.known is not None and name not in self.known)

    def among(self, others: Iterable[str]) -> list[str]:
        """All names of instances, for messages: these and others."""
        return [*others, *sorted(self.names)]

    def but(self, known: Container[str]) -> Absent:
        """Also whatever name is not among those."""
        return Absent(self.names, known)
