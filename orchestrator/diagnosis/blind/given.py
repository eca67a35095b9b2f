"""Hide laws in a given system of FMUs.

SciPy integrates the derivatives that FMUs give; the master of a config simulates the others.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...base.arrays import Array
from ...base.errors import ConfigError, Problem, StepError
from ...config.text import dump
from ...effects import Effect
from ...effects.delay import Delay
from ...fmi import Causality, Kind, Value
from ...simulation.run import prepare
from ...system.connection import Port
from ..study.config_data import config_data
from ..study.keys import Logged
from ..study.player import Inserted, Player
from ..study.reader import load_port_study
from ..study.replay import player_of
from ..study.study import Nominal, PortStudy, is_port_study
from ..unknown_input.evaluation import acts_of, evaluate
from ..unknown_input.model import StateModel
from ..unknown_input.played import PlayedModel
from .cases import RUNS, Draft, driven
from .plant import Acting, Drive, Integrated, Lost

# Laws that act on one another are evaluated so often.
_PASSES = 3
# Of a config without a study: tolerance of parameters, spread of start values, samples until its stop time.
_TOLERANCE, _VARIED, _SAMPLES = 0.02, 0.05, 500
# Steps of a law's states between two communication points; size of a state, over its usual one, that is lost.
_PARTS, _AWAY = 8, 1e6
# No law of the search acts here.
_NOTHING, _NONE = acts_of((), None, 0.0)
_ZEROS = np.zeros(1)
_MEMORY = np.zeros((0, 0, 3)), np.zeros(4), np.zeros((2, 8))


@dataclass
class Given(ABC):
    """A system of FMUs as a `Plant`; to be closed."""

    study: PortStudy
    file: Path
    is_study: bool
    model: StateModel
    units: dict[str, str] = field(default_factory=dict)
    legs: dict[str, list[tuple[str, float]]] = field(default_factory=dict)
    begun: list[str] = field(default_factory=list)
    varied: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        model = self.model
        self.states, self.inputs, self.outputs, self.parameters = (
            [str(one) for one in ports]
            for ports in (model.states, model.inputs, model.outputs, model.parameters)
        )
        self.external = [str(one) for one in model.fed]
        self.compared = [str(one) for one in model.compared]
        self.varied = [str(one) for one in model.fed if one in self.study.varied]
        self.start, self.nominal = model.start.copy(), model.nominal.copy()
        ports = (*model.states, *model.inputs, *model.outputs, *model.parameters)
        self.units = {str(one): self.study.unit(one) for one in ports}

    @abstractmethod
    def simulate(
        self, drive: Drive, parameters: Array, start: Array, laws: Sequence[Acting], size: Array
    ) -> Array:
        """See `Plant`."""

    @abstractmethod
    def at_rest(self, mean: Array, push: Acting | None = None) -> tuple[list[float], list[float]]:
        """See `Plant`."""

    def undriven(self) -> Drive:
        """Two samples of what drives the system, at its start values."""
        at = [float(self.study.prepared.system.start(one)) for one in self.model.fed]
        return Drive(np.tile(at, (2, 1)), False, self.study.interval)

    def close(self) -> None:
        """Free the FMUs."""
        self.model.__exit__()

    def draft(self, random: np.random.Generator) -> Draft:
        """What drives the copy: the study's own logs, or tones and steps of the size of start values."""
        model, study = self.model, self.study
        calibrated = [(k, float(one)) for k, one in enumerate(model.tolerance)]
        if self.is_study:
            made = []
            for run in study.runs:
                ext, held = model.external(run)
                made.append(Drive(np.ascontiguousarray(ext), bool(held.any()), study.interval))
            names = [(one.name, one.role.value) for one in study.runs]
            return Draft(self, lambda again: made, calibrated, model.noise, 0.0, study.name, names)
        steps = bool(random.random() < 0.4)
        means = [study.prepared.system.start(one) for one in model.fed]

        def drives(again: np.random.Generator) -> list[Drive]:
            columns = [
                np.column_stack([driven(again, count, steps, mean, abs(mean) or 1.0) for mean in means])
                if means else np.zeros((count, 0))
                for *_, count in RUNS
            ]  # fmt: skip
            return [Drive(one, steps, study.interval) for one in columns]

        varied = _VARIED if means else 0.5
        return Draft(
            self, drives, calibrated, None, varied, study.name, [(name, role) for name, role, _ in RUNS]
        )

    def write_system(self, folder: Path) -> None:
        """Write system.yaml, with FMUs named from there."""
        (folder / "system.yaml").write_text(dump(config_data(self.study)), encoding="utf-8")


@dataclass
class GivenStates(Integrated, Given):
    """A system whose FMUs give their derivatives.

    A law's w is added to constants of inputs, to what drives them, or to derivatives. The law itself, the
    drive and the integration are those of random systems.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        model = self.model
        first, source, gain = model.wiring[:3]
        self.legs = {
            name: [(self.outputs[source[k]], float(gain[k])) for k in range(first[i], first[i + 1])]
            for i, name in enumerate(self.inputs) if first[i + 1] > first[i]
        }  # fmt: skip
        self._constant = model.wiring[3].copy()
        self._readers: dict[str, list[tuple[int, float]]] = {one: [] for one in self.outputs}
        for name, legs in self.legs.items():
            for output, factor in legs:
                self._readers[output].append((self.inputs.index(name), factor))
        self._scratch = [np.zeros(len(one)) for one in (self.inputs, self.outputs, self.states)]

    def evaluate(
        self, t: float, x: Sequence[float], e: Sequence[float], p: Sequence[float],
        laws: Sequence[Acting], z: Sequence[float],
    ) -> tuple[list[float], list[float], list[float]]:  # fmt: skip
        """See `Integrated`."""
        model, acting = self.model, [one for one in laws if not one.delay]
        u, y, rate = self._scratch
        constant, nx, nu = model.wiring[3], len(x), len(self.inputs)
        w, extra = [0.0] * len(acting), [0.0] * len(z)
        state, numbers = np.array(x, float), np.array(p, float)
        made: list[float] = []
        for _ in range(_PASSES if acting else 1):
            fed = np.array(e, float)
            constant[:] = self._constant
            for law, value in zip(acting, w, strict=True):
                if law.place in self.external:
                    fed[self.external.index(law.place)] += value
                elif law.kind == "input":
                    constant[law.index] += value
                elif law.kind == "output":
                    for i, gain in self._readers[law.place]:
                        constant[i] += gain * value
            evaluate(model.rows, model.wiring, state, fed, numbers, t, _NOTHING, 0.0, _NONE, _ZEROS, _ZEROS,
                     u, y, rate, _ZEROS, *_MEMORY)  # fmt: skip
            made = [*x, *u.tolist(), *y.tolist()]
            at = 0
            for k, law in enumerate(acting):
                read = [made[j] for j in law.reads]
                if law.kind == "input" and law.reads == (nx + law.index,):
                    read[0] -= w[k]
                mine = z[at : at + law.states]
                if law.rate is not None:
                    extra[at : at + law.states] = law.rate(t, read, mine)
                w[k] = law.value(t, read, mine)
                at += law.states
        found = rate.tolist()
        for law, value in zip(acting, w, strict=True):
            if law.kind == "output":
                made[nx + nu + law.index] += value
            elif law.kind == "rate":
                found[law.index] += value
        return found, extra, made


@dataclass
class Replayed(Given):
    """A system that its master simulates, since FMUs give no access to their states.

    A law is an effect at an input or output, calculated at communication points from its own text.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        model, system = self.model, self.study.prepared.system
        self.begun = [str(one) for one in model.states]
        at_once = {
            str(Port(one.name, name)) for one in system.instances for name, inputs in one.feedthrough.items()
            if inputs and name not in one.assumed
        }  # fmt: skip
        self.states = [one for one in self.outputs if one in self.begun or one not in at_once]
        self.legs = {
            str(one.target): [(str(leg), 1.0) for leg in _sources(one)] for one in system.connections
        }
        self._players: dict[bool, Player] = {}
        self.start = np.zeros(len(self.states))
        self.start[[self.states.index(one) for one in self.begun]] = model.start
        self.start = self.simulate(self.undriven(), self.nominal, self.start, (), np.ones(len(self.states)))[
            0, : len(self.states)
        ]

    def simulate(
        self, drive: Drive, parameters: Array, start: Array, laws: Sequence[Acting], size: Array
    ) -> Array:
        """See `Plant`."""
        logs = {
            port: np.ascontiguousarray(column)
            for port, column in zip(self.model.fed, drive.values.T, strict=True) if not np.isnan(column).any()
        }  # fmt: skip
        values: dict[Port, Value] = {
            port: float(logs.pop(port)[0]) for port in self.study.varied if port in logs
        }
        values |= dict(zip(self.model.parameters, parameters.tolist(), strict=True))
        values |= {Port.of(one): float(start[self.states.index(one)]) for one in self.begun}
        stops: list[StepError] = []
        put = [self._inserted(one) for one in laws]
        found = self._player(drive.held).run(logs, len(drive.values), values, put, stops)
        names = [*self.states, *self.inputs, *self.outputs]
        nothing = np.zeros(len(drive.values))
        ports = map(Port.of, names)
        signals = np.column_stack([found.get(one, logs.get(one, nothing)) for one in ports])
        states = signals[:, : len(self.states)]
        if stops or not np.isfinite(signals).all() or (np.abs(states) > _AWAY * size).any():
            raise Lost("the simulation runs away")
        return signals

    def at_rest(self, mean: Array, push: Acting | None = None) -> tuple[list[float], list[float]]:
        """See `Plant`: the changes over two samples, and the signals after one."""
        names = [*self.states, *self.inputs, *self.outputs]
        fed = [float(mean[names.index(one)]) if one in names else math.nan for one in self.external]
        drive = Drive(np.tile(fed, (3, 1)), False, self.study.interval)
        laws, size = [] if push is None else [push], np.full(len(self.states), np.inf)
        start = mean[: len(self.states)]
        signals = self.simulate(drive, self.nominal, start, laws, size)
        nx = len(self.states)
        return ((signals[2, :nx] - signals[0, :nx]) / (2.0 * drive.interval)).tolist(), signals[1].tolist()

    def _player(self, held: bool) -> Player:
        """What simulates the system; driven signals are held as the study says, or all or none of them."""
        if held not in self._players:
            study, model = self.study, self.model
            if not self.is_study:
                fed = {port: study.columns[port].model_copy(update={"hold": held}) for port in study.fed}
                study = replace(study, columns={**study.columns, **fed})
            driven = {one.target for one in study.prepared.system.connections}
            every = [*model.outputs, *(one for one in model.inputs if one in driven)]
            self._players[held] = player_of(study, study.fed, every)
        return self._players[held]

    def _inserted(self, law: Acting) -> Inserted:
        first = len(self.states) + (0 if law.kind == "input" else len(self.inputs))
        if law.delay:
            return Inserted(Delay(time=law.delay, before=None), Port.of(law.place))
        names = [*self.states, *self.inputs, *self.outputs]
        own = [one == first + law.index for one in law.reads]
        reads = [Port.of(names[one]) for one, mine in zip(law.reads, own, strict=True) if not mine]
        return Inserted(_effect_of(law, own), Port.of(law.place), tuple(reads))


def _effect_of(law: Acting, own: Sequence[bool]) -> Effect:
    """A law as an effect on a signal. `own`: whether each signal that it reads is that one."""
    count = len(own)

    class Hidden(Effect):
        @staticmethod
        def kernel(time: float, x: Any, options: Any, memory: Array, commit: bool) -> float:
            others = iter(x[1:])
            read = [float(x[0] if mine else next(others)) for mine in own]
            z = [read[0] if law.follows else 0.0] * law.states
            if memory[0]:
                before, z = memory[2 : 2 + count].tolist(), memory[2 + count :].tolist()
                z = _advanced(law, float(memory[1]), time, before, read, z)
            if commit:
                memory[:] = [1.0, time, *read, *z]
            return float(x[0]) + law.value(time, read, z)

        def room(self, step_size: float | None) -> int:
            return 2 + count + law.states

    return Hidden()


def _advanced(
    law: Acting, begin: float, end: float, first: Sequence[float], last: Sequence[float], z: list[float]
) -> list[float]:
    """States of a law after a step, by RK4; its signals go in straight lines."""
    if law.rate is None or end <= begin:
        return z
    h = (end - begin) / _PARTS
    for part in range(_PARTS):
        slopes: list[Sequence[float]] = []
        for share in (0.0, 0.5, 0.5, 1.0):
            at = (part + share) / _PARTS
            signals = [a + at * (b - a) for a, b in zip(first, last, strict=True)]
            ahead = [v + share * h * slopes[-1][k] for k, v in enumerate(z)] if slopes else z
            slopes.append(law.rate(begin + at * (end - begin), signals, ahead))
        z = [
            v + h / 6.0 * (a + 2.0 * b + 2.0 * c + d) for v, a, b, c, d in zip(z, *slopes, strict=True)
        ]  # fmt: skip
    return z


def given(path: Path) -> Given:
    """A system that laws can be hidden in: a study of ports, or a config.

    Of a config, inputs that nothing drives are driven. Outputs that nothing reads are compared, of components
    with inputs; all, where every one is read. Parameters that it gives are calibrated to 2 %, but for those
    that cannot move so little, such as a sample period, which counts steps.

    Where components give no access to their states, start values vary that a config gives to compared
    outputs.

    Raises: ConfigError if the study or the config is wrong, or no component has a real output.
    """
    if is_port_study(path):
        return _given(load_port_study(path), path, True)
    prepared = prepare(path, ["run.record=all"])
    system = prepared.system
    driven_ports = {one.target for one in system.connections}
    led = {
        one.name for one in system.instances
        if any(each.causality is Causality.INPUT for each in one.fmu.description.variables.values())
    }  # fmt: skip
    read = {leg for one in system.connections for leg in _sources(one)}
    fed, compared, nominal = list[Port](), list[Port](), dict[str, Nominal]()
    parts = max(1, round(prepared.grid.steps / _SAMPLES))
    for one in system.instances:
        for name, variable in one.fmu.description.variables.items():
            port = Port(one.name, name)
            if variable.kind is not Kind.REAL:
                continue
            if variable.causality is Causality.INPUT and port not in driven_ports:
                fed.append(port)
            elif variable.causality is Causality.OUTPUT:
                compared.append(port)
            elif variable.causality is Causality.PARAMETER and name in one.start and system.start(port):
                nominal[str(port)] = Nominal(system.start(port), _TOLERANCE * abs(system.start(port)))
    # No law changes what a source gives, such as a path.
    moved = [one for one in compared if one.instance in led]
    compared = [one for one in moved if one not in read] or moved or compared
    if not compared:
        raise ConfigError(
            [Problem(str(path), "no component has a real output", "", "Name a study of its ports.")]
        )
    columns: Mapping[Port, Any] = {
        port: Logged(column=str(port), noise=1.0 if port in compared else None) for port in (*fed, *compared)
    }
    study = PortStudy(path.stem, prepared, columns, tuple(fed), tuple(compared), nominal, 0, (), parts=parts)
    made = _given(study, path, False)
    still = [name for k, name in enumerate(made.parameters) if not _moves(made, k)]
    if still:
        made.close()
        nominal = {name: one for name, one in nominal.items() if name not in still}
        made = _given(replace(study, nominal=nominal), path, False)
    return made


def _moves(made: Given, index: int) -> bool:
    """Whether the system begins to run with a parameter that is moved by its tolerance."""
    moved = made.nominal.copy()
    moved[index] += made.model.tolerance[index]
    try:
        made.simulate(made.undriven(), moved, made.start, (), np.full(len(made.states), np.inf))
    except Lost:
        return False
    return True


def _given(study: PortStudy, path: Path, is_study: bool) -> Given:
    try:
        return GivenStates(study, path, is_study, StateModel(study))
    except ConfigError:
        if not is_study:
            begun = {
                port: study.columns[port].model_copy(update={"start": True})
                for port in study.compared
                if port.variable in next(
                    one.start for one in study.prepared.system.instances if one.name == port.instance
                )
            }  # fmt: skip
            study = replace(study, columns={**study.columns, **begun})
        return Replayed(study, path, is_study, PlayedModel(study))


def _sources(connection: Any) -> list[Port]:
    if connection.wire is None:
        return [connection.source]
    return [leg.port for leg in connection.wire.legs]
