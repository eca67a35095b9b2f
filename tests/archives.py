"""Broken and changed FMU archives for the tests."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from pathlib import Path


def repack(source: Path, target: Path, change: Callable[[str, bytes], tuple[str, bytes] | None]) -> Path:
    """Copy an archive; `change` gives each entry's new name and content, or None to drop it."""
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w") as new:
        for entry in old.infolist():
            changed = change(entry.filename, old.read(entry))
            if changed is not None:
                new.writestr(*changed)
    return target
