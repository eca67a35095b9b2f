"""What a diagnosis of any system is given: a config, logs of its ports, and what is known of it how well."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Array
from ...base.errors import ConfigError
from ...config import Places
from ...config.text import compose
from ...fmi import Causality, CompiledFmu
from ...simulation.run import Prepared
from ...system.connection import Port
from .keys import FORMAT, Logged, Role

if TYPE_CHECKING:
    from ...translate.opened import Opening


@dataclass(frozen=True)
class Nominal:
    """A calibrated number and the standard deviation of its calibration."""

    value: float
    tolerance: float


@dataclass(frozen=True)
class PortRun:
    """One logged run.

    Attributes:
        logs: by port, in the unit of the port, each of shape (n,), a communication step apart.
        repeats: name of the run that it repeats; file: that it was read from.
        values: of parameters, and start values of outputs, in place of the config's.
        gaps: where the log of a compared port holds nothing, each of shape (n,); there `logs` has a line
            between the rows around, for checks.
    """

    name: str
    role: Role
    logs: Mapping[Port, Array]
    repeats: str | None = None
    file: Path | None = None
    values: Mapping[Port, float] = field(default_factory=dict)
    gaps: Mapping[Port, NDArray[np.bool_]] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(next(iter(self.logs.values()), ()))


@dataclass(frozen=True)
class PortStudy:
    """A system and logs of its ports.

    Attributes:
        prepared: the system as configured, all outputs recorded.
        columns: by port.
        fed, compared: ports; see `Logged`.
        nominal: calibrated parameters by "instance.parameter", in the variable's unit.
        settled: samples at the begin of each run that are not compared.
        parts: communication steps from one sample of the logs to the next.
        places: where in its file things stand; None of one that was not read.
        unused: keys of its file that have no effect.
        natives: FMUs that replays take in place of others, by the files of these; see
            `native.in_native_form`.
        openings: inputs inside components; see `unknown_input.rebuilt.with_openings`.
    """

    name: str
    prepared: Prepared
    columns: Mapping[Port, Logged]
    fed: tuple[Port, ...]
    compared: tuple[Port, ...]
    nominal: Mapping[str, Nominal]
    settled: int
    runs: tuple[PortRun, ...]
    parts: int = 1
    places: Places | None = field(default=None, compare=False, repr=False)
    unused: tuple[str, ...] = ()
    natives: Mapping[Path, CompiledFmu] = field(default_factory=dict, compare=False, repr=False)
    openings: Mapping[Port, Opening] = field(default_factory=dict, compare=False, repr=False)

    def of(self, *roles: Role) -> tuple[PortRun, ...]:
        """The runs of some roles."""
        return tuple(run for run in self.runs if run.role in roles)

    @property
    def varied(self) -> tuple[Port, ...]:
        """Parameters and start values that some runs set."""
        return tuple(sorted({port for run in self.runs for port in run.values}))

    @property
    def interval(self) -> float:
        """What samples of the logs are apart [s]."""
        return float(self.prepared.grid.step_size * self.parts)

    def every(self, count: int) -> PortStudy:
        """The study with each `count`-th sample of its logs."""
        thin = tuple(
            replace(run, logs={port: np.ascontiguousarray(log[::count]) for port, log in run.logs.items()})
            for run in self.runs
        )
        return replace(self, runs=thin, parts=self.parts * count, settled=-(-self.settled // count))

    @property
    def held(self) -> frozenset[Port]:
        """Ports whose signals stay at each sample until the next one."""
        return frozenset(port for port, one in self.columns.items() if one.hold)

    @property
    def computed(self) -> tuple[Port, ...]:
        """Fed ports whose signal the model computes: connected inputs, and outputs of driven components."""
        targets = {one.target for one in self.prepared.system.connections}
        driven = {one.instance for one in (*targets, *filter(self._is_input, self.fed))}
        return tuple(
            port
            for port in self.fed
            if (port in targets if self._is_input(port) else port.instance in driven)
        )

    @property
    def unasked(self) -> tuple[Port, ...]:
        """Outputs that are fed for want of a noise, though their components are driven: of a source, such as
        a path, nothing could be compared.
        """
        return tuple(
            port
            for port in self.computed
            if not self._is_input(port)
            and self.columns[port].feed is None
            and self.columns[port].noise is None
        )

    def _is_input(self, port: Port) -> bool:
        return self.prepared.system.variable(port).causality is Causality.INPUT

    def place(self, *path: str | int) -> str:
        """Where in the study's file something stands, for problems."""
        return (self.places or Places("")).text(path)

    def unit(self, port: Port) -> str:
        """Unit of a port, as its FMU names it."""
        return self.prepared.system.variable(port).unit_name or "1"


def study_file(path: Path) -> Path:
    """The file of a study, given by it or by its folder."""
    return path / "study.yaml" if path.is_dir() else path


def is_port_study(path: Path) -> bool:
    """Whether a file, or the study.yaml of a folder, is a study of ports."""
    file = study_file(path)
    if not file.is_file() or (path.is_dir() and (path / "case.yaml").is_file()):
        return False
    try:
        data, _, _ = compose(file.read_text(encoding="utf-8"), file.name)
    except (ConfigError, UnicodeDecodeError, OSError):
        return False
    return isinstance(data, dict) and data.get("format") == FORMAT
