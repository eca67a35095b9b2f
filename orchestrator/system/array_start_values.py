"""Start values of whole arrays -> those of their elements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ..base.errors import Problem
from ..config import Places, Scalar
from ..fmi import ModelDescription, Variable


def elementwise(
    instance: str,
    description: ModelDescription,
    start: Mapping[str, Any],
    places: Places,
    problems: list[Problem],
) -> dict[str, Scalar]:
    """Start values by the names of scalars and of elements.

    Args:
        start: as a config gives them; arrays as lists, those of two dimensions as lists of rows.
        places, problems: what is wrong is added.
    Returns: what is right; what no array is meant by stays as it is.
    """
    found: dict[str, Scalar] = {}
    for name, value in start.items():
        members = () if name in description.variables else description.elements(name)
        if not members:
            found[name] = value
            continue
        place = places.text(("instances", instance, "start", name))
        made = each_element(name, members, value)
        twice = [one for one in made or () if one in start]
        if made is None:
            what = f"{instance}.{name} is an array of {_sizes_text(_shape(members, name))}, got {_got(value)}"
            remedy = "Give a list of its values, row by row, or single elements by their names."
            problems.append(Problem(place, what, remedy=remedy))
        elif twice:
            what = f"{instance}.{twice[0]} is given twice, by itself and in {name}"
            problems.append(Problem(place, what, remedy="Remove one of the two."))
        found |= {one: v for one, v in (made or {}).items() if one not in start}
    return found


def each_element(name: str, members: Sequence[Variable], value: Any) -> dict[str, Scalar] | None:
    """Values of the elements of an array; None if these are not as many, in as many rows."""
    sizes = _shape(members, name)
    rows = [value]
    for size in sizes:
        if not all(isinstance(row, list) and len(row) == size for row in rows):
            return None
        rows = [one for row in rows for one in row]
    if len(rows) != len(members) or any(isinstance(one, list) for one in rows):
        return None
    return {one.name: scalar for one, scalar in zip(members, rows, strict=True)}


def _shape(members: Sequence[Variable], name: str) -> list[int]:
    """Dimensions; the last element has the largest indices."""
    return [int(text) for text in members[-1].name[len(name) + 1 : -1].split(",")]


def _sizes_text(sizes: Sequence[int]) -> str:
    return f"{sizes[0]} values" if len(sizes) == 1 else f"{' x '.join(map(str, sizes))} values"


def _got(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 or not isinstance(value, list) else f"a list of {len(value)}"
