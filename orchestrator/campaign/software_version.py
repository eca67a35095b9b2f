"""Which product computed a run: its version, and the bytes of what computes; and effects of others."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterable
from functools import cache
from pathlib import Path

from ..base.provenance import versions
from ..effects import Effect
from ..system.system import System

_PACKAGE = Path(__file__).resolve().parents[1]
# What no number of a run depends on.
_BESIDE = (
    "campaign",
    "cli",
    "diagnosis",
    "frequency",
    "plotting/figures.py",
    "translate",
    "base/folder_lock.py",
    "base/text_tables.py",
    "fmi/workers",
    "results/progress.py",
    "simulation/comparison.py",
    "simulation/run_folder.py",
    "__main__.py",
    "_bundled",
)
# Of these: what makes a row of a run.
_WITHIN = ("campaign/derived.py", "campaign/execute.py")


def _counts(place: Path) -> bool:
    """Whether a file of the product, by its place in it, is in the digest."""
    if place.as_posix() in _WITHIN:
        return True
    beside = any(place.is_relative_to(one) for one in _BESIDE)
    return not beside and "reproduction" not in place.parts


@cache
def product() -> str:
    """The version and a digest of the sources that a run's numbers come from."""
    digest = hashlib.sha256()
    for path in sorted(_PACKAGE.rglob("*.py")):
        place = path.relative_to(_PACKAGE)
        if _counts(place):
            digest.update(place.as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return f"{versions(['orchestrator'])['orchestrator']}+{digest.hexdigest()[:16]}"


def effect_sources(system: System) -> list[str]:
    """Digests of the code of a system's effects that `product` does not hold, in their order.

    Of a package all sources count, not those of one module alone: which others that one takes its law from
    cannot be determined without running it.
    """
    wires = (one.wire for one in system.connections if one.wire is not None)
    kinds = {type(link.effect) for wire in wires for link in wire.every_link}
    found: set[str] = set()
    for name in {base.__module__ for kind in kinds for base in kind.__mro__ if issubclass(base, Effect)}:
        file = _file_of(name)
        if file is None:
            continue
        files = {file}
        if file.is_relative_to(_PACKAGE):
            if _counts(file.relative_to(_PACKAGE)):
                continue
        else:
            root = _file_of(name.partition(".")[0])
            files |= set(root.parent.rglob("*.py")) if root and root.name == "__init__.py" else set()
        found.add(_digest(sorted(files)))
    return sorted(found)


def _file_of(module: str) -> Path | None:
    file = getattr(sys.modules.get(module), "__file__", None)
    return None if file is None else Path(file).resolve()


def _digest(files: Iterable[Path]) -> str:
    digest = hashlib.sha256()
    for file in files:
        digest.update(file.name.encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()
