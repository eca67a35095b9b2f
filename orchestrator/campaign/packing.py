"""A study as it travels to workers: its config as plain values, and the files that runs need."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..config import move_effects
from ..fmi.workers.files import place_of
from ..simulation.run import Prepared
from .execute import FILES


@dataclass(frozen=True)
class Packed:
    """What travels.

    Attributes:
        config: plain values; FMUs and files of effects stand as FILES and their place.
        files: contents by place.
        varied: places of the FMUs and files of effects that the design varies, by path.
    """

    config: dict[str, Any]
    files: dict[str, bytes]
    varied: dict[Path, str]


def pack(prepared: Prepared, varied: Iterable[Path]) -> Packed:
    """Pack a system.

    Args:
        varied: FMUs and files of effects that the design puts in place of its own.
    """
    config, files = prepared.config, dict[str, bytes]()

    def packed(path: Path) -> str:
        content = path.read_bytes()
        place = place_of(content, path.name)
        files[place] = content
        return place

    data = config.model.to_data()
    paths = {one.name: one.fmu.path for one in prepared.system.instances}
    for name, instance in data["instances"].items():
        instance["fmu"] = FILES + packed(paths[name])
        instance.pop("form", None)
    move_effects(data, lambda file: FILES + packed(config.folder / file))
    return Packed(data, files, {path: packed(path) for path in varied})
