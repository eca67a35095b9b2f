"""A summary as text for terminals; knows nothing of what is measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

__all__ = ["summary_text"]

_OWN = ("title", "config", "run", "numerics", "parameters", "provenance", "error")
_MOST_ROWS = 30


def summary_text(summary: Mapping[str, Any]) -> str:
    """What was measured, each number with its change at half the step size in parentheses."""
    numerics = summary.get("numerics") or {}
    lines = [_heading(summary)]
    for key, value in summary.items():
        if key not in _OWN:
            lines += _section(key, value, numerics.get(key))
    if not any(key not in _OWN for key in summary) and "signals" in numerics:
        rows = [
            {"signal": name, "largest change": one["max_change"], "over its range": one["relative"]}
            for name, one in numerics["signals"].items()
        ]
        lines += _section("change at half the step size", rows, None)
    elif numerics and "error" not in numerics:
        lines.append("In parentheses: change at half the step size.")
    if "error" in numerics:
        message = numerics["error"]["message"].splitlines()[0]
        lines.append(
            f"The run with half the step size failed, so nothing is known of the step's effect: {message}"
        )
    return "\n".join(lines)


def _heading(summary: Mapping[str, Any]) -> str:
    run = summary["run"]
    text = (
        f"{run['steps']} steps of {run['step_size']:g} s, {run['master']}, in {run['wall_time']:.2f} s: "
        f"{run['real_time_factor']:.3g} times real time"
    )
    return f"{summary['title']}\n{text}" if summary.get("title") else text


def _section(key: str, value: Any, change: Any) -> list[str]:
    if isinstance(value, list) and value and all(isinstance(item, Mapping) for item in value):
        return [f"{key}:", *_table(value, change if isinstance(change, list) else [])]
    if isinstance(value, Mapping):
        inner = change if isinstance(change, Mapping) else {}
        return [f"{key}:", *(f"  {name}: {_cell(item, inner.get(name))}" for name, item in value.items())]
    return [f"{key}: {_cell(value, change)}"]


def _table(rows: Sequence[Mapping[str, Any]], changes: Sequence[Any]) -> list[str]:
    names = list(dict.fromkeys(name for row in rows for name in row))
    cells = [["", *names]]
    for index, row in enumerate(rows[:_MOST_ROWS]):
        change = changes[index] if index < len(changes) and isinstance(changes[index], Mapping) else {}
        cells.append([str(index + 1), *(_cell(row.get(name), change.get(name)) for name in names)])
    widths = [max(len(row[column]) for row in cells) for column in range(len(names) + 1)]
    lines = [
        "  " + "  ".join(text.rjust(width) for text, width in zip(row, widths, strict=True)) for row in cells
    ]
    if len(rows) > _MOST_ROWS:
        lines.append(f"  and {len(rows) - _MOST_ROWS} more")
    return lines


def _cell(value: Any, change: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        text = f"{value:.6g}"
        return f"{text} ({change:+.1e})" if isinstance(change, int | float) else text
    if isinstance(value, list):
        return f"{len(value)} values"
    return str(value)
