"""Config files -> validated models, with `extends` and overrides; every problem is told with its place."""

from __future__ import annotations

import pathlib
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from importlib import import_module
from typing import Any

from pydantic import ValidationError

from .. import bundled
from ..effects import effect_file, effect_schema
from ..errors import ConfigError, Problem, listed, nearest
from .models import RunModel, SystemModel
from .problems import validation_problems
from .text import Path, Place, Places, dump, parse

__all__ = [
    "Config",
    "json_schema",
    "load_config",
    "move_effects",
    "override_path",
    "put_value",
    "unknown_path",
]

# Files of other tools: suffix -> what makes a config's plain values of them; imported when asked for. It
# gives `data`, `notes`, `unpacked` as in Config, and `remedies` for keys that are missing.
_FOREIGN = dict.fromkeys((".ssp", ".ssd"), "..exchange.ssp.load:load_ssp")


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


def load_config(
    source: str | pathlib.Path | Mapping[str, Any] | Config, overrides: Iterable[str] = ()
) -> Config:
    """Read and check a config.

    Args:
        source: name of a bundled system, path of a YAML, .ssp or .ssd file, plain values, or a config to be
            changed.
        overrides: changes such as "robot.tau_m=6 ms", "run.step_size=50 us" or "measures.docking.robot=a".
    Raises: ConfigError with all problems.
    """
    notes: tuple[str, ...] = ()
    unpacked: pathlib.Path | None = None
    remedies: Mapping[str, str] = {}
    if isinstance(source, Config):
        data, places = source.model.to_data(), source.places
        folder, name, notes, unpacked = source.folder, source.name, source.notes, source.unpacked
    elif isinstance(source, Mapping):
        data, places = _copied(source), Places("config")
        folder, name = pathlib.Path.cwd(), "config"
    else:
        path = _find(source)
        folder, name = path.parent, path.stem
        reader = _FOREIGN.get(path.suffix.lower())
        if reader is not None:
            module, _, function = reader.partition(":")
            foreign = getattr(import_module(module, __package__), function)(path)
            data, places = _copied(foreign.data), Places(path.name)
            notes, unpacked, remedies = tuple(foreign.notes), foreign.unpacked, foreign.remedies
        else:
            data, places = _read(path, ())
    problems: list[Problem] = []
    places = Places(places.source, dict(places.known))
    for text in overrides:
        problems += _override(data, places, text)
    if problems:
        raise ConfigError(problems)
    try:
        model = SystemModel.model_validate(data)
    except ValidationError as error:
        found = validation_problems(error, places, (), SystemModel)
        told = [replace(one, remedy=remedies.get(one.what.split(" ")[0], one.remedy)) for one in found]
        raise ConfigError(told) from None
    return Config(model, places, folder, name, notes, unpacked)


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
    found = bundled.find_system(str(source))
    if found is not None:
        return found
    names = bundled.system_names()
    raise ConfigError(
        [
            Problem(
                "",
                f"no config {str(source)!r}",
                f"neither a file nor a bundled system; bundled: {listed(names)}",
                nearest(str(source), names),
            )
        ]
    )


def _read(path: pathlib.Path, above: tuple[pathlib.Path, ...]) -> tuple[dict[str, Any], Places]:
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError([Problem(str(path), f"cannot be read ({error})")]) from error
    data, places = parse(text, path.name)
    if not isinstance(data, dict):
        raise ConfigError(
            [Problem(path.name, "not a config", "a config is a mapping with run and instances")]
        )
    if "extends" not in data:
        return data, places
    base = data.pop("extends")
    place = places.text(("extends",))
    if not isinstance(base, str):
        raise ConfigError([Problem(place, f"{base!r} is no name", "a bundled system or a path")])
    base_path = path.parent / base
    found = base_path if base_path.is_file() else bundled.find_system(base)
    if found is None:
        names = bundled.system_names()
        raise ConfigError(
            [
                Problem(
                    place,
                    f"no config {base!r}",
                    f"no file {base_path}; bundled: {listed(names)}",
                    nearest(base, names),
                )
            ]
        )
    if found.resolve() in (earlier.resolve() for earlier in (*above, path)):
        raise ConfigError([Problem(place, f"{base!r} extends itself")])
    base_data, base_places = _read(found, (*above, path))
    _rebase(base_data, found.parent, path.parent)
    known = dict(base_places.known)
    merged = _merge(base_data, data, (), known, places)
    return merged, Places(path.name, known)


def _rebase(data: dict[str, Any], old: pathlib.Path, new: pathlib.Path) -> None:
    """Relative paths of a config that is extended keep pointing to the same files."""
    if old.resolve() == new.resolve():
        return
    instances = data.get("instances")
    for instance in instances.values() if isinstance(instances, dict) else ():
        fmu = instance.get("fmu") if isinstance(instance, dict) else None
        if isinstance(fmu, str) and (old / fmu).is_file():
            instance["fmu"] = str((old / fmu).resolve())
    move_effects(data, lambda file: str((old / file).resolve()) if (old / file).is_file() else file)


def move_effects(data: Mapping[str, Any], moved: Callable[[str], str]) -> None:
    """Replace the Python files that connections of a config's plain values take effects from."""
    connections = data.get("connections")
    for connection in connections if isinstance(connections, list) else ():
        through = connection.get("through") if isinstance(connection, dict) else None
        for item in through if isinstance(through, list) else ():
            file = effect_file(item) if isinstance(item, dict) else ""
            if file:
                item["effect"] = f"{moved(file)}:{item['effect'].rpartition(':')[2]}"


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


def _copied(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _copied(item) for key, item in value.items()}
    return [_copied(item) for item in value] if isinstance(value, list | tuple) else value


def _override(data: dict[str, Any], places: Places, text: str) -> list[Problem]:
    """Apply one override; problems found."""
    place = f"--set {text}"
    name, equals, value_text = (part.strip() for part in text.partition("="))
    if not equals or not name:
        return [Problem(place, "not an override", 'written as path=value, for example robot.tau_m="6 ms"')]
    try:
        value, _ = parse(value_text, place)
    except ConfigError as error:
        return list(error.problems)
    path = override_path(data, name)
    if path is None:
        return [unknown_path(data, name, place)]
    put_value(data, path, value)
    places.known[path] = Place(place)
    return []


def unknown_path(data: dict[str, Any], name: str, place: str) -> Problem:
    """The problem of a path that `override_path` does not know."""
    instances, measures = _section(data, "instances"), _section(data, "measures")
    known = [f"run.{key}" for key in RunModel.model_fields]
    known += [f"{one}.{key}" for one, its in instances.items() for key in _section(its, "start")]
    connections = data.get("connections")
    for n, one in enumerate(connections if isinstance(connections, list) else ()):
        through = one.get("through") if isinstance(one, dict) else None
        for m, its in enumerate(through if isinstance(through, list) else ()):
            known += [f"connections[{n}].through[{m}].{key}" for key in its or ()]
    known += [f"measures.{one}.{key}" for one, its in measures.items() for key in its or ()]
    sections = "run, external, connections[...].through, bonds, measures, title"
    allowed = f"instances: {listed(instances)}; sections: {sections}"
    return Problem(place, f"no {name!r} to set", allowed, nearest(name, known))


_HANDLING = ("interface", "tolerance", "event_mode", "any_step", "isolate", "time_limit", "step_size")


def override_path(data: dict[str, Any], name: str) -> Path | None:
    """Where an override goes: robot.tau_m is short for instances.robot.start.tau_m."""
    if name.startswith("connections["):
        return _connection_path(data, name)
    head, _, rest = name.partition(".")
    instances = _section(data, "instances")
    if head == "instances":
        head, _, rest = rest.partition(".")
        key, _, variable = rest.partition(".")
        if key in _HANDLING and not variable and head in instances:
            return ("instances", head, key)
        if key in ("start", "feedthrough") and variable and head in instances:
            return ("instances", head, key, variable)
    if head in instances and rest:
        return ("instances", head, rest) if rest in ("fmu", "form") else ("instances", head, "start", rest)
    if head == "run" and rest in RunModel.model_fields:
        return ("run", rest)
    if head == "run" and rest.startswith("realtime.") and "." not in rest[9:]:
        return ("run", "realtime", rest[9:])
    if head == "external":
        one, _, key = rest.partition(".")
        return ("external", one, *key.split(".")) if one in _section(data, head) and key else None
    if head == "run" and rest.startswith("master.") and "." not in rest[7:]:
        return ("run", "master", rest[7:])
    if head == "measures":
        measure, _, option = rest.partition(".")
        return (
            ("measures", measure, *option.split(".")) if measure in _section(data, head) and option else None
        )
    return (name,) if name in ("title", "bonds") else None


_CONNECTION = re.compile(r"connections\[([^]]+)\]\.(through)(?:\[(\d+)\]\.([\w-]+(?:\.[\w-]+)*))?")


def _connection_path(data: dict[str, Any], name: str) -> Path | None:
    """Where connections[3].through, or connections[3].through[0].delay, goes.

    In place of the number stands the target of the connection as well: connections[sensor.force].
    """
    match = _CONNECTION.fullmatch(name)
    connections = data.get("connections")
    if match is None or not isinstance(connections, list):
        return None
    targets = [
        str(one.get("to", "") if isinstance(one, dict) else str(one).rpartition("->")[2]).strip()
        for one in connections
    ]
    number = int(match[1]) if match[1].isdecimal() else targets.index(match[1]) if match[1] in targets else -1
    if not 0 <= number < len(connections):
        return None
    if match[3] is None:
        return ("connections", number, "through")
    through = connections[number].get("through") if isinstance(connections[number], dict) else None
    if not isinstance(through, list) or int(match[3]) >= len(through):
        return None
    return ("connections", number, "through", int(match[3]), *match[4].split("."))


def _section(data: Any, key: str) -> dict[str, Any]:
    found = data.get(key) if isinstance(data, dict) else None
    return found if isinstance(found, dict) else {}


def put_value(data: dict[str, Any], path: Path, value: Any) -> None:
    """Set a value of a config's plain values, at a path that `override_path` gave."""
    if path[0] == "connections":
        # An effect is put on a connection that is written as an arrow, too.
        one = data["connections"][path[1]]
        if isinstance(one, str):
            source, _, target = one.partition("->")
            data["connections"][path[1]] = {"from": source.strip(), "to": target.strip()}
    for part in path[:-1]:
        if isinstance(data, list):
            data = data[part]
            continue
        if not isinstance(data.get(part), dict | list):
            # A master without options is written as its name alone.
            bare = path[:2] == ("run", "master") and isinstance(data.get(part), str)
            data[part] = {"name": data[part]} if bare else {}
        data = data[part]
    data[path[-1]] = value
