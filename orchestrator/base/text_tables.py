"""Tables for terminals and notebooks, and a summary as text; knows nothing of what is measured."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any

# Keys of every summary; the others hold what measures found.
OWN = ("title", "config", "run", "numerics", "parameters", "provenance", "error", "coupling", "notes")
_MOST_ROWS = 30
# What a coupling may create of what it exchanges before it is spoken of.
_CREATED = 0.01


def html_table(rows: Iterable[Sequence[Any]], columns: Sequence[str] = ()) -> str:
    """A table in HTML, for notebooks; numbers have six digits.

    Args:
        columns: their heads; none: a table without a head.
    """
    lines = [*([("th", columns)] if columns else []), *(("td", row) for row in rows)]
    body = ("".join(f"<{tag}>{escape(_cell(one))}</{tag}>" for one in cells) for tag, cells in lines)
    return f"<table>{''.join(f'<tr>{one}</tr>' for one in body)}</table>"


def summary_text(summary: Mapping[str, Any]) -> str:
    """What was measured, and by how much half the step size changes it."""
    numerics = summary.get("numerics") or {}
    lines = [_heading(summary)]
    for key, value in summary.items():
        if key not in OWN:
            lines += _section(key, value, numerics.get(key))
    measured = any(key not in OWN for key in summary)
    if not measured and numerics.get("signals") == {}:
        lines.append(
            "No signal was recorded: no FMU has an output, or run.record is empty. It takes any variable."
        )
    elif not measured and "signals" in numerics:
        rows = [
            {"signal": name, "largest change": one["max_change"], "over its range": one["relative"]}
            for name, one in numerics["signals"].items()
        ]
        lines += _section("change at half the step size", rows, None)
    elif numerics and "error" not in numerics:
        lines.append("+-: change at half the step size; under a table, the largest of each column.")
    lines += remarks(summary)
    return "\n".join(lines)


def remarks(summary: Mapping[str, Any]) -> list[str]:
    """Warnings for the reader: energy from the coupling, missed deadlines, lost datagrams."""
    numerics, run = summary.get("numerics") or {}, summary.get("run") or {}
    lines = _created(summary.get("coupling") or {}, numerics.get("coupling") or {})
    if ended := run.get("ended"):
        lines.append(
            f"{ended['instance']} ended the simulation at {ended['time']:.12g} s, "
            f"before the stop time of {run['stop_time']:.12g} s."
        )
    lines += _punctuality(run.get("realtime"))
    for name, link in run.get("external", {}).items():
        lines.append(
            f"{name}: {link['sent']} datagrams sent, {link['received']} received, {link['lost']} lost, "
            f"{link['reordered']} out of order; round trip {_milliseconds(link['round_trip'])}"
        )
    for name, warnings in run.get("log", {}).items():
        lines.append(f"{name} logged {len(warnings)} warnings; the last: {warnings[-1]}")
    if "error" in numerics:
        message = numerics["error"]["message"].splitlines()[0]
        how = "was not made" if numerics["error"].get("kind") == "NotMade" else "failed"
        lines.append(
            f"The run with half the step size {how}, so nothing is known of the step's effect: {message}"
        )
    return lines


def _created(coupling: Mapping[str, Any], changed: Mapping[str, Any]) -> list[str]:
    """Power bonds at which the coupling created or destroyed much energy."""
    lines = []
    for name, one in coupling.items():
        share = one["relative"]
        if share is None or abs(share) <= _CREATED:
            continue
        change = (changed.get(name) or {}).get("relative")
        halved = f", {abs(share + change):.2%} at half the step size" if change is not None else ""
        verb = "created" if one["created"] > 0 else "destroyed"
        lines.append(
            f"The coupling {verb} {abs(one['created']):.3g} J at {name}, {abs(share):.2%} of what it "
            f"exchanged{halved}: take a smaller step size or another master."
        )
    return lines


def _punctuality(realtime: Mapping[str, Any] | None) -> list[str]:
    """How well a paced run kept to the clock."""
    if realtime is None:
        return []
    missed = f"{realtime['missed']} of {realtime['steps']} deadlines missed"
    if realtime["missed"]:
        missed += (
            f", at most {realtime['longest_row_of_misses']} in a row, the worst by "
            f"{1e3 * realtime['worst_miss']:.3g} ms"
        )
    return [
        f"paced at {realtime['speed']:g} times real time ({realtime['scheduler']}): {missed}; steps began "
        f"{_milliseconds(realtime['latency'])} late and took {_milliseconds(realtime['busy'])}"
    ]


def _milliseconds(times: Mapping[str, Any]) -> str:
    return (
        f"{1e3 * times['median']:.3g} ms (99 %: {1e3 * times['p99']:.3g} ms, "
        f"largest: {1e3 * times['max']:.3g} ms)"
    )


def _heading(summary: Mapping[str, Any]) -> str:
    run = summary["run"]
    # The ratio is of the time that stands beside it; loading and initialising are distinguished.
    text = (
        f"{run['steps']} steps of {run['step_size']:g} s, {run['master']}, "
        f"in {_seconds(run['stepping_time'])}: {run['real_time_factor']:.3g} times real time; "
        f"{_seconds(run['wall_time'])} with loading"
    )
    return f"{summary['title']}\n{text}" if summary.get("title") else text


def _seconds(time: float) -> str:
    return f"{time:.2f} s" if time >= 0.1 else f"{1e3 * time:.2g} ms"


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
    cells += [
        [str(n), *(_cell(row.get(name)) for name in names)] for n, row in enumerate(rows[:_MOST_ROWS], 1)
    ]
    if len(rows) > _MOST_ROWS:
        cells.append(["...", *[""] * len(names)])
    known = [change for change in changes if isinstance(change, Mapping)]
    if known:
        cells.append(["+-", *(_largest([change.get(name) for change in known]) for name in names)])
    widths = [max(len(row[column]) for row in cells) for column in range(len(names) + 1)]
    return [
        "  " + "  ".join(text.rjust(width) for text, width in zip(row, widths, strict=True)) for row in cells
    ]


def _largest(changes: Sequence[Any]) -> str:
    numbers = [abs(change) for change in changes if isinstance(change, int | float)]
    return f"{max(numbers):.1e}" if numbers else ""


def _cell(value: Any, change: Any = None) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        text = f"{value:.6g}"
        return f"{text} +- {abs(change):.1e}" if isinstance(change, int | float) and change else text
    if isinstance(value, list):
        return f"{len(value)} values"
    return str(value)
