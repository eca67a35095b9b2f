"""Check the rows of a log: rows without numbers, and a clock that differs from the stated one."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Array
from ...base.errors import Problem
from ...base.units import UnitError, convert, parse_unit
from .logs import Signal

# By how much of the tick a log's own step may differ from it; and rows of a clock from their even place.
_APART, _UNEVEN = 0.01, 0.1
# Squares of values, and slopes between them, have to be finite.
_LARGEST = 1e150
# What the quartzes of two clocks differ by.
_QUARTZ = 1e-4
_CLOCKS = ("t", "time", "timestamp", "stamp", "zeit", "seconds", "sec")
# Of clocks without unit [s]: what their values may be counted in.
_COUNTED = (1.0, 1e-3, 1e-6, 1e-9)
# Share of the rows that a compared column may lack.
_MOST_GAPS = 0.1
_COMMA = re.compile(r"\s*[+-]?\d+,\d+([eE][+-]?\d+)?\s*")
_DATE = re.compile(r"\s*\d{1,4}[-./]\d{1,2}[-./]\d{1,4}([T ].*)?")


class _Named(Protocol):
    column: str


def clock_slack(rows: int, step: float) -> float:
    """By how much the time that rows take may be another than their steps add up to [s]: by one of these, and
    by what clocks differ by anyway.
    """
    return step * (1.0 + _QUARTZ * rows)


def clock_of_stamps(time: Array, step: float) -> str:
    """Duration of rows by their stamps, and its difference from the sum of their steps.

    Args:
        time: stamps, shape (n,) [s], n at least 2; step: from one row to the next, as is believed [s].
    """
    taken, whole = float(time[-1] - time[0]), step * (len(time) - 1)
    share = 100.0 * (taken / whole - 1.0)
    return (
        f"by their stamps {len(time)} rows take {taken:.6g} s, {abs(share):.2g} % "
        f"{'more' if share > 0.0 else 'less'} than as many steps of {step:.6g} s"
    )


def unmapped_clock(
    path: Path, log: Mapping[str, Signal], mapped: Collection[str], tick: float, key: str
) -> Iterator[Problem]:
    """A column that is a clock by its unit or name, and disagrees with the tick.

    Args:
        path, log: what is read.
        mapped: columns that are signals.
        tick: from one row to the next, as is believed [s].
        key: what sets the tick.
    """
    others = []
    for name, signal in log.items():
        scales = _scales(name, signal) if name not in mapped and not signal.flaw else ()
        step = _step(signal.values) if scales else 0.0
        if not step > 0.0:
            continue
        if any(abs(step * scale / tick - 1.0) <= _APART for scale in scales):
            return  # one clock that agrees is enough: another may count from somewhere else
        others.append((name, signal.unit, step))
    if others:
        name, unit, step = others[0]
        per_row = f"{step:.6g} {unit}" if unit else f"{step:.6g}, without a unit,"
        entry = f"time: {name}" if unit else f"time: {{column: {name}, unit: s}}"
        yield Problem(
            str(path),
            f"time is not mapped, and column {name} rises by {per_row} from row to row",
            f"{tick:.6g} s, of {key}",
            f"Map `{entry}` under columns, or set {key}; rename the column if it holds no time.",
        )


def _scales(name: str, signal: Signal) -> tuple[float, ...]:
    """Possible units of a clock's values [s]; none if the column is no clock."""
    if signal.unit:
        try:
            return (convert(parse_unit(signal.unit), parse_unit("s"))[0],)
        except UnitError:
            return ()
    return _COUNTED if re.split(r"[./]", name)[-1].casefold() in _CLOCKS else ()


def _step(values: Array) -> float:
    """From row to row of a column that rises evenly; 0 for others."""
    if len(values) < 3 or not np.isfinite(values).all():
        return 0.0
    apart = np.diff(values)
    usual = float(np.median(apart))
    even = np.abs(apart - usual) <= _UNEVEN * usual
    # Some rows may come late, or be lost.
    return usual if usual > 0.0 and apart.min() > 0.0 and even.mean() > 0.9 else 0.0


def unread_rows(
    path: Path,
    signals: Mapping[str, Signal],
    mapping: Mapping[str, _Named],
    rows: Mapping[str, NDArray[np.intp]],
    has_parts: bool,
    gappy: Collection[str] = (),
) -> Iterator[Problem]:
    """Columns with rows that hold no number, or one whose square is none.

    Args:
        path: of the log, for the message.
        signals, mapping: what is read, and from which columns.
        rows: numbers of the rows that are taken, by signal.
        has_parts: whether a part of the log can be asked for.
        gappy: signals that may lack a few rows, but not the first and the last one.
    """
    for name, signal in signals.items():
        wrong = rows[name][~(np.abs(signal.values[rows[name]]) < _LARGEST)]
        if not len(wrong):
            continue
        # Text in place of a number is a mistake; what is not there is a gap.
        gaps = all(
            np.isnan(signal.values[k]) and (signal.written is None or signal.written[k] in (None, ""))
            for k in wrong.tolist()
        )
        ends = {int(rows[name][0]), int(rows[name][-1])}
        if name in gappy and gaps and len(wrong) <= _MOST_GAPS * len(rows[name]) and not ends & {*wrong}:
            continue
        row = int(wrong[0])
        held = signal.values[row] if signal.written is None else signal.written[row]
        # Columns of numbers can only hold text and empty cells besides.
        content = "nothing" if held in (None, "") else repr(held) if isinstance(held, str) else str(held)
        if signal.written is None and np.isnan(held):
            content = "nothing, or nan"
        remedy = "Correct the log there" + (
            ", or take a part without it, by `from` and `to`." if has_parts else "."
        )
        if isinstance(held, str) and _COMMA.fullmatch(held):
            remedy = f"Write decimal points: {held.strip().replace(',', '.')}."
        if name in gappy and gaps:
            remedy += f" Up to {100 * _MOST_GAPS:g} % of its rows may be empty, but not the first or last."
        allowed = f"a number below {_LARGEST:g}" if np.isfinite(signal.values[row]) else "a number"
        if isinstance(held, str) and _DATE.fullmatch(held):
            allowed = "a number, or a date as ISO 8601 has it, 2026-03-04T09:15:00.250"
            remedy = "Write dates so, with a decimal point and the year first, or times as seconds."
        place = f"{path}:{signal.line + row}" if signal.line is not None else str(path)
        what = f"row {row} of column {mapping[name].column} holds {content}"
        yield Problem(f"{place}: {name}", what, f"{allowed}; {len(wrong)} such in all", remedy)
