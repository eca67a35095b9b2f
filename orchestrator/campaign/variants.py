"""The system of a study with values of its design in place of its own."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..base.errors import ConfigError, Problem
from ..config import Config
from ..simulation.run import prepare
from ..system.system import Instance
from .axes import Axis, Level, as_text
from .software_version import effect_sources


def written(axis: Axis, level: Level) -> Any:
    """A start value as a config has it, with its unit."""
    return f"{level.shown!r} {axis.unit}" if axis.unit not in ("", "1") else level.shown


class Variants:
    """Looks at the system with other values; what FMUs and effects were found to be is kept."""

    def __init__(self, config: Config, axes: Mapping[str, Axis]) -> None:
        """
        Args:
            config: of the system.
            axes: by path.
        """
        self._config, self._axes = config, axes
        self._instances: dict[tuple[str, Path], Instance | None] = {}
        self._sources: dict[tuple[str, Level], list[str]] = {}

    def problems(self, point: Mapping[str, Level], place: str) -> list[Problem]:
        """What is wrong with the system at values of some axes, by path."""
        texts = []
        for path, level in point.items():
            axis, text = self._axes[path], level.text
            if level.file is not None:
                path, text = f"{axis.target[1]}.fmu", as_text(str(level.file.resolve()))
            elif axis.start:
                text = as_text(written(axis, level))
            texts.append(f"{path}={text}")
        made = [self._axes[path].target[1] for path, level in point.items() if level.file is not None]
        config = _without_form(self._config, made) if made else self._config
        try:
            prepare(config, texts)
        except ConfigError as error:
            return [replace(one, place=f"{place}: {one.place}") for one in error.problems]
        return []

    def instance(self, name: str, file: Path) -> Instance | None:
        """An instance as it is of another FMU, whose units may be others; None if it cannot be."""
        known = self._instances
        if (name, file) not in known:
            try:
                texts = [f"{name}.fmu={as_text(str(file.resolve()))}"]
                system = prepare(_without_form(self._config, [name]), texts).system
                known[name, file] = next(one for one in system.instances if one.name == name)
            except ConfigError:
                known[name, file] = None
        return known[name, file]

    def sources(self, path: str, level: Level) -> list[str]:
        """Of the effect that a value of an axis over effects names: its name does not identify its code."""
        known = self._sources.get((path, level))
        if known is None:
            try:
                known = effect_sources(prepare(self._config, [f"{path}={level.text}"]).system)
            except ConfigError:  # its run fails and says why
                known = []
            self._sources[path, level] = known
        return known


def _without_form(config: Config, instances: Iterable[object]) -> Config:
    """The config without the form of instances that are given another FMU."""
    data = config.model.to_data()
    for name in instances:
        data["instances"][name].pop("form", None)
    # Not read again from plain values: relative paths in it start from its own folder.
    return replace(config, model=type(config.model).model_validate(data))
