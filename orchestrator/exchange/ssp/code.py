"""Python code of effects in packages: taken only where that is asked for."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...base.errors import ConfigError, Problem
from ...config.files import move_effects
from .archive import Package


def take_code(data: Mapping[str, Any], package: Package, place: str, *, with_code: bool) -> list[Path]:
    """Unpack the Python files that connections of a config take effects from.

    Args:
        data: the config's plain values, files as they stand in the package; as unpacked afterwards.
        place: for messages.
        with_code: whether that is asked for: such code runs when the config is loaded.
    Returns: the files.
    Raises: ConfigError if it is not, or if the package does not hold a file.
    """
    problems: dict[str, Problem] = {}
    found: dict[str, Path] = {}

    def moved(file: str) -> str:
        if not package.has(file):
            what = f"takes an effect from {file}, which is not in the package"
            problems[file] = Problem(place, what, "Python files of the package")
            return file
        if not with_code:
            what = f"{file} is Python code, of an effect: it would run with your rights"
            remedy = f"Read it; if you trust it, `orchestrator import {package.label} -o CONFIG --with-code`."
            problems[file] = Problem(place, what, remedy=remedy)
            return file
        found[file] = package.file(file, place)
        return str(found[file])

    move_effects(data, moved)
    if problems:
        raise ConfigError(list(problems.values()))
    return list(found.values())
