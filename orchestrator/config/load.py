"""Config files -> validated models, with `extends` and overrides; every problem has its place."""

from __future__ import annotations

import pathlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from importlib import import_module
from typing import Any

from ..base.errors import ConfigError, Problem, listed, nearest
from ..effects import effect_schema
from ..fmi import bundled
from .files import file_of, rebase
from .models import SystemModel
from .overrides import override
from .partial_config import correct_spelling, read_model
from .text import Path, Place, Places, compose, copied, dump
from .unresolved import FURTHER, Gaps

# Files of other tools: suffix -> what makes a config's plain values of them; imported when asked for. It
# gives `data`, `notes`, `unpacked` as in Config, and `remedies` for keys that are missing.
_FOREIGN = dict.fromkeys((".ssp", ".ssd"), "..exchange.ssp.load:load_ssp")
_FOREIGN[".fmu"] = "..exchange.single_fmu:load_lone_fmu"
_SUFFIXES = (".yaml", ".yml", *_FOREIGN)


@dataclass(frozen=True)
class Config:
    """A validated config.

    Attributes:
        model: the values.
        places: where each was written.
        folder: what relative paths in it start from.
        name: the file's stem, for figures and folders.
        notes: what was accepted in a file of another tool without being clear.
        unpacked: folder of FMUs that is removed when the process ends; None without such.
    """

    model: SystemModel
    places: Places = field(compare=False)
    folder: pathlib.Path = field(default_factory=pathlib.Path.cwd, compare=False)
    name: str = field(default="config", compare=False)
    notes: tuple[str, ...] = field(default=(), compare=False)
    unpacked: pathlib.Path | None = field(default=None, compare=False)

    def text(self) -> str:
        """The config as YAML."""
        return dump(self.model.to_data())


@dataclass(frozen=True)
class Draft:
    """A config as it is read, with all that is wrong with it.

    Attributes:
        config: what can be read of it; None if a part of it that may say anything is missing. See
            `read_model` for what its model is where there are gaps.
        problems: what is wrong.
        gaps: what is not known of it therefore.
        unchecked: see `ConfigError`.
    """

    config: Config | None
    problems: tuple[Problem, ...] = ()
    gaps: Gaps = field(default_factory=Gaps)
    unchecked: tuple[str, ...] = ()


def load_config(
    source: str | pathlib.Path | Mapping[str, Any] | Config,
    overrides: Iterable[str] = (),
) -> Config:
    """Read and check a config.

    Args:
        source: name of a bundled system or FMU, path of a YAML, .fmu, .ssp or .ssd file, plain values, or a
            config to be changed.
        overrides: changes such as "robot.tau_m=6 ms", "run.step_size=50 us" or "measures.docking.robot=a".
    Raises: ConfigError with all problems.
    """
    draft = read_config(source, overrides)
    if draft.problems or draft.config is None:
        raise ConfigError(draft.problems, draft.unchecked)
    return draft.config


def read_config(
    source: str | pathlib.Path | Mapping[str, Any] | Config,
    overrides: Iterable[str] = (),
    folder: pathlib.Path | None = None,
) -> Draft:
    """Read a config as far as it can be read; see `load_config`.

    Args:
        folder: where the overrides were written, from which relative paths in them start; None: the working
            directory. Files that are not there are looked for in the config's own.

    Raises: ConfigError if nothing of it can.
    """
    notes: tuple[str, ...] = ()
    unpacked: pathlib.Path | None = None
    remedies: Mapping[str, str] = {}
    found = _Found()
    if isinstance(source, Config):
        data, places = source.model.to_data(), source.places
        own, name, notes, unpacked = source.folder, source.name, source.notes, source.unpacked
    elif isinstance(source, Mapping):
        data, places = copied(source), Places("config")
        found.misspelt, _ = correct_spelling(data, places, SystemModel)
        own, name = pathlib.Path.cwd(), "config"
    else:
        path = _find(source)
        own, name = path.parent, path.stem
        reader = _FOREIGN.get(path.suffix.lower())
        if reader is not None:
            module, _, function = reader.partition(":")
            foreign = getattr(import_module(module, __package__), function)(path)
            data, places = copied(foreign.data), Places(path.name)
            notes, unpacked, remedies = tuple(foreign.notes), foreign.unpacked, foreign.remedies
        else:
            data, places = _read(path, (), found)
    places = Places(places.source, dict(places.known))
    moved = file_of(folder or pathlib.Path.cwd(), own)
    for text in overrides:
        problems, meant = override(data, places, text, moved)
        found.problems += problems
        found.gaps += meant
    model, wrong, gaps = read_model(data, places, Gaps(frozenset(found.gaps)))
    schema_problems = [replace(one, remedy=remedies.get(one.what.split(" ")[0], one.remedy)) for one in wrong]
    config = None if found.wanting else Config(model, places, own, name, notes, unpacked)
    unchecked = tuple(f"instances, connections and measures, for want of {one!r}" for one in found.wanting)
    return Draft(config, (*found.problems, *schema_problems, *found.misspelt), gaps, unchecked)


@dataclass
class _Found:
    """What reading files finds wrong.

    Attributes:
        misspelt: names of sections.
        wanting: configs that are extended and cannot be read.
    """

    problems: list[Problem] = field(default_factory=list)
    misspelt: list[Problem] = field(default_factory=list)
    gaps: list[Path] = field(default_factory=list)
    wanting: list[str] = field(default_factory=list)


def json_schema() -> dict[str, Any]:
    """JSON Schema of config files."""
    schema = SystemModel.model_json_schema(by_alias=True)
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    schema["properties"]["extends"] = {
        "type": "string",
        "description": "Bundled system or file that this config changes: mappings are merged, null removes "
        "an entry, anything else replaces it.",
    }
    schema["$defs"]["ConnectionModel"]["properties"]["through"]["items"] = effect_schema()
    # A config that extends another may leave out whatever that one gives.
    required = schema.pop("required")
    schema["anyOf"] = [{"required": ["extends"]}, {"required": required}]
    return schema


def _find(source: str | pathlib.Path) -> pathlib.Path:
    path = pathlib.Path(source)
    if path.is_file():
        return path
    found = bundled.find_system(str(source)) or bundled.find_fmu(str(source))
    if found is not None:
        return found
    names = bundled.system_names()
    beside = [str(path.with_name(one.name)) for one in path.parent.glob("*") if one.suffix in _SUFFIXES]
    what = f"no file {path}" if path.suffix in _SUFFIXES else f"no config {str(source)!r}"
    raise ConfigError(
        [
            Problem(
                "",
                what,
                f"neither a file nor a bundled system; bundled: {listed(names)}",
                nearest(str(source), (*beside, *names, *bundled.fmu_names())),
            )
        ]
    )


def _read(
    path: pathlib.Path, above: tuple[pathlib.Path, ...], wrong: _Found
) -> tuple[dict[str, Any], Places]:
    """Raises: ConfigError if the file holds nothing that can be read."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError([Problem(str(path), f"cannot be read ({error})")]) from error
    data, places, problems = compose(text, path.name)
    renamed: dict[str, str] = {}
    if isinstance(data, dict):
        misspelt, renamed = correct_spelling(data, places, SystemModel)
        wrong.misspelt += misspelt
    for where, problem in problems:
        wrong.problems.append(problem)
        where = tuple(renamed.get(str(part), part) for part in where[:1]) + where[1:]
        # Of a section, the entries that are taken stand all the same.
        wrong.gaps.append((*where, FURTHER) if len(where) == 1 and where != ("run",) else where)
    if not isinstance(data, dict):
        raise ConfigError(
            [
                Problem(
                    path.name,
                    "not a config",
                    "a config is a mapping with run and instances",
                    f"Build it first: orchestrator build {path.name}" if path.suffix == ".mo" else "",
                )
            ]
        )
    if "extends" not in data:
        return data, places
    base = data.pop("extends")
    try:
        found = _base(path, base, places.text(("extends",)), above)
        base_data, base_places = _read(found, (*above, path), wrong)
    except ConfigError as error:
        wrong.problems += error.problems
        wrong.wanting.append(str(base))
        wrong.gaps.append(())  # it may give anything
        return data, places
    rebase(base_data, found.parent, path.parent)
    known = dict(base_places.known)
    merged = _merge(base_data, data, (), known, places)
    return merged, Places(path.name, known)


def _base(path: pathlib.Path, base: Any, place: str, above: tuple[pathlib.Path, ...]) -> pathlib.Path:
    """The config that one extends. Raises: ConfigError."""
    if not isinstance(base, str):
        raise ConfigError([Problem(place, f"{base!r} is no name", "a bundled system or a path")])
    base_path = path.parent / base
    found = base_path if base_path.is_file() else bundled.find_system(base)
    if found is None:
        names = bundled.system_names()
        allowed = f"no file {base_path}; bundled: {listed(names)}"
        raise ConfigError([Problem(place, f"no config {base!r}", allowed, nearest(base, names))])
    if found.resolve() in (earlier.resolve() for earlier in (*above, path)):
        raise ConfigError([Problem(place, f"{base!r} extends itself")])
    return found


def _merge(base: Any, change: Any, path: Path, known: dict[Path, Place], places: Places) -> Any:
    """Mappings are merged, null removes an entry, anything else replaces it."""
    if not (isinstance(base, dict) and isinstance(change, dict)):
        for key in [key for key in known if key[: len(path)] == path]:
            del known[key]
        known.update({key: place for key, place in places.known.items() if key[: len(path)] == path})
        return change
    merged = dict(base)
    for key, value in change.items():
        if value is None:
            merged.pop(key, None)
        elif key in base:
            merged[key] = _merge(base[key], value, (*path, key), known, places)
        else:
            merged[key] = _merge(None, value, (*path, key), known, places)
    return merged
