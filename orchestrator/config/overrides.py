"""Overrides: changes of single values of a config, by short paths such as robot.tau_m or run.step_size."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

from ..base.errors import ConfigError, Problem, close, listed, nearest
from .files import move_value
from .models import RunModel
from .text import Path, Place, Places, parse
from .unresolved import FURTHER


def override(
    data: dict[str, Any], places: Places, text: str, moved: Callable[[str], str]
) -> tuple[list[Problem], list[Path]]:
    """Apply one override.

    Args:
        moved: what the config has for a file that the override names.
    Returns: problems found, and the paths that it may have been meant for if it has some.
    """
    place = f"--set {text}"
    name, equals, value_text = (part.strip() for part in text.partition("="))
    if not equals or not name:
        what = 'written as path=value, for example robot.tau_m="6 ms"'
        return [Problem(place, "not an override", what)], []
    path = override_path(data, name)
    problems = [] if path is not None else [unknown_path(data, name, place)]
    try:
        value, _ = parse(value_text, place)
    except ConfigError as error:
        problems += error.problems
    if path is None or problems:
        return problems, _likely_paths(data, name) if path is None else [path]
    if _reached(data, path):
        put_value(data, path, move_value(path, value, moved))
        # What was written within the former value is gone.
        for old in [one for one in places.known if one[: len(path)] == path]:
            del places.known[old]
        places.known[path] = Place(place)
    return [], []


def _likely_paths(data: dict[str, Any], name: str) -> list[Path]:
    """What an override that leads nowhere may have been meant for, where other checks need to know."""
    head, _, rest = name.partition(".")
    if head == "run":
        return [("run", key) for key in close(rest, RunModel.model_fields)[:1]]
    return [("instances", one, "start", FURTHER) for one in close(head, _section(data, "instances"))]


def _reached(data: dict[str, Any], path: Path) -> bool:
    """Whether there is nothing on the way to a path that has to be put right first."""
    found: Any = data
    for length, part in enumerate(path[:-1], 1):
        found = found.get(part) if isinstance(found, dict) else found[part]
        short = path[:length] == ("run", "master") or (length == 2 and path[0] == "connections")
        if (isinstance(found, str) and short) or found is None:
            return found is not None or path[0] != "connections"
        if not isinstance(found, list if isinstance(path[length], int) else dict):
            return False
    return True


def unknown_path(data: dict[str, Any], name: str, place: str) -> Problem:
    """The problem of a path that `override_path` does not know."""
    instances, measures = _section(data, "instances"), _section(data, "measures")
    known = [f"run.{key}" for key in RunModel.model_fields]
    known += [f"{one}.{key}" for one, its in instances.items() for key in _section(its, "start")]
    connections = data.get("connections")
    for n, one in enumerate(connections if isinstance(connections, list) else ()):
        through = one.get("through") if isinstance(one, dict) else None
        for m, its in enumerate(through if isinstance(through, list) else ()):
            keys = its if isinstance(its, dict) else ()
            known += [f"connections[{n}].through[{m}].{key}" for key in keys]
    known += [f"measures.{one}.{key}" for one in measures for key in _section(measures, one)]
    sections = "run, external, connections[...].through, bonds, measures, title"
    allowed = f"instances: {listed(instances)}; sections: {sections}"
    remedy = nearest(name, known)
    if not remedy and instances and "." not in name:
        remedy = f"Write {next(iter(instances))}.{name} for a start value of the instance."
    return Problem(place, f"no {name!r} to set", allowed, remedy)


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
    if head == "start" and rest and len(instances) == 1 and head not in instances:
        return ("instances", next(iter(instances)), "start", rest)
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
