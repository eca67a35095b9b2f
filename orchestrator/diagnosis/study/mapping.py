"""Mapping from columns of a log to signals of a study: names, units, signs, clocks."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, ValidationError

from ...base.arrays import Array
from ...base.errors import Problem, listed, nearest
from ...base.quantities import Measure, quantity
from ...base.units import UnitError, convert, known_unit, parse_unit
from ...config import Places, validation_problems
from .log_checks import unmapped_clock, unread_rows
from .logs import LogError, Signal, name_and_unit, read_log

Rows = NDArray[np.intp]
# Half of what stamps are counted in [s]: equal ones stay equal when a clock is subtracted.
_STAMP = 5e-10


class Column(BaseModel):
    """Where a signal is found in a log.

    Attributes:
        column: its name in the log, with or without the unit that stands behind it in a header.
        unit: of its values, in place of the unit that the log names.
        sign: -1 where the log counts the other way round.
        offset: added, after the sign, SI; given with its unit.
        clock: by how much its stamps are late [s], given with its unit; in tables a whole number of rows.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    column: str
    unit: str | None = None
    sign: int = 1
    offset: float = 0.0
    clock: float = 0.0


Mapped = TypeVar("Mapped", bound=Column)


def read_mapping(
    data: Any,
    signals: Mapping[str, str],
    places: Places,
    path: tuple[str | int, ...],
    problems: list[Problem],
    kind: type[Mapped] = Column,  # type: ignore[assignment]
    optional: bool = False,
) -> dict[str, Mapped]:
    """The `columns` of a study file: a name, or the keys of `kind`, for each signal.

    Args:
        signals: those that are needed, with the units in which they are taken.
        places, path: where it was written.
        problems: what is wrong is added.
        optional: whether signals may be left out.
    Returns: the entries with which nothing is wrong.
    """
    names = tuple(signals)
    if not isinstance(data, dict):
        problems.append(Problem(places.text(path), f"got {data!r}", f"a column for each of {listed(names)}"))
        return {}
    found = {}
    for name, entry in data.items():
        here = (*path, str(name))
        if name not in signals:
            problems.append(Problem(places.text(here), "unknown", listed(names), nearest(str(name), names)))
            continue
        before = len(problems)
        keys = {"column": entry} if isinstance(entry, str) else entry
        if isinstance(keys, dict):
            keys = _read(keys, signals[name], places, here, problems)
        try:
            one = kind.model_validate(keys)
        except ValidationError as error:
            problems += validation_problems(error, places, here, kind)
        if len(problems) == before:
            found[name] = one
    missing = [name for name in signals if name not in data and name != "time"]
    if missing and not optional:
        problems.append(Problem(places.text(path), f"no column for {listed(missing)}"))
    return found


def _read(
    entry: Mapping[str, Any], unit: str, places: Places, path: tuple[str | int, ...], problems: list[Problem]
) -> dict[str, Any]:
    """An entry with its quantities as SI numbers; wrong ones are removed and reported."""
    made = dict(entry)
    for key, measure in (("clock", "s"), ("offset", unit), ("noise", unit)):
        if entry.get(key) is None:
            continue
        place = places.text((*path, key))
        size = quantity("", Measure(measure, known_unit(measure)), entry[key], place, difference=True)
        if not isinstance(size, Problem) and key == "noise" and not size > 0.0:
            size = Problem(place, f"got {entry[key]!r}", "above 0", "Leave it out where nothing is compared.")
        if isinstance(size, Problem):
            problems.append(size)
            del made[key]
        else:
            made[key] = size
    if made.get("sign", 1) not in (1, -1):
        problems.append(Problem(places.text((*path, "sign")), f"got {made.pop('sign')!r}", "1 or -1"))
    if isinstance(made.get("unit"), str):
        try:
            convert(parse_unit(made["unit"]), parse_unit(unit))
        except UnitError as error:
            allowed = f"the unit of the column's values, one that can be converted to {unit}"
            problems.append(Problem(places.text((*path, "unit")), str(error), allowed))
    return made


def columns_of(
    path: Path,
    mapping: Mapping[str, Column],
    signals: Mapping[str, str],
    tick: float | None,
    problems: list[Problem],
    part: Callable[[Array], slice | None] | None = None,
    clock: str | None = "tick",
    gappy: Collection[str] = (),
) -> dict[str, Array] | None:
    """Read a run's log by a mapping: SI, one value per tick.

    Recordings of messages are read at the stamps of the first signal's messages (or of the one that `time`
    names): the others are what was latest then.

    Args:
        tick: from one row to the next [s], of tables whose time is not mapped; None if it is not known: then
            only columns and their units are looked at.
        problems: what is wrong is added.
        part: the rows that are taken, by the times of all [s] from the first on; None refuses them. What
            stands in other rows does not matter.
        clock: the key that sets the tick; None if time is mapped wrongly, so that it is unknown.
        gappy: signals that may lack a few rows, which are NaN then.
    Returns: None if something is wrong, or nothing is mapped.
    """
    before = len(problems)
    if not mapping:
        return None
    try:
        log = read_log(path)
    except LogError as error:
        problems.append(Problem(str(path), str(error)))
        return None
    mapping = {name: _by_header(one, log) for name, one in mapping.items()}
    chosen = _chosen(path, log, mapping, problems)
    scaled = {
        name: _scaled(name, chosen[name], mapping[name], signals[name], path, problems) for name in chosen
    }
    messages = any(signal.time is not None for signal in chosen.values())
    if "time" not in mapping and clock is not None and tick is not None and not messages:
        problems += unmapped_clock(path, log, [one.column for one in mapping.values()], tick, clock)
    lengths = {name: len(values) for name, values in scaled.items()}
    if not messages and len(set(lengths.values())) > 1:
        lengths_text = ", ".join(f"{name} {length}" for name, length in lengths.items())
        problems.append(
            Problem(
                str(path), f"columns have unequal lengths: {lengths_text}", "one value in each row for all"
            )
        )
    if len(problems) > before or tick is None:
        return None
    if messages:
        rows, time = _latest(chosen, mapping)
    else:
        rows, time = _moved(lengths, mapping, tick, path, problems)
    if len(problems) > before:
        return None
    if not len(time):
        problems.append(
            Problem(
                str(path),
                "holds no row that all signals share",
                "two or more",
                "Are all of them logged at the same time, and their clocks right?",
            )
        )
        return None
    if "time" in rows:
        problems += unread_rows(path, {"time": chosen["time"]}, mapping, rows, part is not None)
        time = scaled["time"][rows["time"]]
    if len(problems) > before:
        return None
    time = time - time[0]
    taken = slice(None) if part is None else part(time)
    if taken is None:
        return None
    rows = {name: numbers[taken] for name, numbers in rows.items()}
    problems += unread_rows(path, chosen, mapping, rows, part is not None, gappy)
    if len(problems) > before:
        return None
    return {name: scaled[name][numbers] for name, numbers in rows.items()} | {"time": time[taken]}


def _by_header(one: Column, log: Mapping[str, Signal]) -> Column:
    """The name of a column that is given as in the log's header, `force [N]`."""
    name, unit = name_and_unit(one.column)
    known = one.column not in log and name in log and log[name].unit == unit
    return one.model_copy(update={"column": name}) if known else one


def _chosen(
    path: Path, log: Mapping[str, Signal], mapping: Mapping[str, Column], problems: list[Problem]
) -> dict[str, Signal]:
    """The log's signals by their names in the mapping, as far as they exist."""
    found = {}
    for name, one in mapping.items():
        if one.column not in log:
            what = f"no column {one.column}"
            meant = nearest(name_and_unit(one.column)[0], log)
            problems.append(Problem(f"{path}: {name}", what, listed(log), meant))
        elif log[one.column].flaw:
            problems.append(Problem(f"{path}: {name}", log[one.column].flaw))
        else:
            found[name] = log[one.column]
    return found


def _scaled(name: str, signal: Signal, one: Column, unit: str, path: Path, problems: list[Problem]) -> Array:
    given = one.unit or signal.unit
    if not given:
        problems.append(
            Problem(
                f"{path}: {name}",
                f"column {one.column} has no unit",
                remedy=f"Write `{one.column} [{unit}]` in its header, or give `unit` in a study file.",
            )
        )
        return signal.values
    try:
        gain, shift = convert(parse_unit(given), parse_unit(unit))
    except UnitError as error:
        remedy = (
            "Map the column that is meant, or correct the unit: `unit` in a study file, or in the header."
        )
        problems.append(Problem(f"{path}: {name}", f"column {one.column}: {error}", remedy=remedy))
        return signal.values
    return one.sign * (gain * signal.values + shift) + one.offset


def _latest(signals: Mapping[str, Signal], mapping: Mapping[str, Column]) -> tuple[dict[str, Rows], Array]:
    """Rows that are the latest at stamps of one signal, from where all are known, and these stamps [s]."""
    stamps = {
        name: signal.time - mapping[name].clock for name, signal in signals.items() if signal.time is not None
    }
    leading = "time" if "time" in stamps else next(iter(stamps))
    begin = max((times[0] if len(times) else math.inf) for times in stamps.values())
    base = stamps[leading][stamps[leading] >= begin - _STAMP]
    rows = {name: np.searchsorted(times, base + _STAMP, side="right") - 1 for name, times in stamps.items()}
    return rows, base


def _moved(
    lengths: Mapping[str, int],
    mapping: Mapping[str, Column],
    tick: float,
    path: Path,
    problems: list[Problem],
) -> tuple[dict[str, Rows], Array]:
    """Rows of a table, each column's moved by its clock, less those that not all have; and times [s]."""
    late = {}
    for name, one in mapping.items():
        late[name] = round(one.clock / tick)
        if abs(one.clock / tick - late[name]) > 1e-6:
            problems.append(
                Problem(
                    f"{path}: {name}",
                    f"clock {one.clock:g} s is no whole number of ticks of {tick:g} s",
                    remedy="Round it: rows of a table can only be moved as they are.",
                )
            )
    first, last = min(late.values(), default=0), max(late.values(), default=0)
    rows = {
        name: np.arange(late[name] - first, length - (last - late[name])) for name, length in lengths.items()
    }
    return rows, tick * np.arange(float(len(next(iter(rows.values())))))
