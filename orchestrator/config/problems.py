"""What pydantic found -> problems with places."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, get_args, get_origin

from pydantic import BaseModel, ValidationError

from ..base.errors import Problem, close, listed, nearest
from .models import ConnectionModel, SourceModel
from .text import Path, Places, path_text
from .unresolved import Gaps

# Of pydantic's locations: key checks, and members of unions that are distinguished by a tag.
_MARKS = ("[key]", "[list]", "[range]")
# Of the other unions there are: that of `bonds`, and those in bonds and in external ones.
_MEMBER = re.compile(r"(str|constrained-str|ReceivedModel|(literal|list|function-after)\[.*\])")


def validation_problems(
    error: ValidationError,
    places: Places,
    prefix: Path,
    model: type[BaseModel],
    gaps: Gaps | None = None,
) -> list[Problem]:
    """Pydantic's errors as problems with places; one for each value, also where several forms are allowed.

    Args:
        error: what pydantic raised for `model`.
        places: where the values were written.
        prefix: path of the validated value in the config.
        gaps: where it is not known; nothing is reported to be missing there.
    """
    problems: dict[Path, Problem] = {}
    errors = error.errors(include_url=False)
    misspelt = _misspelt(errors, model)
    for item in errors:
        if item["loc"] in misspelt and item["type"] == "missing":
            continue
        path = prefix + _plain_path(item["loc"][:-1] if _is_scalar(item) else item["loc"])
        if is_of_another_form(item):
            continue
        if item["type"] == "missing" and gaps is not None and not gaps.knows(*path):
            continue
        place = places.text(path)
        kind = item["type"]
        if kind == "missing" and path[:1] != ("connections",):
            problem = Problem(
                places.text(path[:-1]), f"{path_text(path[-1:])} is missing", "it has no default"
            )
        elif kind == "extra_forbidden" and path[:1] != ("connections",):
            problem = unknown_key(places, path, _keys(model, item["loc"][:-1]))
        elif kind == "model_type" and path[:1] != ("connections",):
            names = _keys(model, item["loc"])
            what = f"got {item['input']!r}"
            problem = Problem(place, what, f"keys and their values: {listed(names)}" if names else "keys")
        elif path[:1] == ("connections",) and len(path) > 1:
            got = item["input"]
            if item["loc"][2:3] != ("ConnectionModel",) or item["loc"][2:] == ("ConnectionModel",):
                if isinstance(got, dict):
                    continue  # that it is no arrow is not what is wrong with it
                path = path[:2]
                what = f"cannot read connection {got!r}"
            elif kind in ("missing", "extra_forbidden"):
                path = (*path[:2], item["loc"][-1])
                names = _keys(model, item["loc"][:-1])
                if kind == "missing":
                    problem = Problem(places.text(path[:2]), f"{path[-1]} is missing", "it has no default")
                else:
                    problem = unknown_key(places, path, names)
                problems.setdefault(path, problem)
                continue
            else:
                what = f"cannot read {path[2] if len(path) > 2 else 'it'}: {got!r}"
            form = "written as a.output -> b.input or {from: a.output, to: b.input}"
            if path[2:] == ("through",):
                form = "a list of effects, written as [{delay: 1 ms}]"
            problem = Problem(places.text(path), what, form)
        elif path[:1] == ("instances",) and kind == "string_pattern_mismatch":
            what = f"{item['input']!r} cannot name an instance"
            problem = Problem(place, what, "letters, digits, _ and -, beginning with a letter or _")
        elif (path[2:3] == ("start",) and len(path) == 4) or _is_scalar(item):
            named = "start value" if path[2:3] == ("start",) else "value"
            what = f"{item['input']!r} is no {named}"
            further = ", of an array a list of those" if named == "start value" else ""
            problem = Problem(place, what, "a number, a quantity such as 6 ms, true, false or text" + further)
        else:
            message = item["msg"].removeprefix("Value error, ")
            if kind != "value_error":
                message = f"{message[0].lower()}{message[1:]}, got {item['input']!r}"
            names = re.findall(r"'([^']+)'", item.get("ctx", {}).get("expected", ""))
            problem = Problem(place, message, remedy=nearest(str(item["input"]), names))
        problems.setdefault(path, problem)
    return list(problems.values())


def unknown_key(places: Places, path: Path, names: Sequence[str]) -> Problem:
    """The problem of a key that is none of `names`."""
    what, allowed = f"unknown key {path[-1]!r}", f"allowed: {listed(names)}"
    return Problem(places.text(path), what, allowed, nearest(str(path[-1]), names))


def path_within(data: Any, location: Sequence[str | int]) -> Path:
    """Pydantic's location as a path of the data: without names of union members and the like."""
    path: list[str | int] = []
    for part in location:
        there = isinstance(data, Mapping) and part in data
        if there or (isinstance(data, list) and isinstance(part, int) and part < len(data)):
            data = data[part]
            path.append(part)
    return tuple(path)


def _misspelt(errors: Iterable[Any], model: type[BaseModel]) -> set[tuple[str | int, ...]]:
    """Locations of keys that unknown ones are most likely meant for: that those are missing is no news."""
    unknown = [item["loc"] for item in errors if item["type"] == "extra_forbidden"]
    return {
        (*location[:-1], meant)
        for location in unknown
        for meant in close(str(location[-1]), _keys(model, location[:-1]))[:1]
    }


def _plain_path(location: tuple[str | int, ...]) -> Path:
    """Pydantic's location without the names of union members and of key checks."""
    if location[:1] == ("connections",):
        inner = tuple(part for part in location[2:] if part in ("from", "to", "through"))
        return (*location[:2], *inner)
    if location[:2] == ("run", "record"):
        return tuple(part for part in location if isinstance(part, int) or part in ("run", "record"))
    if location[:1] in (("bonds",), ("external",)):
        named = 1 if location[0] == "bonds" else 4
        location = (*location[:named], *(one for one in location[named:] if not _is_member(one)))
    if location[:1] == ("instances",) and len(location) > 3 and location[2] == "start":
        return location[:4]
    return tuple(part for part in location if part not in _MARKS)


def _is_scalar(item: Any) -> bool:
    """Whether an error is one of those of a value that may be a number, text, true or false."""
    kind, last = item["type"], item["loc"][-1:]
    if item["loc"][:1] in (("connections",), ("external",), ("bonds",)):
        return False
    return last in (("bool",), ("int",), ("float",), ("str",)) and kind.startswith(str(last[0]))


def _is_member(part: str | int) -> bool:
    return isinstance(part, str) and _MEMBER.fullmatch(part) is not None


def is_of_another_form(item: Any) -> bool:
    """Whether an error only says that a list or a mapping, whose own errors are reported, is no text."""
    kind, got, location = item["type"], item["input"], item["loc"]
    if kind == "literal_error":
        return isinstance(got, list) and (location[:2] == ("run", "record") or location[:-1] == ("bonds",))
    if kind != "string_type":
        return False
    if location[:1] == ("connections",):
        return isinstance(got, list | dict) and "from" in location
    if location[:1] == ("bonds",):
        return isinstance(got, list)
    return isinstance(got, dict) and location[2:3] == ("receive",)


def _keys(model: type[BaseModel], location: tuple[str | int, ...]) -> list[str]:
    """Keys allowed at a location."""
    if location[:1] == ("connections",) and "ConnectionModel" in location:
        return names_of(SourceModel if "SourceModel" in location else ConnectionModel)
    current: Any = model
    for part in location:
        if part in _MARKS or _is_member(part):
            continue
        fields = getattr(_unwrapped(current), "model_fields", None)
        if fields is not None:
            named = {found.alias or name: found.annotation for name, found in fields.items()}
            current = named.get(str(part))
        else:
            current = _model_in(current)
    return names_of(_unwrapped(current))


def _unwrapped(annotation: Any) -> Any:
    """The model that a value of an annotation is if it is a mapping of its own; else the annotation."""
    if isinstance(annotation, type) or get_origin(annotation) in (list, dict):
        return annotation
    return next(
        (one for arg in get_args(annotation) if hasattr(one := _unwrapped(arg), "model_fields")), annotation
    )


def names_of(model: Any) -> list[str]:
    """Keys of a model as they are written; none of what is no model."""
    return [found.alias or name for name, found in getattr(model, "model_fields", {}).items()]


def _model_in(annotation: Any) -> Any:
    """The first model within an annotation; None without one."""
    if hasattr(annotation, "model_fields"):
        return annotation
    return next((found for one in get_args(annotation) if (found := _model_in(one)) is not None), None)
