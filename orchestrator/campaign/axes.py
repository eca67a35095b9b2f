"""What a design varies: a path of the config, read as a config reads it, units and all."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..base.errors import ConfigError, Problem, listed
from ..base.quantities import Measure, quantity
from ..base.units import ONE, Quantity, UnitError, parse_quantity, parse_unit
from ..config import Config, Scalar, dump, move_value, override_path, path_text, unknown_path
from ..fmi import Kind, Variable, bundled
from ..simulation.run import prepare
from ..system.checks import start_value
from ..system.system import System

_SECOND = parse_unit("s")
_TIMES = ("step_size", "stop_time", "start_time", "time_limit")
_FIXED = {
    ("title",): "no result depends on it",
    ("run", "loop"): "no result depends on it",
    ("bonds",): "it is no single value",
    ("run", "record"): "it is no single value",
}


@dataclass(frozen=True)
class Level:
    """A value of an axis.

    Attributes:
        shown: in tables: a number in the axis's unit, or text.
        canonical: what the run's identity is made from: equal for "2 ms" and "0.002 s".
        text: as an override has it; of an FMU's file "files:" and its place below the folder of files.
        file: of an FMU, which has to travel.
        source: the Python file of an effect, which has to travel.
    """

    shown: float | int | str | bool
    canonical: Any
    text: str
    file: Path | None = None
    source: Path | None = None


class Axis:
    """A path that a design varies.

    Attributes:
        path: as the study has it.
        target: where it is in the config.
        unit: of the numbers in tables; empty where they have none.
        start: whether it is a start value: an instance and a variable.
        effect: whether its values are names of effects.
    """

    def __init__(
        self,
        path: str,
        target: tuple[str | int, ...],
        system: System,
        config: Config,
        moved: Callable[[str], str],
    ) -> None:
        """
        Args:
            system, config: without values of the design.
            moved: what the config has for a file that the study names.
        """
        self.path, self.target, self._moved = path, target, moved
        self.unit = ""
        self._config = config
        self._variable: Variable | None = None
        self._read: Callable[[Scalar, str], Level | Problem] = self._read_plain
        self.effect = target[0] == "connections" and target[-1] == "effect"
        self.start = target[0] == "instances" and target[2] == "start"
        if self.start:
            instance = next(one for one in system.instances if one.name == target[1])
            self._description = instance.fmu.description
            self._variable = self._description.variables.get(str(target[3]))
            self._read = self._read_start
            if self._variable is not None and self._variable.kind is Kind.REAL:
                self.unit = self._variable.unit_name
        elif target[0] == "instances" and target[2] in ("fmu", "form"):
            self._read = self._read_file
        elif target[-1] in _TIMES and target[0] in ("run", "instances"):
            self.unit = "s"
            self._read = self._read_time

    def read(self, value: Scalar, place: str) -> Level | Problem:
        """A value as it is written, checked as far as it can be for itself."""
        if isinstance(value, float) and not math.isfinite(value):
            return Problem(place, f"{self.path}: {value!r} is not finite")
        return self._read(value, place)

    @property
    def known(self) -> bool:
        """Whether there is such a variable, of a start value."""
        return self._variable is not None

    def spread(self, value: Scalar, place: str) -> float | Problem:
        """A standard deviation in the axis's unit: a difference of two values, not held to their bounds."""
        if isinstance(value, bool) or (isinstance(value, float) and not math.isfinite(value)):
            return Problem(place, f"{self.path}: std {value!r} is no number")
        label = f"{self.path}: std"
        if self._variable is not None and self._variable.kind is Kind.REAL:
            one = self._variable
            measure = Measure(one.unit_name, one.unit, one.display_units)
        else:
            measure = Measure(self.unit, parse_unit(self.unit)) if self.unit else Measure("1", ONE)
        return quantity(label, measure, value, place, difference=True)

    def whole(self, ends: Sequence[Level]) -> bool:
        """Whether it takes whole numbers only, if these are values of it."""
        if self.start:
            return self._variable is not None and self._variable.kind is Kind.INTEGER
        numbers = [one.shown for one in ends]
        if self.unit or not all(type(one) is int for one in numbers):
            return False
        # An option has no description; whether it takes a number shows when it rejects another value.
        least = min(numbers)
        return self._takes(least) and not self._takes(least + 0.5) and not self._takes(least - 0.5)

    def _takes(self, value: Scalar) -> bool:
        try:
            prepare(self._config, [f"{self.path}={as_text(value)}"])
        except ConfigError:
            return False
        return True

    def at(self, number: float, whole: bool = False) -> Level:
        """The value of a number in the axis's unit.

        Args:
            whole: see `whole`.
        """
        if self.start:
            value = round(number) if whole else float(number)
            return Level(value, value, "")
        if whole:
            number = round(number)
        made = self._read(f"{float(number)!r} {self.unit}" if self.unit else number, "")
        assert isinstance(made, Level)
        return made

    def _read_start(self, value: Scalar, place: str) -> Level | Problem:
        made = start_value(str(self.target[1]), self._description, str(self.target[3]), value, place)
        if isinstance(made, Problem):
            return made
        assert self._variable is not None
        shown = made
        if self._variable.kind is Kind.ENUMERATION:
            shown = next((name for name, item in self._variable.items.items() if item == made), made)
        return Level(shown, made, "")

    def _read_time(self, value: Scalar, place: str) -> Level | Problem:
        try:
            quantity = parse_quantity(str(value))
            if quantity.unit == ONE:
                return Problem(place, f"{self.path}: {value!r} has no unit", "a time is needed, as in '1 ms'")
            exact = quantity.exactly(_SECOND)
        except UnitError as error:
            return Problem(
                place, f"{self.path}: cannot take {value!r}, {error}", "a time is needed, as in '1 ms'"
            )
        return Level(float(exact), str(exact), str(value))

    def _read_plain(self, value: Scalar, place: str) -> Level | Problem:
        # An effect's file is beside the study or its system, wherever this process works.
        source: list[Path] = []

        def found(file: str) -> str:
            source[:] = [self._found(file).resolve()]
            return str(source[0])

        text = as_text(move_value(self.target, value, found))
        if not isinstance(value, str):
            return Level(value, value, text)
        if source:
            # A file that is not there travels nowhere; what names it is refused with all else.
            return Level(value, value, text, source=source[0] if source[0].is_file() else None)
        try:
            quantity = parse_quantity(value)
        except UnitError:
            return Level(value, value, text)
        if not self.unit and quantity.unit != ONE:
            self.unit = quantity.unit.name  # of the first value that has one
        try:
            unit = parse_unit(self.unit) if self.unit else None
            if unit is not None and unit.offset != quantity.unit.offset:
                # Whether the option is a difference is for the option to know.
                raise UnitError(f"{self.unit} has another origin")
            shown = quantity.to(unit) if unit is not None else float(quantity.value)
        except UnitError as error:
            return Problem(place, f"{self.path}: cannot take {value!r}, {error}", f"values in {self.unit}")
        return Level(shown, _exact(quantity), text)

    def _found(self, file: str) -> Path:
        return self._config.folder / self._moved(file)

    def _read_file(self, value: Scalar, place: str) -> Level | Problem:
        name, what = str(self.target[1]), self.target[2]
        if what == "form":
            fmu = self._config.model.instances[name].fmu
            forms = {} if (self._config.folder / fmu).is_file() else bundled.fmu_forms(fmu)
            if value not in forms:
                return Problem(place, f"{self.path}: no form {value!r}", f"forms of {fmu}: {listed(forms)}")
            return Level(str(value), "", "", forms[str(value)])
        found = self._found(str(value))
        path = found if found.is_file() else bundled.find_fmu(str(value))
        if path is None:
            names = listed(bundled.fmu_names())
            return Problem(place, f"{self.path}: no FMU {value!r}", f"no file {found}; bundled FMUs: {names}")
        return Level(str(value), "", "", path)


def as_text(value: Scalar) -> str:
    """A value as an override has it."""
    return dump({"x": value}).partition(":")[2].strip()


def _exact(quantity: Quantity) -> str:
    """What a value is, whatever the unit that it is written in."""
    value, offset = quantity.value * quantity.unit.factor, quantity.unit.offset
    # 5 degC is 278.15 K or, as a difference, 5 K.
    return f"{value} {quantity.unit.base()}" + (f" from {offset}" if offset else "")


def axis_of(
    path: str, system: System, config: Config, moved: Callable[[str], str], place: str
) -> Axis | Problem | None:
    """The axis of a path, or what is wrong with it; None if the system lacks its instance. See `Axis`."""
    data = config.model.to_data()
    target = override_path(data, path)
    if target is None:
        return unknown_path(data, path, place)
    if reason := _FIXED.get(target):
        return Problem(place, f"{path_text(target)} cannot be varied: {reason}")
    if target[0] == "instances" and all(one.name != target[1] for one in system.instances):
        return None
    return Axis(path, target, system, config, moved)
