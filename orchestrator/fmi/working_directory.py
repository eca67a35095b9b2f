"""The working directory, which FMUs are met that change and on which everybody's relative paths depend.

It belongs to the process, not to a thread: who asks for it while another thread loads an FMU would get a
folder inside that FMU, and go back there after it was removed. Hence one thread at a time.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

_LOCK = threading.RLock()


def working_directory() -> str | None:
    """Where relative paths begin, once no FMU is being loaded; None if that folder was removed."""
    with _LOCK:
        try:
            return os.getcwd()
        except FileNotFoundError:
            return None


def return_to(directory: str | None) -> None:
    """Make it the working directory again; None, and a folder that is gone, are left alone."""
    with _LOCK:
        if directory is not None and working_directory() != directory:
            with suppress(FileNotFoundError):
                os.chdir(directory)


@contextmanager
def returning() -> Iterator[None]:
    """Hold other threads off the working directory, and come back to it whatever happens."""
    with _LOCK:
        directory = working_directory()
        try:
            yield
        finally:
            return_to(directory)
