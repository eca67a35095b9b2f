"""Files that a config names: FMUs, and Python files that effects come from."""

from __future__ import annotations

import pathlib
from collections.abc import Callable, Mapping
from typing import Any

from ..effects import effect_file
from .text import Path


def file_of(folder: pathlib.Path, own: pathlib.Path) -> Callable[[str], str]:
    """What a config in the folder `own` has for a file that is named outside it, relative to `folder`.

    What is in its own folder only, and names of bundled FMUs, it has as they are.
    """
    if folder.resolve() == own.resolve():
        return str

    def moved(text: str) -> str:
        file = folder / text
        if file.is_file():
            return str(file.resolve())
        is_path = "/" in text or "\\" in text or text.endswith((".fmu", ".py", ".csv"))
        return str(file.absolute()) if is_path and not (own / text).is_file() else text

    return moved


def move_value(path: Path, value: Any, moved: Callable[[str], str]) -> Any:
    """The value at a path of a config with the files that it names replaced."""
    if path[0] == "instances" and path[2:] == ("fmu",) and isinstance(value, str):
        return moved(value)
    if path[0] == "connections" and path[-1] in ("through", "effect"):
        through = value if path[-1] == "through" else [{"effect": value}]
        move_effects({"connections": [{"through": through}]}, moved)
        return value if path[-1] == "through" else through[0]["effect"]
    return value


def rebase(data: dict[str, Any], old: pathlib.Path, new: pathlib.Path) -> None:
    """Relative paths of a config that is extended keep pointing to the same files."""
    if old.resolve() == new.resolve():
        return

    def moved(text: str) -> str:
        return str((old / text).resolve()) if (old / text).is_file() else text

    instances = data.get("instances")
    for instance in instances.values() if isinstance(instances, dict) else ():
        fmu = instance.get("fmu") if isinstance(instance, dict) else None
        if isinstance(fmu, str):
            instance["fmu"] = moved(fmu)
    move_effects(data, moved)


def move_effects(data: Mapping[str, Any], moved: Callable[[str], str]) -> None:
    """Replace the Python files that connections of a config's plain values take effects from."""
    connections = data.get("connections")
    for connection in connections if isinstance(connections, list) else ():
        through = connection.get("through") if isinstance(connection, dict) else None
        for item in through if isinstance(through, list) else ():
            file = effect_file(item) if isinstance(item, dict) else ""
            if file:
                item["effect"] = f"{moved(file)}:{item['effect'].rpartition(':')[2]}"
