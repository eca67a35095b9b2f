"""Files by their content: named by their SHA-256, put in place whole, and checked where they arrive."""

from __future__ import annotations

from pathlib import Path

from ...base.atomic_files import whole_file
from ...base.digests import digest_of, file_digest
from ...base.errors import OrchestratorError
from ...base.temporary_folders import cache_folder as kept_folder


def place_of(data: bytes, name: str) -> str:
    """Where a file stands below a folder of files: "<sha256>/<name>"."""
    return f"{digest_of(data)}/{name}"


def cache_folder() -> Path:
    """Where a machine keeps files that were sent to it."""
    return kept_folder("files")


def put_file(folder: Path, place: str, data: bytes) -> Path:
    """Have a file at its place, unless it stands there already, sound.

    Raises: OrchestratorError if the data is not what its place says; OSError if it cannot be written.
    """
    digest = place.partition("/")[0]
    if digest_of(data) != digest:
        raise OrchestratorError(f"{place}: arrived damaged, its SHA-256 is {digest_of(data)}")
    path = folder / place
    try:
        if file_digest(path) == digest:
            return path
    except OSError:
        pass
    path.parent.mkdir(parents=True, exist_ok=True)
    # Several workers of a machine may put it at once: each writes its own and moves it into place.
    with whole_file(path) as file:
        file.write(data)
    return path
