"""Packages as configs: for a run, and for good."""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...base.errors import ConfigError, Problem
from ...base.temporary_folders import scratch_folder, scratch_root
from ...config import dump
from ...config.files import move_effects
from .annotations import checksum
from .read import MAIN, Read, read_ssp


@dataclass(frozen=True)
class Loaded:
    """What `load_config` takes of a package: see `orchestrator.config.Config`."""

    data: dict[str, Any]
    unpacked: Path | None
    notes: list[str]
    remedies: dict[str, str]


def load_ssp(path: Path) -> Loaded:
    """The config of a package; its FMUs are unpacked to a folder that is removed at the end of the process.

    Raises: ConfigError with all problems.
    """
    folder = scratch_folder("ssp-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    read = read_ssp(path, folder)
    return Loaded(read.data, folder, read.notes, read.remedies)


def import_ssp(path: Path, output: Path, variant: str = MAIN, *, with_code: bool = False) -> Read:
    """Write a package as a config, and its FMUs to the folder `<name of the config>-fmus` beside it.

    Args:
        path: a .ssp or .ssd file.
        output: the YAML file.
        variant: the description in a package.
        with_code: whether to take Python code of effects along, into that folder.
    Returns: what was read; its FMUs as they are written in the config.
    Raises: ConfigError with all problems; then nothing is written.
    """
    with tempfile.TemporaryDirectory(prefix="ssp-", dir=scratch_root()) as text:
        read = read_ssp(path, Path(text), variant, with_code=with_code)
        folder = output.parent / f"{output.stem}-fmus"
        moves: dict[Path, Path] = {}
        for name, file in read.files.items():
            one = read.data["instances"][name]
            if one["fmu"] != str(file):
                continue  # a bundled FMU, which goes by its name
            moves.setdefault(file, _free(folder, file, moves))
            one["fmu"] = _relative(moves[file], output)
        for file in read.code:
            moves[file] = _free(folder, file, moves)
        move_effects(read.data, lambda file: _relative(moves[Path(file)], output))
        try:
            output.parent.mkdir(parents=True, exist_ok=True)
            for file, target in moves.items():
                folder.mkdir(exist_ok=True)
                shutil.copyfile(file, target)
            output.write_text(dump(read.data), encoding="utf-8")
        except OSError as error:
            raise ConfigError([Problem(str(output), f"cannot be written ({error})")]) from error
    return read


def _relative(target: Path, output: Path) -> str:
    return Path(os.path.relpath(target, output.parent)).as_posix()


def _free(folder: Path, file: Path, moves: dict[Path, Path]) -> Path:
    """Where a file goes: under its own name, unless another file of this package has it.

    Raises: ConfigError if a file of that name is there and is another one.
    """
    target, number = folder / file.name, 2
    while target in moves.values():
        target, number = folder / f"{file.stem}-{number}{file.suffix}", number + 1
    if target.is_symlink() or (target.exists() and checksum(target) != checksum(file)):
        what = f"{target} exists, and is not the file of this package"
        raise ConfigError([Problem("", what, remedy="Remove it, or choose another name for the config.")])
    return target
