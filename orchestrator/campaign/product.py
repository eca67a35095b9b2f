"""Which product computed a run: its version, and the bytes of what computes."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

from ..provenance import versions

__all__ = ["product"]

_PACKAGE = Path(__file__).resolve().parents[1]
# What no number of a run depends on.
_BESIDE = (
    "campaign", "commands.py", "compare.py", "diagnosis", "fmu_tools", "folder_lock.py", "frequency",
    "plotting.py", "progress.py", "run_folder.py", "table.py", "translate", "workers", "__main__.py",
    "_bundled",
)  # fmt: skip


@cache
def product() -> str:
    """The version and a digest of the sources that a run's numbers come from."""
    digest = hashlib.sha256()
    for path in sorted(_PACKAGE.rglob("*.py")):
        place = path.relative_to(_PACKAGE)
        if place.parts[0] not in _BESIDE and "reproduction" not in place.parts:
            digest.update(place.as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return f"{versions(['orchestrator'])['orchestrator']}+{digest.hexdigest()[:16]}"
