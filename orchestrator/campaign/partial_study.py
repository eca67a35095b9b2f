"""A study that is not right everywhere: what of it can be read."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from pydantic import ValidationError

from ..base.errors import Problem
from ..config import Places, copied, path_within, validation_problems
from .models import BlockModel, StudyModel

# In place of keys that a study needs and that are wrong.
_NEEDED = {"format": "sweep/1", "system": "", "design": {"list": [{"": 0}]}}


def read_study(
    data: Mapping[str, Any], places: Places, problems: list[Problem]
) -> tuple[StudyModel, frozenset[str], bool]:
    """The model of a study's plain values.

    Args:
        problems: what is wrong is added.
    Returns: the model, keys that say nothing in it because they are wrong, and whether the design is whole;
        it may lack values that it varies.
    """
    try:
        return StudyModel.model_validate(data), frozenset(), True
    except ValidationError as error:
        problems += validation_problems(error, places, (), StudyModel)
        paths = [
            (*path, one["loc"][-1]) if one["type"] == "missing" else path
            for one in error.errors(include_url=False)
            for path in (path_within(data, one["loc"]),)
        ]
    wrong = frozenset(str(path[0]) for path in paths if path)
    sound = {key: value for key, value in data.items() if key not in wrong}
    if isinstance(data.get("set"), Mapping):
        entries = {path[1] for path in paths if path[0] == "set" and len(path) > 1}
        sound["set"] = {key: value for key, value in data["set"].items() if key not in entries}
    unread, whole = wrong - {"set"}, "design" not in wrong
    if not whole and (design := _without(data.get("design"), paths)) is not None:
        sound["design"], unread = design, unread - {"design"}
    return StudyModel.model_validate(_NEEDED | sound), unread, whole


def _without(design: Any, paths: Iterable[tuple[str | int, ...]]) -> Any:
    """A design without the values that are wrong; None if it is not known what is meant then."""
    design = copied(design)
    for path in paths:
        if path[:1] != ("design",) or len(path) < 2:
            continue
        named = [n + 1 for n, part in enumerate(path[:-1]) if part in ("grid", "over")]
        last = named[0] if named else len(path) - 1
        inner = design
        for part in path[1:last]:
            inner = inner.get(part) if isinstance(inner, dict) else inner[part] if inner else None
        if isinstance(inner, dict):
            inner.pop(path[last], None)
    try:
        BlockModel.model_validate(design)
    except ValidationError:
        return None
    return design
