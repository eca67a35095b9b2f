"""Files that are there whole or not at all, and never in the place of something else."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from .errors import ConfigError, Problem, listed


def replaceable(path: Path, suffixes: Collection[str], option: str) -> None:
    """See that what stands where a command is to write is of the kind that it writes.

    Args:
        suffixes: of that kind; option: that names the path.
    Raises: ConfigError if it is a file of another kind, which may be the only copy of somebody's work.
    """
    if path.is_file() and path.suffix.lower() not in suffixes:
        what = f"{path} is there already, and is no {listed(suffixes)} file"
        raise ConfigError([Problem(option, what, remedy="Name another file, or remove that one.")])


@contextmanager
def whole_file(path: Path) -> Iterator[BinaryIO]:
    """A stream for the content of a file, which is put in place, as readable as any other, once it is whole.

    Several processes may write the same file at once. Raises: OSError if it cannot be written; whatever
    ends the writing leaves what was there before.
    """
    handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        # mkstemp gives 0600.
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(temporary, 0o666 & ~umask)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def write_text(path: Path, text: str) -> None:
    """Write a text file whole, in UTF-8. Raises: OSError."""
    with whole_file(path) as stream:
        stream.write(text.encode("utf-8"))
