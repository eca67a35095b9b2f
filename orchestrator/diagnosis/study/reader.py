"""Reads a study of ports: its file, its system, its logs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ...base.errors import ConfigError, Problem, in_order, listed, nearest
from ...base.quantities import Measure
from ...config import correct_spelling
from ...fmi import Causality, Kind, Variable
from ...simulation.run import Prepared, prepare
from ...system.checks import in_range
from ...system.connection import Port
from .keys import UNUSED, CalibratedModel, Logged, Role, StudyModel
from .mapping import read_mapping
from .runs import Columns, read_runs
from .sheet import Sheet
from .study import Nominal, PortRun, PortStudy, study_file


def load_port_study(path: Path) -> PortStudy:
    """Read a study.

    Raises: ConfigError with all problems of study, system and logs.
    """
    sheet = Sheet(study_file(path))
    sheet.problems += correct_spelling(sheet.data, sheet.places, StudyModel)[0]
    model, wrong = sheet.taken(StudyModel, sheet.data)
    prepared, faithful = _prepared(sheet, model, wrong)
    if prepared is not None:
        study = _Reader(sheet, model, prepared, faithful).study()
    else:
        # What ports and parameters there are is not known; files and times can be looked at all the same.
        study = None
        sheet.seconds(model.settle, "settle")
        for name, entry in (model.calibrated or {}).items():
            sheet.part(CalibratedModel, entry, "calibrated", name)
        sheet.unchecked.append("ports and parameters of the study")
        read_runs(sheet, model.runs, Columns(_named(model), {}, {}, None), 0)
    if study is None or sheet.problems:
        raise ConfigError(in_order(sheet.problems), sheet.unchecked)
    return study


def _named(model: StudyModel) -> tuple[str, ...]:
    return tuple(model.columns) if isinstance(model.columns, dict) else ()


def _prepared(sheet: Sheet, model: StudyModel, wrong: frozenset[str]) -> tuple[Prepared | None, bool]:
    """The system with all outputs recorded, and whether it is as the study wants it.

    Where only some of `set` is wrong, it is made without that: its ports and parameters are known then, but
    not its communication step.
    """
    if "system" in wrong:
        return None, False
    own = sheet.file.parent / model.system
    source = own if own.is_file() else model.system
    kept = dict(enumerate(model.overrides))
    otherwise: tuple[str, ...] | None = ("system",)
    while True:
        try:
            prepared = prepare(source, kept.values(), sheet.file.parent)
            break
        except ConfigError as error:
            blamed = sheet.of_system(error, kept, ("set",), otherwise)
        if not blamed:
            return None, False
        kept = {number: text for number, text in kept.items() if number not in blamed}
        otherwise = None  # what is wrong besides may be so for want of what was left out
    faithful = "set" not in wrong and len(kept) == len(model.overrides)
    if prepared.config.model.run.record != "all":
        prepared = prepare(prepared.config, ["run.record=all"])
    return prepared, faithful


class _Reader:
    """Reads a study whose system is known.

    Args:
        faithful: whether the system is as the study wants it, its communication step with it.
    """

    def __init__(self, sheet: Sheet, model: StudyModel, prepared: Prepared, faithful: bool) -> None:
        self.sheet, self.model, self.prepared, self.faithful = sheet, model, prepared, faithful
        self.place, self.problems = sheet.place, sheet.problems
        self.parts = self._parts()
        self.step = self.parts * float(prepared.grid.step_size)
        variables = {
            f"{one.name}.{variable.name}": variable
            for one in prepared.system.instances
            for variable in one.fmu.description.variables.values()
        }
        self.ports = {
            name: one
            for name, one in variables.items()
            if one.causality in (Causality.INPUT, Causality.OUTPUT)
            and one.kind is Kind.REAL
            and not one.shape
        }
        self.parameters = {
            name: one
            for name, one in variables.items()
            if one.causality is Causality.PARAMETER and one.kind is Kind.REAL and not one.shape
        }

        self.starts = {
            name: one for name, one in self.ports.items()
            if one.causality is Causality.OUTPUT and one.settable
        }  # fmt: skip

    def _parts(self) -> int:
        """Communication steps from one sample of the logs to the next."""
        step, given = float(self.prepared.grid.step_size), self.model.interval
        interval = self.sheet.seconds(given, "interval", absent=step)
        parts = max(round(interval / step), 1)
        if self.faithful and abs(interval - parts * step) > 1e-6 * step:
            near = listed([f"{n * step:.6g} s" for n in (parts, parts + 1)])
            what, allowed = f"got {given!r}", f"a whole number of communication steps, as {near}"
            self.sheet.add(("interval",), what, allowed, "Or set run.step_size under `set`.")
        return parts

    def study(self) -> PortStudy | None:
        """The study; None if something is wrong, which is reported."""
        sheet, model = self.sheet, self.model
        units = {name: _column_unit(one) for name, one in self.ports.items()} | {"time": "s"}
        mapping, fed, compared = self._columns(units)
        nominal = self._nominal()
        settled = sheet.seconds(model.settle, "settle")
        step = self.step if self.faithful else None
        gappy = [str(port) for port in compared if port not in fed]
        columns = Columns(
            _named(model), mapping, units, step, tuple(map(str, compared)), tuple(gappy), self._value
        )
        runs = read_runs(sheet, model.runs, columns, round(settled / self.step))
        self._moving(runs, compared, round(settled / self.step))
        if sheet.problems:
            return None
        return PortStudy(
            sheet.file.resolve().parent.name if sheet.file.name == "study.yaml" else sheet.file.stem,
            self.prepared,
            {Port.of(name): one for name, one in mapping.items() if name != "time"},
            fed,
            compared,
            nominal,
            round(settled / self.step),
            runs,
            parts=self.parts,
            places=sheet.places,
            unused=tuple(key for key in UNUSED if key in sheet.data),
        )

    def _columns(
        self, units: Mapping[str, str]
    ) -> tuple[dict[str, Logged], tuple[Port, ...], tuple[Port, ...]]:
        """Columns by signal, the ports that are fed, and those that are compared."""
        if self.model.columns is None and "columns" not in self.sheet.data:
            return {}, (), ()
        before = len(self.problems)
        mapping = read_mapping(
            self.model.columns, units, self.sheet.places, ("columns",), self.problems, Logged, True
        )
        fed, compared = self._uses({Port.of(name): one for name, one in mapping.items() if name != "time"})
        if not compared and len(self.problems) == before:
            self.sheet.add(("columns",), "no output is compared", "at least one output with its noise")
        return mapping, fed, compared

    def _moving(self, runs: tuple[PortRun, ...], compared: tuple[Port, ...], settled: int) -> None:
        """Report if nothing moves at any port at which runs of training are compared."""
        train = [run for run in runs if run.role is Role.TRAIN]
        logs = [(port, run.logs[port][settled:]) for run in train for port in compared if port in run.logs]
        # A run that is too short to settle is reported as such.
        if logs and all(log.size and np.ptp(log) == 0.0 for _, log in logs):
            found = {f"{port}: {log[0]:g} {self.ports[str(port)].unit_name or '1'}" for port, log in logs}
            what = "the logs of all compared ports are constant in the runs of the role train"
            remedy = "Check the columns, or take runs in which something moves; settle less."
            self.sheet.add(("columns",), f"{what} ({listed(sorted(found))})", "one that moves", remedy)

    def _uses(self, columns: Mapping[Port, Logged]) -> tuple[tuple[Port, ...], tuple[Port, ...]]:
        fed, compared = [], []
        for port, one in columns.items():
            is_input = self.ports[str(port)].causality is Causality.INPUT
            place = self.place("columns", port)
            if is_input and (one.noise is not None or one.feed is False or one.start):
                self.problems.append(
                    Problem(
                        place,
                        "an input is fed what was logged",
                        "column, unit, sign, offset, clock",
                        "Leave noise, feed and start to outputs.",
                    )
                )
            if not is_input and one.noise is not None:
                compared.append(port)
            if one.feed if one.feed is not None else (is_input or one.noise is None):
                fed.append(port)
            elif one.noise is None:
                self.problems.append(Problem(place, "is neither fed nor compared", "feed: true, or a noise"))
            if one.start and not self.ports[str(port)].settable:
                self.problems.append(
                    Problem(
                        f"{place}.start",
                        f"{port} takes no start value",
                        "an output whose start value can be set",
                        f"Set what it starts from under instances.{port.instance}.start of the system, and "
                        "leave out the begin of each run by `settle`.",
                    )
                )
            if one.hold and port not in fed:
                what, allowed = f"{port} is compared at its samples, not fed", "what is fed"
                self.problems.append(Problem(f"{place}.hold", what, allowed, "Leave it out, or feed it."))
        return tuple(fed), tuple(compared)

    def _value(self, name: str, value: Any, *path: str | int) -> float | None:
        """A parameter or a start value of one run."""
        if name in self.model.calibrated:
            what, remedy = "is calibrated, too", "Calibrate it, or set it in each run."
            self.sheet.add(path, what, "a parameter without a tolerance", remedy)
            return None
        return self._number(name, value, *path, difference=False, among=self.parameters | self.starts)

    def _number(
        self,
        name: str,
        value: Any,
        *path: object,
        least: float = -math.inf,
        difference: bool = True,
        among: Mapping[str, Variable] | None = None,
    ) -> float | None:
        """A quantity in the unit of a parameter; None if it is none. See `Sheet.size`."""
        known = self.parameters if among is None else among
        variable = known.get(name)
        if variable is None:
            self.sheet.add(path, "no such parameter", listed(known), nearest(name, known))
            return None
        measure = Measure(variable.unit_name, variable.unit, variable.display_units)
        return self.sheet.size(measure, value, *path, least=least, difference=difference)

    def _nominal(self) -> dict[str, Nominal]:
        found = {}
        for name, entry in self.model.calibrated.items():
            one = self.sheet.part(CalibratedModel, entry, "calibrated", name)
            if one is None:
                continue
            place = ("calibrated", name)
            tolerance = self._number(name, one.tolerance, *place, "tolerance", least=0.0)
            if name not in self.parameters:
                continue
            value: Any = self.prepared.system.start(Port.of(name))
            if one.value is not None:
                value = self._number(name, one.value, *place, "value", difference=False)
                port = Port.of(name)
                wrong = value is not None and in_range(
                    port.instance, self.parameters[name], value, one.value, self.place(*place, "value")
                )
                if wrong:
                    self.problems.append(wrong)
            if tolerance is not None and value is not None:
                found[name] = Nominal(value, tolerance)
        return found


def _column_unit(port: Variable) -> str:
    """The unit that a column is converted to; of a temperature difference without an origin."""
    temperature = port.unit is not None and port.unit.difference and port.unit.base() == "K"
    return f"delta_{port.unit_name}" if temperature else port.unit_name or "1"
