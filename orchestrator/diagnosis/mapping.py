"""How a log calls the signals that a study needs: names, units, signs, clocks."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, ValidationError

from ..errors import Problem, listed, nearest
from ..units import UnitError, convert, parse_unit, quantity_in
from .logs import LogError, Signal, read_log

__all__ = ["Column", "Mapped", "columns_of", "read_mapping"]

Array = NDArray[np.float64]
# Half of what stamps are counted in [s]: equal ones stay equal when a clock is subtracted.
_STAMP = 5e-10


class Column(BaseModel):
    """Where a signal is found in a log.

    Attributes:
        column: its name in the log.
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
    place: str,
    problems: list[Problem],
    kind: type[Mapped] = Column,  # type: ignore[assignment]
    optional: bool = False,
) -> dict[str, Mapped]:
    """The `columns` of a study file: a name, or the keys of `kind`, for each signal.

    Args:
        signals: those that are needed, with the units in which they are taken.
        problems: what is wrong is added.
        optional: whether signals may be left out.
    """
    if not isinstance(data, dict):
        problems.append(Problem(place, f"got {data!r}", f"a column for each of {listed(tuple(signals))}"))
        return {}
    found = {}
    for name, entry in data.items():
        here = f"{place}.{name}"
        if name not in signals:
            problems.append(
                Problem(
                    f"{place}.{name}", "unknown", listed(tuple(signals)), nearest(str(name), tuple(signals))
                )
            )
            continue
        try:
            one = kind.model_validate(
                {"column": entry} if isinstance(entry, str) else _read(entry, signals[name], here, problems)
            )
        except ValidationError as error:
            problems += [
                Problem(".".join((f"{place}.{name}", *map(str, told["loc"]))), told["msg"])
                for told in error.errors()
            ]
            continue
        if one.sign not in (1, -1):
            problems.append(Problem(f"{place}.{name}.sign", f"got {one.sign}", "1 or -1"))
            continue
        found[name] = one
    missing = [name for name in signals if name not in data and name != "time"]
    if missing and not optional:
        problems.append(Problem(place, f"no column for {listed(missing)}"))
    return found


def _read(entry: Any, unit: str, place: str, problems: list[Problem]) -> Any:
    """An entry with its quantities as numbers, SI."""
    if not isinstance(entry, dict):
        return entry
    numbers = {}
    for key, measure in (("clock", "s"), ("offset", unit), ("noise", unit)):
        if key in entry:
            try:
                numbers[key] = quantity_in(str(entry[key]), parse_unit(measure), difference=True)
            except UnitError as error:
                problems.append(
                    Problem(f"{place}.{key}", str(error), f"a number with a unit, like 2 {measure}")
                )
                numbers[key] = 0.0
    return {**entry, **numbers}


def columns_of(
    path: Path,
    mapping: Mapping[str, Column],
    signals: Mapping[str, str],
    tick: float,
    problems: list[Problem],
) -> dict[str, Array] | None:
    """Read a run's log by a mapping: SI, one value per tick.

    Recordings of messages are read at the stamps of the first signal's messages (or of the one that `time`
    names): the others are what was latest then.

    Returns: None if something is wrong, which is added to the problems.
    """
    before = len(problems)
    try:
        log = read_log(path)
    except LogError as error:
        problems.append(Problem(str(path), str(error)))
        return None
    for name, one in mapping.items():
        if one.column not in log:
            problems.append(
                Problem(f"{path}: {name}", f"no column {one.column}", listed(log), nearest(one.column, log))
            )
    chosen = {name: log[one.column] for name, one in mapping.items() if one.column in log}
    scaled = {
        name: _scaled(name, chosen[name], mapping[name], signals[name], path, problems) for name in chosen
    }
    if len(problems) > before:
        return None
    if any(signal.time is not None for signal in chosen.values()):
        columns = _aligned(chosen, scaled, mapping)
    else:
        columns = _shifted(scaled, mapping, tick, path, problems)
    if not len(columns["time"]):
        problems.append(
            Problem(
                str(path),
                "holds no row that all signals share",
                "two or more",
                "Are all of them logged at the same time, and their clocks right?",
            )
        )
        return None
    columns["time"] = columns["time"] - columns["time"][0]
    lengths = {name: len(values) for name, values in columns.items()}
    if len(set(lengths.values())) > 1:
        told = ", ".join(f"{name} {length}" for name, length in lengths.items())
        problems.append(Problem(str(path), f"columns have unequal lengths: {told}"))
    for name, values in columns.items():
        if not np.isfinite(values).all():
            row = int(np.flatnonzero(~np.isfinite(values))[0])
            problems.append(Problem(f"{path}: {name}", f"row {row} is not finite"))
    return columns if len(problems) == before else None


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
        problems.append(Problem(f"{path}: {name}", str(error)))
        return signal.values
    return one.sign * (gain * signal.values + shift) + one.offset


def _aligned(
    signals: Mapping[str, Signal], scaled: Mapping[str, Array], mapping: Mapping[str, Column]
) -> dict[str, Array]:
    """Values at the stamps of one signal, each the latest by then; from where all are known."""
    stamps = {
        name: signal.time - mapping[name].clock for name, signal in signals.items() if signal.time is not None
    }
    leading = "time" if "time" in stamps else next(iter(stamps))
    begin = max((times[0] if len(times) else math.inf) for times in stamps.values())
    base = stamps[leading][stamps[leading] >= begin - _STAMP]
    columns = {
        name: scaled[name][np.searchsorted(times, base + _STAMP, side="right") - 1]
        for name, times in stamps.items()
    }
    if "time" not in columns:
        columns["time"] = base
    return columns


def _shifted(
    scaled: Mapping[str, Array],
    mapping: Mapping[str, Column],
    tick: float,
    path: Path,
    problems: list[Problem],
) -> dict[str, Array]:
    """Columns of a table, each moved by its clock; rows that not all have are left out."""
    rows = {}
    for name, one in mapping.items():
        rows[name] = round(one.clock / tick)
        if abs(one.clock / tick - rows[name]) > 1e-6:
            problems.append(
                Problem(f"{path}: {name}", f"clock {one.clock:g} s is no whole number of ticks of {tick:g} s")
            )
    early, late = min(rows.values(), default=0), max(rows.values(), default=0)
    columns = {
        name: values[rows[name] - early : len(values) - (late - rows[name])]
        for name, values in scaled.items()
    }
    if "time" not in columns:
        columns["time"] = tick * np.arange(len(next(iter(columns.values()))))
    return columns
