"""A file of signals over time, seen as an FMU that plays them back."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.digests import file_digest
from ...base.errors import ConfigError, Problem, listed
from ...base.units import UnitError, convert, parse_unit
from ...fmi import (
    Array,
    Capabilities,
    Causality,
    Initial,
    Kind,
    ModelDescription,
    Point,
    StepStatus,
    Value,
    Variability,
    Variable,
)

SUFFIX = ".csv"
# "force [N]", "force (N)" or "force / N".
_HEADER = re.compile(r"^(.*?)\s*(?:\[([^]]*)\]|\(([^)]*)\)|\s/\s+(\S+))?$", re.DOTALL)
_WHOLE = re.compile(r"[-+]?\d{1,300}")
_TRUE, _FALSE = ("true", "1", "1.0"), ("false", "0", "0.0")
_MOST_PROBLEMS = 20


class Column(NamedTuple):
    """A column of a file: its name and unit, as the header has them."""

    name: str
    unit: str


def read_header(path: Path) -> list[Column]:
    """The columns of a file without that of the time. Raises: ConfigError if its header cannot be used."""
    columns = _columns(_rows(path)[0])
    if problems := _header_problems(path, columns):
        raise ConfigError(problems)
    return columns[1:]


class SignalFmu:
    """Signals of a CSV file, as an FMU with any number of instances.

    The first column is the time. Between two rows real numbers run straight; integers, enumerations, booleans
    and text keep the value of the row before. Two rows of the same time make a jump. Before the first row and
    after the last one the nearest value holds.

    Attributes:
        path: the file.
        description: one output a column.
    """

    def __init__(self, path: Path, targets: Mapping[str, Variable] | None = None) -> None:
        """Read a file.

        Args:
            path: of the file; values between commas or semicolons, a header in the first line.
            targets: the inputs that columns feed, by column: a column takes type and, where the header names
                none, unit from there; others are real numbers.
        Raises: ConfigError with all problems of the file.
        """
        self.path = path
        targets = targets or {}
        rows = _rows(path)
        columns = _columns(rows[0])
        problems = _header_problems(path, columns)
        if problems:
            raise ConfigError(problems)
        kinds = [Kind.REAL, *(_kind(targets.get(one.name)) for one in columns[1:])]
        read: list[list[Any]] = []
        for number, row in enumerate(rows[1:], 2):
            if any(cell.strip() for cell in row):
                read.append(_values(row, number, columns, kinds, path, problems, targets))
        if not read and not problems:
            problems.append(Problem(path.name, "no row of values", "a row below the header is needed"))
        if problems:
            more = len(problems) - _MOST_PROBLEMS
            cut = [Problem(path.name, f"and {more} further values")] if more > 0 else []
            raise ConfigError(problems[:_MOST_PROBLEMS] + cut)
        gain, _ = convert(parse_unit(columns[0].unit), _SECOND)
        self.times = gain * np.array([one[0] for one in read])
        if not (np.diff(self.times) >= 0.0).all():
            late = int(np.argmax(np.diff(self.times) < 0.0)) + 1
            what = f"the time goes back at {self.times[late]:g} s, row {late + 1} of the values"
            raise ConfigError([Problem(path.name, what, "times that do not decrease are needed")])
        self.columns: dict[str, NDArray[Any]] = {
            one.name: np.array([row[n] for row in read], None if kind is Kind.REAL else object)
            for n, (one, kind) in enumerate(zip(columns, kinds, strict=True))
            if n
        }
        variables = {
            one.name: _variable(one, n, targets.get(one.name), self.columns[one.name][0])
            for n, one in enumerate(columns[1:])
        }
        self.description = ModelDescription(
            name=path.stem,
            fmi_version="",
            token="",
            model_identifier=path.stem,
            variables=variables,
            feedthrough=dict.fromkeys(variables, ()),
            initial_feedthrough=dict.fromkeys(variables, ()),
            capabilities=Capabilities(variable_step_size=True, save_state=True),
            tool="a file of signals",
        )

    def check(self) -> None:
        """All that can be checked was checked when the file was read."""

    def checksum(self) -> str:
        """SHA-256 of the file."""
        return f"sha256:{file_digest(self.path)}"

    def instantiate(self, name: str) -> SignalInstance:
        """A player of the file."""
        return SignalInstance(name, self)

    def at(self, name: str, time: float) -> Value:
        """The value of a column at an instant [s], in the column's unit."""
        column = self.columns[name]
        after = int(np.searchsorted(self.times, time, side="right"))
        before = max(after - 1, 0)
        if after in (0, len(self.times)) or column.dtype == object:
            return column[before]
        begin, end = self.times[before], self.times[after]
        return float(column[before] + (column[after] - column[before]) * ((time - begin) / (end - begin)))


class SignalInstance:
    """Plays a file back; see `FmuInstance`."""

    def __init__(self, name: str, fmu: SignalFmu) -> None:
        self.name, self.description, self._fmu = name, fmu.description, fmu
        self._time = 0.0
        self._outputs: Sequence[str] = ()
        self._y = np.zeros(0)

    def bind(self, inputs: Sequence[str], u: Array, outputs: Sequence[str], y: Array) -> None:
        """See `FmuInstance`."""
        self._outputs, self._y = outputs, y

    def enter_initialisation(
        self, start_time: float, start_values: Mapping[str, Value], stop_time: float | None = None
    ) -> None:
        """See `FmuInstance`."""
        self._time = start_time

    def exit_initialisation(self) -> None:
        """See `FmuInstance`."""

    def set_values(self, values: Mapping[str, Value]) -> None:
        """See `FmuInstance`; a file has nothing to be set."""

    def get_values(self, names: Sequence[str]) -> dict[str, Value]:
        """See `FmuInstance`."""
        return {name: self._fmu.at(name, self._time) for name in names}

    def write_inputs(self) -> None:
        """See `FmuInstance`; there are none."""

    def do_step(self, point: Point) -> StepStatus:
        """See `FmuInstance`."""
        self._time = point.time + point.step_size
        return StepStatus.OK

    def read_outputs(self) -> None:
        """See `FmuInstance`."""
        self._y[:] = [float(self._fmu.at(name, self._time)) for name in self._outputs]

    def terminate(self) -> None:
        """See `FmuInstance`."""

    def free(self) -> None:
        """See `FmuInstance`."""

    def log_lines(self) -> tuple[str, ...]:
        """A warning where the run is longer than the file."""
        last = float(self._fmu.times[-1])
        if self._time <= last + 1e-9 * max(abs(last), 1.0):
            return ()
        return (f"[warning] {self._fmu.path.name} ends at {last:g} s; its last values are held",)

    def last_successful_time(self) -> float | None:
        """See `FmuInstance`."""
        return self._time

    def save_state(self) -> float:
        """See `FmuInstance`."""
        return self._time

    def restore_state(self, state: float) -> None:
        """See `FmuInstance`."""
        self._time = state

    def free_state(self, state: float) -> None:
        """See `FmuInstance`."""


_SECOND = parse_unit("s")


def _rows(path: Path) -> list[list[str]]:
    """The cells of a file. Raises: ConfigError if it cannot be read or is empty."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError([Problem(str(path), f"cannot be read ({error})")]) from error
    first = text.partition("\n")[0]
    try:
        rows = list(
            csv.reader(text.splitlines(), delimiter=";" if first.count(";") > first.count(",") else ",")
        )
    except csv.Error as error:
        raise ConfigError([Problem(path.name, f"cannot be read as CSV ({error})")]) from error
    if not rows or not any(cell.strip() for cell in rows[0]):
        what = "no header in the first line"
        raise ConfigError([Problem(path.name, what, "a header as time [s], force [N] is needed")])
    return rows


def _columns(header: Sequence[str]) -> list[Column]:
    found = []
    for n, text in enumerate(header):
        match = _HEADER.match(text.strip())
        assert match is not None
        unit = next((one for one in match.groups()[1:] if one), "")
        # An index of an array element, x[1], belongs to the name; x [1] and x (1) have the unit 1.
        alone = re.search(r"\s\[1\]$|\(1\)$", text.strip())
        if unit.replace(",", "").replace(" ", "").isdigit() and not alone:
            found.append(Column(text.strip(), ""))
        else:
            found.append(Column(match.group(1).strip(), unit.strip() or ("" if n else "s")))
    return found


def _header_problems(path: Path, columns: Sequence[Column]) -> list[Problem]:
    problems = []
    place = f"{path.name}:1"
    if columns[0].name.lower() not in ("time", "t"):
        what = f"the first column is called {columns[0].name!r}"
        problems.append(Problem(place, what, "the first column is the time, as in time [s]"))
    names = [one.name for one in columns]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        problems.append(Problem(place, f"several columns are called {listed(twice)}", "a name for each"))
    if len(columns) < 2:
        problems.append(Problem(place, "no column besides the time", "a column for each input is needed"))
    for n, one in enumerate(columns):
        try:
            unit = parse_unit(one.unit) if one.unit else None
        except UnitError as error:
            problems.append(Problem(place, f"column {one.name!r}: {error}"))
            continue
        if n == 0 and unit is not None:
            try:
                convert(unit, _SECOND)
            except UnitError:
                problems.append(Problem(place, f"{one.unit} is no unit of time", "for example s, ms or min"))
    return problems


def _kind(target: Variable | None) -> Kind:
    return Kind.REAL if target is None else target.kind


def _values(
    row: Sequence[str],
    number: int,
    columns: Sequence[Column],
    kinds: Sequence[Kind],
    path: Path,
    problems: list[Problem],
    targets: Mapping[str, Variable],
) -> list[Any]:
    """The values of a row; what is wrong is added to `problems`."""
    place = f"{path.name}:{number}"
    if len(row) != len(columns):
        what = f"{len(row)} values under a header of {len(columns)} columns"
        problems.append(Problem(place, what, "a value for each column is needed"))
        return [0.0] * len(columns)
    found: list[Any] = []
    for text, column, kind in zip(row, columns, kinds, strict=True):
        try:
            found.append(_value(text.strip(), kind, targets.get(column.name)))
        except ValueError as error:
            problems.append(Problem(place, f"{column.name}: {text.strip()!r} is {error}"))
            found.append(0.0)
    return found


def _value(text: str, kind: Kind, target: Variable | None) -> Any:
    """A value of a type. Raises: ValueError that says what the text is not."""
    if kind is Kind.REAL:
        try:
            value = float(text)
        except ValueError:
            raise ValueError("no number") from None
        if not math.isfinite(value):
            raise ValueError("not finite")
        return value
    if kind is Kind.BOOLEAN:
        if text.lower() not in (*_TRUE, *_FALSE):
            raise ValueError("neither true nor false")
        return text.lower() in _TRUE
    if kind in (Kind.INTEGER, Kind.ENUMERATION):
        if target is not None and text in target.items:
            return target.items[text]
        try:
            value = int(text) if _WHOLE.fullmatch(text) else float(text)
        except ValueError:
            raise ValueError("no whole number") from None
        if not float(value).is_integer():
            raise ValueError("no whole number")
        if target is not None:
            low, high = target.held_range or (value, value)
            if not low <= value <= high:
                raise ValueError(f"beyond {target.type}, which holds {low} to {high}")
            if held := target.rounded(int(value)):
                raise ValueError(f"no signal, which is a 64-bit float, exact up to 2^53, and would be {held}")
        return int(value)
    return text


def _variable(column: Column, reference: int, target: Variable | None, start: Any) -> Variable:
    made = Variable(
        name=column.name,
        reference=reference,
        type="Float64",
        kind=Kind.REAL,
        causality=Causality.OUTPUT,
        variability=Variability.CONTINUOUS,
        initial=Initial.EXACT,
        unit=None,
        unit_name="",
        start=start,
    )
    if target is not None:
        variability = Variability.CONTINUOUS if target.kind is Kind.REAL else Variability.DISCRETE
        made = replace(
            made,
            type=made.type if target.kind is Kind.REAL else target.type,
            kind=target.kind,
            variability=variability,
            items=target.items,
            unit=target.unit,
            unit_name=target.unit_name,
        )
    if column.unit:
        made = replace(made, unit=parse_unit(column.unit), unit_name=column.unit)
    return made


def targets_of(
    name: str, connections: Iterable[tuple[str, str]], variables: Mapping[str, Variable]
) -> dict[str, Variable]:
    """The inputs that the columns of a file feed.

    Args:
        name: of the file's instance.
        connections: source and target of each, as "instance.variable".
        variables: of all other instances, as "instance.variable".
    """
    found: dict[str, Variable] = {}
    for source, target in connections:
        instance, _, column = source.partition(".")
        if instance == name and target in variables:
            found.setdefault(column, variables[target])
    return found
