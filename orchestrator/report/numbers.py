"""The numbers of a summary in the form that tables need; knows nothing of what is measured."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from ..base.text_tables import OWN
from ..plotting.page import table


@dataclass(frozen=True)
class KeyNumber:
    """A number of a measure.

    Attributes:
        name: path in the summary, for example ideal.cor.
        change: by half the step size; None where it is not known.
    """

    name: str
    value: float | int
    unit: str
    change: float | None


def spelt(name: str) -> str:
    """A key as words."""
    return name.replace("_", " ").replace(".", ": ")


def key_numbers(summary: Mapping[str, Any], units: Mapping[str, str]) -> list[KeyNumber]:
    """Single numbers of the measures, and the last entry's of each of their lists is left to the tables.

    Args:
        units: by the number's key.
    """
    numerics = summary.get("numerics") or {}
    return [
        KeyNumber(name, value, units.get(name.rpartition(".")[2], ""), change)
        for key, content in summary.items()
        if key not in OWN
        for name, value, change in _leaves(key, content, numerics.get(key))
    ]


def _leaves(name: str, value: Any, change: Any) -> Iterator[tuple[str, float, float | None]]:
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _leaves(
                f"{name}.{key}", inner, change.get(key) if isinstance(change, Mapping) else None
            )
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield name, value, change if isinstance(change, int | float) else None


def measure_tables(summary: Mapping[str, Any], units: Mapping[str, str]) -> list[tuple[str, str]]:
    """Lists of the measures as tables, with the largest change of each column by half the step size below.

    Returns: of each its key and HTML.
    """
    numerics = summary.get("numerics") or {}
    found = []
    for key, value in summary.items():
        rows = value if isinstance(value, list) else []
        if key in OWN or not rows or not all(isinstance(row, Mapping) for row in rows):
            continue
        names = list(dict.fromkeys(name for row in rows for name in row))
        changed = [one for one in numerics.get(key) or [] if isinstance(one, Mapping)]
        foot = ["change", *(_largest([one.get(name) for one in changed]) for name in names)]
        columns = ["no.", *(_head(name, units) for name in names)]
        found.append(
            (
                key,
                table(
                    columns,
                    [[number, *(row.get(name) for name in names)] for number, row in enumerate(rows, 1)],
                    keys=[f"{key}.{number}" for number in range(1, len(rows) + 1)],
                    caption="Last line: the largest change of the column by half the step size."
                    if changed
                    else "",
                    foot=foot if changed else None,
                ),
            )
        )
    return found


def _head(name: str, units: Mapping[str, str]) -> str:
    return f"{spelt(name)} [{units[name]}]" if name in units else spelt(name)


def _largest(values: list[Any]) -> str | None:
    numbers = [abs(one) for one in values if isinstance(one, int | float) and not isinstance(one, bool)]
    return f"{max(numbers):.1e}" if numbers else ""


def coupling_table(summary: Mapping[str, Any]) -> str:
    """The ledger of the power bonds; empty without bonds."""
    coupling = summary.get("coupling") or {}
    changes = (summary.get("numerics") or {}).get("coupling") or {}
    if not coupling:
        return ""
    rows = [
        [
            name,
            one["exchanged"],
            one["created"],
            None if one["relative"] is None else 100.0 * one["relative"],
            None
            if one["relative"] is None or (changes.get(name) or {}).get("relative") is None
            else 100.0 * changes[name]["relative"],
        ]
        for name, one in coupling.items()
    ]
    columns = [
        "power bond",
        "exchanged [J]",
        "created by the coupling [J]",
        "created [%]",
        "change at half the step [%]",
    ]
    return table(columns, rows, keys=[f"coupling.{name}" for name in coupling])
