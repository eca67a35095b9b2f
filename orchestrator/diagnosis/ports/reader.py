"""Reads a study of ports: its file, its system, its logs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ...base.errors import ConfigError, Problem, in_order, listed, nearest
from ...base.quantities import Measure
from ...base.units import parse_unit
from ...config import correct_spelling
from ...fmi import Causality, Kind, Variable
from ...simulation.run import Prepared, prepare
from ...system.checks import in_range
from ...system.connection import Port
from ..mapping import read_mapping
from ..study import Nominal
from .keys import (
    SPEEDS,
    CalibratedModel,
    CandidatesModel,
    ExperimentModel,
    Logged,
    MotionModel,
    Role,
    StudyModel,
)
from .runs import Columns, read_runs
from .sheet import Sheet
from .study import PortRun, PortStudy, Trial, study_file

__all__ = ["load_port_study"]


def load_port_study(path: Path, practising: bool = False) -> PortStudy:
    """Read a study.

    Args:
        practising: whether it is about to be practised on, so that what that teaches may still be missing.
    Raises: ConfigError with all problems of study, system and logs.
    """
    sheet = Sheet(study_file(path))
    sheet.problems += correct_spelling(sheet.data, sheet.places, StudyModel)[0]
    model, wrong = sheet.taken(StudyModel, sheet.data)
    prepared, faithful = _prepared(sheet, model, wrong)
    if prepared is not None:
        study = _Reader(sheet, model, prepared, faithful, practising).study()
    else:
        # What ports and parameters there are is not known; files and times can be looked at all the same.
        study = None
        sheet.seconds(model.settle, "settle")
        sheet.seconds(model.window, "window")
        _read_apart(sheet, model)
        sheet.unchecked.append("ports, parameters and experiments of the study")
        read_runs(sheet, model.runs, Columns(_named(model), {}, {}, None), 0)
    if study is None or sheet.problems:
        raise ConfigError(in_order(sheet.problems), sheet.unchecked)
    return study


def _read_apart(sheet: Sheet, model: StudyModel) -> None:
    """Tell what is wrong with parts of a study, whatever its system is."""
    sheet.part(CandidatesModel, model.candidates or {}, "candidates")
    if model.motion is not None:
        sheet.part(MotionModel, model.motion, "motion")
    for name, entry in (model.calibrated or {}).items():
        sheet.part(CalibratedModel, entry, "calibrated", name)
    for number, entry in enumerate(model.experiments or ()):
        sheet.part(ExperimentModel, entry, "experiments", number)


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
    told: tuple[str, ...] | None = ("system",)
    while True:
        try:
            prepared = prepare(source, kept.values(), sheet.file.parent)
            break
        except ConfigError as error:
            blamed = sheet.of_system(error, kept, ("set",), told)
        if not blamed:
            return None, False
        kept = {number: text for number, text in kept.items() if number not in blamed}
        told = None  # what is wrong besides may be so for want of what was left out
    faithful = "set" not in wrong and len(kept) == len(model.overrides)
    if prepared.config.model.run.record != "all":
        prepared = prepare(prepared.config, ["run.record=all"])
    return prepared, faithful


class _Reader:
    """Reads a study whose system is known.

    Args:
        faithful: whether the system is as the study wants it, its communication step with it.
        practising: see `load_port_study`.
    """

    def __init__(
        self, sheet: Sheet, model: StudyModel, prepared: Prepared, faithful: bool, practising: bool
    ) -> None:
        self.sheet, self.model, self.prepared, self.faithful = sheet, model, prepared, faithful
        self.practising = practising
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
        candidates, priors = self._candidates()
        settled = sheet.seconds(model.settle, "settle")
        window = self._window()
        motion, rest = self._motion()
        trials = self._trials()
        practice = None if model.practice is None else sheet.file.parent / model.practice
        if practice is not None and not self.practising and not practice.is_file():
            what = f"no file {practice.name} in {practice.parent}"
            remedy = "`orchestrator diagnose STUDY --practice N --out DIR` writes one."
            sheet.add(("practice",), what, remedy=remedy)
        step = self.step if self.faithful else None
        columns = Columns(_named(model), mapping, units, step, tuple(map(str, compared)))
        runs = read_runs(sheet, model.runs, columns, round(settled / self.step))
        self._window_in(runs, window, round(settled / self.step))
        self._moving(runs, compared, round(settled / self.step))
        if sheet.problems or candidates is None:
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
            priors,
            tuple(candidates.only),
            tuple(candidates.without),
            motion,
            rest,
            round(window / self.step),
            trials=trials,
            practice=practice,
            parts=self.parts,
            places=sheet.places,
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

    def _candidates(self) -> tuple[CandidatesModel | None, dict[str, float]]:
        """What stands under `candidates`, and the priors of parameters in it."""
        model = self.sheet.part(CandidatesModel, self.model.candidates or {}, "candidates")
        priors = {}
        for name, value in model.parameters.items() if model is not None else ():
            priors[name] = self._number(name, value, "candidates", "parameters", name, least=0.0)
        return model, {name: prior for name, prior in priors.items() if prior is not None}

    def _window(self) -> float:
        """After which components are taken up anew [s]; 0 by default."""
        window = self.sheet.seconds(self.model.window, "window")
        if self.faithful and 0.0 < window < 2.0 * self.step * (1.0 - 1e-9):
            allowed = f"two samples, {2.0 * self.step:.6g} s, or more"
            remedy = "Leave it out for a twentieth of each run."
            self.sheet.add(("window",), f"got {self.model.window!r}", allowed, remedy)
            return 0.0
        return window

    def _window_in(self, runs: tuple[PortRun, ...], window: float, settled: int) -> None:
        """Tell a window longer than what is to be divided by it."""
        told = [run for run in runs if run.role is Role.HELDOUT] or [
            run for run in runs if run.role is Role.TRAIN
        ]
        shortest = min(told, key=len, default=None)
        if shortest is not None and window > max(len(shortest) - settled, 0) * self.step:
            longest = f"{(len(shortest) - settled) * self.step:.6g} s"
            allowed = f"up to {longest}, what {shortest.name} holds after it settled"
            remedy = "Leave it out for a twentieth of each run."
            self.sheet.add(("window",), f"got {self.model.window!r}", allowed, remedy)

    def _moving(self, runs: tuple[PortRun, ...], compared: tuple[Port, ...], settled: int) -> None:
        """Tell if nothing moves at any port at which runs of training are compared."""
        train = [run for run in runs if run.role is Role.TRAIN]
        logs = [(port, run.logs[port][settled:]) for run in train for port in compared if port in run.logs]
        # A run that is too short to settle is reported as such.
        if logs and all(log.size and np.ptp(log) == 0.0 for _, log in logs):
            found = {f"{port}: {log[0]:g} {self.ports[str(port)].unit_name or '1'}" for port, log in logs}
            what = "the logs of all compared ports are constant in the runs of the role train"
            remedy = "Check the columns, or take runs in which something moves; settle less."
            self.sheet.add(("columns",), f"{what} ({listed(sorted(found))})", "one that moves", remedy)

    def _motion(self) -> tuple[Port | None, float | None]:
        """The port by which phases of motion are reported, and the speed of rest in its unit."""
        if self.model.motion is None:
            return None, None
        model, _ = self.sheet.taken(MotionModel, self.model.motion, "motion")
        if model.port is None:
            return None, None
        variable = self.ports.get(model.port)
        rate = None if variable is None else SPEEDS.get(variable.unit_name or "1")
        if rate is None:
            moving = [name for name, one in self.ports.items() if (one.unit_name or "1") in SPEEDS]
            what = f"{model.port} is no position or velocity"
            self.sheet.add(("motion", "port"), what, listed(moving), nearest(model.port, moving))
            return None, None
        rest = None
        if model.rest is not None:
            rest = self.sheet.size(Measure(rate, parse_unit(rate)), model.rest, "motion", "rest", least=0.0)
        return Port.of(model.port), rest

    def _trials(self) -> tuple[Trial, ...]:
        """The experiments, each with the system as its settings make it."""
        found: dict[str, Trial] = {}
        for number, entry in enumerate(self.model.experiments):
            place = ("experiments", number)
            one = self.sheet.part(ExperimentModel, entry, *place)
            if one is None:
                continue
            if one.name in found:
                self.sheet.add((*place, "name"), f"two are called {one.name}", "one name for each")
            try:
                prepared = prepare(self.prepared.config, one.overrides, self.sheet.file.parent)
            except ConfigError as error:
                self.sheet.of_system(error, dict(enumerate(one.overrides)), (*place, "set"), place)
                continue
            step = self.prepared.grid.step_size
            if self.faithful and prepared.grid.step_size != step:
                what = f"changes the communication step to {float(prepared.grid.step_size):g} s"
                self.sheet.add((*place, "set"), what, f"that of the study, {float(step):g} s")
            found[one.name] = Trial(one.name, one.description, prepared)
        return tuple(found.values())

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

    def _number(
        self, name: str, value: Any, *path: object, least: float = -math.inf, difference: bool = True
    ) -> float | None:
        """A quantity in the unit of a parameter; None if it is none. See `Sheet.size`."""
        variable = self.parameters.get(name)
        if variable is None:
            self.sheet.add(path, "no such parameter", listed(self.parameters), nearest(name, self.parameters))
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
