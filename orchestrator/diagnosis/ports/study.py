"""What a diagnosis of any system is given: a config, logs of its ports, and what is known of it how well."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any, Literal

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ...errors import ConfigError, Problem, listed, nearest
from ...fmi import Causality, Kind
from ...quantities import Measure, quantity
from ...run import Prepared, prepare
from ...system import Port
from ...units import parse_unit
from ..mapping import Column, columns_of, read_mapping
from ..study import Array, Nominal
from ..verdict import problems_of

__all__ = ["FORMAT", "Logged", "PortRun", "PortStudy", "Role", "is_port_study", "load_port_study"]

FORMAT = "port-study/1"
# Samples may be apart by other than the communication step by this share of it.
_UNEVEN = 0.01


class Role(Enum):
    """What a run is used for: fits see train, choices validation, too; held-out runs only tell the gap."""

    TRAIN = "train"
    VALIDATION = "validation"
    HELDOUT = "held-out"
    REPEAT = "repeat"


class Logged(Column):
    """Where the signal of a port is found in the logs, and what it is for; see `Column` for the other keys.

    Attributes:
        noise: of the log [the port's unit], one standard deviation; outputs that have it are compared.
        feed: whether the log takes the place of the system's own signal wherever that goes. By default so,
            but for outputs that are compared.
        start: whether the first sample is the start value of this output in each run.
    """

    noise: float | None = Field(None, gt=0)
    feed: bool | None = None
    start: bool = False


class _RunModel(BaseModel):
    model_config = ConfigDict(extra="forbid", populate_by_name=True)

    file: str
    role: Role
    begin: str | None = Field(None, alias="from")
    end: str | None = Field(None, alias="to")
    without: list[str] = []
    repeats: str | None = None
    name: str | None = None


class _Calibrated(BaseModel):
    model_config = ConfigDict(extra="forbid")

    tolerance: Any
    value: Any = None


class _Candidates(BaseModel):
    model_config = ConfigDict(extra="forbid")

    only: list[str] = []
    without: list[str] = []
    parameters: dict[str, Any] = {}


class _StudyModel(BaseModel):
    model_config = ConfigDict(extra="forbid")

    format: Literal["port-study/1"]
    system: str
    overrides: list[str] = Field([], alias="set")
    columns: Any
    calibrated: dict[str, _Calibrated] = {}
    settle: str | None = None
    runs: list[_RunModel] = Field(min_length=1)
    candidates: _Candidates = _Candidates()


@dataclass(frozen=True)
class PortRun:
    """One logged run.

    Attributes:
        logs: by port, in the unit of the port, each of shape (n,), a communication step apart.
        repeats: name of the run that it repeats; file: that it was read from.
    """

    name: str
    role: Role
    logs: Mapping[Port, Array]
    repeats: str | None = None
    file: Path | None = None

    def __len__(self) -> int:
        return len(next(iter(self.logs.values())))


@dataclass(frozen=True)
class PortStudy:
    """A system and logs of its ports.

    Attributes:
        prepared: the system as configured, all outputs recorded.
        columns: by port.
        fed, compared: ports; see `Logged`.
        nominal: calibrated parameters by "instance.parameter", in the variable's unit.
        settled: samples at the begin of each run that are not compared.
        priors: of further parameters that may be other than configured, by "instance.parameter".
        only, without: patterns of candidates; see `candidates`.
    """

    name: str
    prepared: Prepared
    columns: Mapping[Port, Logged]
    fed: tuple[Port, ...]
    compared: tuple[Port, ...]
    nominal: Mapping[str, Nominal]
    settled: int
    runs: tuple[PortRun, ...]
    priors: Mapping[str, float]
    only: tuple[str, ...] = ()
    without: tuple[str, ...] = ()

    def of(self, *roles: Role) -> tuple[PortRun, ...]:
        """The runs of some roles."""
        return tuple(run for run in self.runs if run.role in roles)

    def unit(self, port: Port) -> str:
        """Unit of a port, as its FMU names it."""
        return self.prepared.system.variable(port).unit_name or "1"


def is_port_study(path: Path) -> bool:
    """Whether a file, or the study.yaml of a folder, is a study of ports."""
    file = path / "study.yaml" if path.is_dir() else path
    if not file.is_file() or (path.is_dir() and (path / "case.yaml").is_file()):
        return False
    try:
        data = yaml.safe_load(file.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError, OSError):
        return False
    return isinstance(data, dict) and data.get("format") == FORMAT


def load_port_study(path: Path) -> PortStudy:
    """Read a study. Raises: ConfigError with all problems of study, system and logs."""
    file = path / "study.yaml" if path.is_dir() else path
    try:
        data = yaml.safe_load(file.read_text(encoding="utf-8"))
    except (OSError, yaml.YAMLError) as error:
        raise ConfigError([Problem(str(file), f"cannot be read: {error}")]) from None
    try:
        model = _StudyModel.model_validate(data)
    except ValidationError as error:
        raise ConfigError(problems_of(error, str(file))) from None
    own = file.parent / model.system
    prepared = prepare(own if own.is_file() else model.system, model.overrides)
    if prepared.config.model.run.record != "all":
        prepared = prepare(prepared.config, ["run.record=all"])
    return _Reader(file, model, prepared).study()


class _Reader:
    """Reads a study whose system is known; collects problems."""

    def __init__(self, file: Path, model: _StudyModel, prepared: Prepared) -> None:
        self.file, self.model, self.prepared = file, model, prepared
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
        return f"{self.file}: {'.'.join(map(str, parts))}"

    def study(self) -> PortStudy:
        """Raises: ConfigError with all problems."""
        units = {name: one.unit_name or "1" for name, one in self.ports.items()}
        mapping = read_mapping(
            self.model.columns, units | {"time": "s"}, self.place("columns"), self.problems, Logged, True
        )
        columns = {_port(name): one for name, one in mapping.items() if name != "time"}
        fed, compared = self._uses(columns)
        nominal = self._nominal()
        priors = {
            name: self._number(name, value, "candidates", "parameters", name)
            for name, value in self.model.candidates.parameters.items()
        }
        settled = self._seconds(self.model.settle, "settle")
        if self.problems:
            raise ConfigError(self.problems)
        runs = [self._run(number, mapping, units) for number in range(len(self.model.runs))]
        found = tuple(run for run in runs if run is not None)
        if not any(run.role is Role.TRAIN for run in found):
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
        )

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

    def _number(self, name: str, value: object, *place: object) -> float:
        """A positive quantity in the unit of a parameter."""
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
                         self.place(*place))  # fmt: skip
        if isinstance(found, Problem):
            self.problems.append(found)
            return 1.0
        return found

    def _nominal(self) -> dict[str, Nominal]:
        found = {}
        for name, one in self.model.calibrated.items():
            before = len(self.problems)
            tolerance = self._number(name, one.tolerance, "calibrated", name, "tolerance")
            if len(self.problems) > before:
                continue
            if not tolerance > 0:
                self.problems.append(
                    Problem(self.place("calibrated", name, "tolerance"), f"got {one.tolerance!r}", "above 0")
                )
            instance, _, variable = name.partition(".")
            part = next(part for part in self.prepared.system.instances if part.name == instance)
            value: Any = part.start.get(variable, self.parameters[name].start)
            if one.value is not None:
                value = self._number(name, one.value, "calibrated", name, "value")
            found[name] = Nominal(float(value), tolerance)
        return found

    def _seconds(self, text: str | None, *place: object) -> float:
        if text is None:
            return 0.0
        found = quantity(str(place[-1]), _SECONDS, text, self.place(*place))
        if isinstance(found, Problem):
            self.problems.append(found)
            return 0.0
        return found

    def _run(self, number: int, mapping: Mapping[str, Logged], units: Mapping[str, str]) -> PortRun | None:
        model = self.model.runs[number]
        place = f"runs[{number}]"
        path = self.file.parent / model.file
        if not path.exists():
            self.problems.append(Problem(self.place(place, "file"), f"no file {model.file} in {path.parent}"))
            return None
        unknown = [name for name in model.without if name not in mapping]
        if unknown:
            what = f"{listed(unknown)} has no column"
            self.problems.append(Problem(self.place(place, "without"), what, listed(mapping)))
            return None
        wanted = {name: one for name, one in mapping.items() if name not in model.without}
        found = columns_of(path, wanted, {**units, "time": "s"}, self.step, self.problems)
        begin = self._seconds(model.begin, place, "from")
        end = self._seconds(model.end, place, "to") if model.end is not None else np.inf
        if found is None:
            return None
        apart = np.diff(found["time"])
        if "time" in mapping and not np.allclose(apart, self.step, rtol=0, atol=_UNEVEN * self.step):
            self.problems.append(
                Problem(
                    f"{path}: time",
                    f"samples are {apart.min():.6g} to {apart.max():.6g} s apart",
                    f"the communication step of the system, {self.step:.6g} s",
                    "Set run.step_size under `set`, or resample the log.",
                )
            )
            return None
        first, last = round(begin / self.step), round(min(end / self.step, len(found["time"])))
        if not 0 <= first < last - 2:
            self.problems.append(
                Problem(
                    self.place(place),
                    f"{model.begin} to {model.end} holds no samples",
                    f"up to {found['time'][-1]:g} s",
                )
            )
            return None
        logs = {
            _port(name): np.ascontiguousarray(values[first:last])
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


def _port(name: str) -> Port:
    instance, _, variable = name.partition(".")
    return Port(instance, variable)
