"""The working directory, which FMUs are met that change and on which everybody's relative paths depend."""

from __future__ import annotations

import os

__all__ = ["return_to", "working_directory"]


def working_directory() -> str | None:
    """Where relative paths begin; None if that folder was removed."""
    try:
        return os.getcwd()
    except FileNotFoundError:
        return None


def return_to(directory: str | None) -> None:
    """Make it the working directory again; None is left alone."""
    if directory is not None and working_directory() != directory:
        os.chdir(directory)
