"""Reads a study of ports: its file, its system, its logs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from ...config import Places, parse, validation_problems
from ...errors import ConfigError, Problem, listed, nearest
from ...fmi import Causality, Kind
from ...quantities import Measure, quantity
from ...run import Prepared, prepare
from ...system import Port
from ...units import parse_unit
from ..channels import logged_twice
from ..mapping import columns_of, read_mapping
from ..study import Nominal
from .keys import SPEEDS, Logged, Role, StudyModel
from .study import PortRun, PortStudy, Trial, study_file

__all__ = ["load_port_study"]

# Samples may be apart by other than the communication step by this share of it.
_UNEVEN = 0.01
# Samples of a run that are compared, at the least.
_FEWEST = 100


def load_port_study(path: Path) -> PortStudy:
    """Read a study. Raises: ConfigError with all problems of study, system and logs."""
    file = study_file(path)
    try:
        text = file.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError([Problem(str(file), f"cannot be read: {error.strerror}")]) from None
    data, places = parse(text, str(file))
    try:
        model = StudyModel.model_validate(data)
    except ValidationError as error:
        raise ConfigError(validation_problems(error, places, (), StudyModel)) from None
    own = file.parent / model.system
    prepared = prepare(own if own.is_file() else model.system, model.overrides)
    if prepared.config.model.run.record != "all":
        prepared = prepare(prepared.config, ["run.record=all"])
    return _Reader(file, places, model, prepared).study()


class _Reader:
    """Reads a study whose system is known; collects problems."""

    def __init__(self, file: Path, places: Places, model: StudyModel, prepared: Prepared) -> None:
        self.file, self.places, self.model, self.prepared = file, places, model, prepared
        self.problems: list[Problem] = []
        self.step = float(prepared.grid.step_size)
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

    def place(self, *parts: object) -> str:
        return self.places.text(tuple(one if isinstance(one, int) else str(one) for one in parts))

    def study(self) -> PortStudy:
        """Raises: ConfigError with all problems."""
        units = {name: one.unit_name or "1" for name, one in self.ports.items()}
        mapping = read_mapping(
            self.model.columns, units | {"time": "s"}, self.places, ("columns",), self.problems, Logged, True
        )
        columns = {Port.of(name): one for name, one in mapping.items() if name != "time"}
        fed, compared = self._uses(columns)
        nominal = self._nominal()
        priors = {
            name: self._number(name, value, "candidates", "parameters", name, difference=True)
            for name, value in self.model.candidates.parameters.items()
        }
        settled = self._seconds(self.model.settle, "settle")
        window = self._seconds(self.model.window, "window")
        motion, rest = self._motion()
        trials = self._trials()
        practice = None if self.model.practice is None else self.file.parent / self.model.practice
        if practice is not None and not practice.is_file():
            what = f"no file {practice.name} in {practice.parent}"
            remedy = "`orchestrator diagnose STUDY --practice N --out DIR` writes one."
            self.problems.append(Problem(self.place("practice"), what, remedy=remedy))
        if self.problems:
            raise ConfigError(self.problems)
        runs = [self._run(number, mapping, units) for number in range(len(self.model.runs))]
        found = tuple(run for run in runs if run is not None)
        self._checked(found, round(settled / self.step))
        if not any(one.role is Role.TRAIN for one in self.model.runs):
            self.problems.append(Problem(self.place("runs"), "no run has the role train", "at least one"))
        names = [run.name for run in found]
        for run in found:
            if names.count(run.name) > 1:
                self.problems.append(
                    Problem(self.place("runs"), f"two runs are called {run.name}", remedy="Give a name.")
                )
                break
        if self.problems:
            raise ConfigError(self.problems)
        return PortStudy(
            self.file.resolve().parent.name if self.file.name == "study.yaml" else self.file.stem,
            self.prepared,
            columns,
            fed,
            compared,
            nominal,
            round(settled / self.step),
            found,
            priors,
            tuple(self.model.candidates.only),
            tuple(self.model.candidates.without),
            motion,
            rest,
            round(window / self.step),
            trials,
            practice,
        )

    def _motion(self) -> tuple[Port | None, float | None]:
        """The port by which phases of motion are told, and the speed of rest in its unit."""
        model = self.model.motion
        if model is None:
            return None, None
        variable = self.ports.get(model.port)
        rate = None if variable is None else SPEEDS.get(variable.unit_name or "1")
        if rate is None:
            moving = [name for name, one in self.ports.items() if (one.unit_name or "1") in SPEEDS]
            self.problems.append(
                Problem(
                    self.place("motion", "port"),
                    f"{model.port} is no position or velocity",
                    listed(moving),
                    nearest(model.port, moving),
                )
            )
            return None, None
        rest = None
        if model.rest is not None:
            found = quantity(
                "rest", Measure(rate, parse_unit(rate)), model.rest, self.place("motion", "rest")
            )
            if isinstance(found, Problem):
                self.problems.append(found)
            else:
                rest = found
        return Port.of(model.port), rest

    def _trials(self) -> tuple[Trial, ...]:
        """The experiments, each with the system as its settings make it."""
        found = []
        for number, one in enumerate(self.model.experiments):
            place = self.place("experiments", number)
            try:
                prepared = prepare(self.prepared.config, one.overrides)
            except ConfigError as error:
                self.problems += [replace(each, place=f"{place}: {each.place}") for each in error.problems]
                continue
            if prepared.grid.step_size != self.prepared.grid.step_size:
                self.problems.append(
                    Problem(
                        f"{place}.set",
                        f"changes the communication step to {float(prepared.grid.step_size):g} s",
                        f"that of the study, {self.step:g} s",
                    )
                )
            found.append(Trial(one.name, one.description, prepared))
        names = [one.name for one in found]
        if len(set(names)) < len(names):
            self.problems.append(Problem(self.place("experiments"), "two share a name"))
        return tuple(found)

    def _uses(self, columns: Mapping[Port, Logged]) -> tuple[tuple[Port, ...], tuple[Port, ...]]:
        fed, compared = [], []
        driven = {one.target: one for one in self.prepared.system.connections}
        for port, one in columns.items():
            is_input = self.ports[str(port)].causality is Causality.INPUT
            place = self.place("columns", port)
            if is_input and port in driven:
                source = driven[port].source
                what = f"{port} is fed by {source}"
                self.problems.append(Problem(place, what, "a free input, or an output", f"Map {source}."))
            if is_input and (one.noise is not None or one.feed is False or one.start):
                self.problems.append(
                    Problem(place, "an input has no noise, feed or start: it is fed what was logged")
                )
            if not is_input and one.noise is not None:
                compared.append(port)
            if one.feed if one.feed is not None else (is_input or one.noise is None):
                fed.append(port)
                several = [
                    connection
                    for connection in self.prepared.system.connections
                    if port in connection.sources and connection.wire and len(connection.wire.legs) > 1
                ]
                if several:
                    self.problems.append(
                        Problem(place, f"cannot be fed: {several[0]} adds up several outputs")
                    )
            elif one.noise is None:
                self.problems.append(Problem(place, "is neither fed nor compared", "feed: true, or a noise"))
            if one.start and not self.ports[str(port)].settable:
                self.problems.append(Problem(f"{place}.start", f"{port} takes no start value"))
        if not compared and not self.problems:
            self.problems.append(
                Problem(self.place("columns"), "no output is compared", "at least one output with its noise")
            )
        return tuple(fed), tuple(compared)

    def _number(self, name: str, value: object, *place: object, difference: bool = False) -> float:
        """A quantity in the unit of a parameter; difference: see `units.Quantity.exactly`."""
        variable = self.parameters.get(name)
        if variable is None:
            self.problems.append(
                Problem(
                    self.place(*place),
                    "no such parameter",
                    listed(self.parameters),
                    nearest(name, self.parameters),
                )
            )
            return 1.0
        found = quantity(name, Measure(variable.unit_name, variable.unit, variable.display_units), value,
                         self.place(*place), difference)  # fmt: skip
        if isinstance(found, Problem):
            self.problems.append(found)
            return 1.0
        return found

    def _nominal(self) -> dict[str, Nominal]:
        found = {}
        for name, one in self.model.calibrated.items():
            before = len(self.problems)
            tolerance = self._number(name, one.tolerance, "calibrated", name, "tolerance", difference=True)
            if len(self.problems) > before:
                continue
            if not tolerance > 0:
                self.problems.append(
                    Problem(self.place("calibrated", name, "tolerance"), f"got {one.tolerance!r}", "above 0")
                )
            if one.value is not None:
                value = self._number(name, one.value, "calibrated", name, "value")
            else:
                value = self.prepared.system.start(Port.of(name))
            found[name] = Nominal(value, tolerance)
        return found

    def _seconds(self, text: str | None, *place: object) -> float:
        if text is None:
            return 0.0
        found = quantity(str(place[-1]), _SECONDS, text, self.place(*place))
        if isinstance(found, Problem):
            self.problems.append(found)
            return 0.0
        return found

    def _checked(self, runs: Sequence[PortRun], settled: int) -> None:
        """Runs long enough to tell anything, and each with a log of its own."""
        for run in runs:
            if len(run) - settled < _FEWEST:
                what = f"{run.name} has {len(run)} samples, {settled} of them while it settles"
                self.problems.append(
                    Problem(
                        self.place("runs"), what, f"at least {_FEWEST} more", "Log longer, or settle less."
                    )
                )
            if run.repeats is not None and run.repeats not in [one.name for one in runs]:
                names = [one.name for one in runs if one is not run]
                what = f"{run.name} repeats {run.repeats}, which is no run"
                self.problems.append(
                    Problem(self.place("runs"), what, listed(names), nearest(run.repeats, names))
                )
        self.problems += logged_twice([(run.name, run.logs) for run in runs], self.place("runs"))

    def _run(self, number: int, mapping: Mapping[str, Logged], units: Mapping[str, str]) -> PortRun | None:
        model = self.model.runs[number]
        place = ("runs", number)
        path = self.file.parent / model.file
        if not path.exists():
            self.problems.append(
                Problem(self.place(*place, "file"), f"no file {model.file} in {path.parent}")
            )
            return None
        unknown = [name for name in model.without if name not in mapping]
        if unknown:
            what = f"{listed(unknown)} has no column"
            self.problems.append(Problem(self.place(*place, "without"), what, listed(mapping)))
            return None
        wanted = {name: one for name, one in mapping.items() if name not in model.without}
        found = columns_of(
            path, wanted, {**units, "time": "s"}, self.step, self.problems, clock="run.step_size"
        )
        begin = self._seconds(model.begin, *place, "from")
        end = self._seconds(model.end, *place, "to") if model.end is not None else np.inf
        if found is None:
            return None
        apart = np.diff(found["time"])
        if "time" in mapping and not np.allclose(apart, self.step, rtol=0, atol=_UNEVEN * self.step):
            usual, row = float(np.median(apart)), int(np.argmax(np.abs(apart - np.median(apart))))
            what, remedy = (
                f"samples are {usual:.6g} s apart",
                "Set run.step_size under `set`, or resample the log.",
            )
            if abs(usual - self.step) <= _UNEVEN * self.step:
                wrong = int(np.sum(np.abs(apart - self.step) > _UNEVEN * self.step))
                what = f"row {row + 1} comes {apart[row]:.6g} s after the one before; {wrong} such in all"
                remedy = (
                    "Take the run up to there, by `to`, or the one after, by `from`; or resample the log."
                )
            allowed = f"the communication step of the system, {self.step:.6g} s"
            self.problems.append(Problem(f"{path}: time", what, allowed, remedy))
            return None
        first, last = round(begin / self.step), round(min(end / self.step, len(found["time"])))
        if not 0 <= first < last - 2:
            self.problems.append(
                Problem(
                    self.place(*place),
                    f"{model.begin} to {model.end} holds no samples",
                    f"up to {found['time'][-1]:g} s",
                )
            )
            return None
        logs = {
            Port.of(name): np.ascontiguousarray(values[first:last])
            for name, values in found.items()
            if name != "time"
        }
        stem = Path(path.name.removesuffix(".gz")).stem
        return PortRun(
            model.name or (stem if model.begin is None else f"{stem}-{first}"),
            model.role,
            logs,
            model.repeats,
            path,
        )


_SECONDS = Measure("s", parse_unit("s"))
