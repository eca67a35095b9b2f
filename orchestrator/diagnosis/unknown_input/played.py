"""A system that is replayed by its master, for components that give no access to their states.

FMUs of other tools, Python FMUs, connections with effects and algebraic loops are simulated as `run` does it.
Laws act at inputs and outputs, at communication points.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ...base.compiled_functions import njit
from ...effects import Effect
from ...effects.base import Array as Memory
from ...effects.base import Numbers
from ...effects.delay import Delay
from ...effects.sample_and_hold import SampleAndHold
from ...fmi import Causality, Kind, Value
from ...system.connection import Port
from ..study.player import Inserted as AtPort
from ..study.player import Player
from ..study.replay import player_of
from ..study.study import PortStudy
from .calls import call_law
from .evaluation import COLUMNS, Inserted, Kinds, Place
from .model import StateModel

Array = NDArray[np.float64]
# Numbers, and states, that a law has at most; steps of its states between two communication points.
_MOST, _PARTS = 4, 8
# Evaluations of a component that a communication step of an instance takes as long as.
_STEP = 15
# Simulations of each part of a system that are kept.
_KEPT = 64


@njit()
def _value(address, time, signal, interval, numbers, states, out):
    s = np.array([signal, 0.0, interval])
    call_law(address, time, s.ctypes.data, numbers.ctypes.data, states.ctypes.data, out.ctypes.data)
    return out[0]


@njit()
def _advanced(address, begin, end, first, last, interval, numbers, states, count, parts):
    """States of a law after a step, by RK4; the signal follows a line from `first` to `last`."""
    out, k = np.zeros(1 + len(states)), np.zeros((4, len(states)))
    h = (end - begin) / parts
    for part in range(parts):
        base = states.copy()
        for i in range(4):
            share = (0.0, 0.5, 0.5, 1.0)[i]
            at = (part + share) / parts
            for j in range(count):
                states[j] = base[j] + (share * h * k[i - 1, j] if i else 0.0)
            signal = first + at * (last - first)
            _value(address, begin + at * (end - begin), signal, interval, numbers, states, out)
            for j in range(count):
                k[i, j] = out[1 + j]
        for j in range(count):
            states[j] = base[j] + h / 6.0 * (k[0, j] + 2.0 * k[1, j] + 2.0 * k[2, j] + k[3, j])


class LawEffect(Effect):
    """Adds a law of the library to a signal. Zero size: its amplitude 0."""

    jittable: ClassVar[bool] = True

    address: float = Field(description="Of the law's machine code.")
    own: bool = Field(description="Whether it reads the signal itself, not the further one.")
    states: int = Field(description="Of the law.")
    settled: int = Field(description="Sum of 2^k of the states k, from 0, that start at the signal.")
    interval: float = Field(description="Of the logs [s].")
    values: tuple[float, ...] = Field(description="The law's numbers.")

    def numbers(self) -> list[float]:
        """See Effect.numbers."""
        rest = [0.0] * (_MOST - len(self.values))
        law = [self.address, 0.0 if self.own else 1.0, float(self.states), float(self.settled), self.interval]
        return [*law, *self.values, *rest]

    @staticmethod
    def kernel(time: float, x: Numbers, options: Numbers, memory: Memory, commit: bool) -> float:
        """See Effect.kernel. Memory: whether there was an instant before, its time, signal and states."""
        values, states, out = np.zeros(_MOST), np.zeros(_MOST), np.zeros(1 + _MOST)
        for k in range(_MOST):
            values[k] = options[5 + k]
            states[k] = memory[3 + k]
        address, count, interval = int(options[0]), int(options[2]), options[4]
        signal = x[0] if options[1] == 0.0 else x[1]
        if memory[0] == 0.0:
            for k in range(count):
                states[k] = signal if (int(options[3]) >> k) & 1 else 0.0
        if count > 0 and memory[0] != 0.0 and time > memory[1]:
            _advanced(address, memory[1], time, memory[2], signal, interval, values, states, count, _PARTS)
        added = _value(address, time, signal, interval, values, states, out)
        if commit:
            memory[0] = 1.0
            memory[1] = time
            memory[2] = signal
            for k in range(_MOST):
                memory[3 + k] = states[k]
        return x[0] + added

    def room(self, step_size: float | None) -> int:
        """See Effect.room."""
        return 3 + _MOST


@dataclass
class _Part:
    """Instances that are connected, and simulated together.

    Logs that replace a signal cut a system into parts. What changes in one part leaves the others as they
    were, so that only that part is simulated again.

    Attributes:
        compared: what is compared of it; columns: where, of all that is compared.
        kept: simulations by runs, laws and numbers, with the logs of the run, the latest last.
    """

    instances: frozenset[str]
    compared: tuple[Port, ...]
    columns: list[int]
    player: Player
    kept: OrderedDict[Any, tuple[Array, Array]] = field(default_factory=OrderedDict)

    def simulated(
        self, ext: Array, logs: dict[Port, Array], start: dict[Port, Value], put: Sequence[AtPort]
    ) -> Array:
        """Its compared signals, shape (samples, compared)."""
        own = {port: value for port, value in start.items() if port.instance in self.instances}
        laws = [one for one in put if one.port.instance in self.instances]
        acts = tuple((one.port, one.reads, one.effect) for one in laws)
        key = (ext.ctypes.data, ext.shape, tuple(own.items()), acts)
        if key not in self.kept:
            found = self.player.run(logs, len(ext), own, laws)
            # The logs stay with it, so that no others take their address.
            self.kept[key] = ext, np.column_stack([found[port] for port in self.compared])
            if len(self.kept) > _KEPT:
                self.kept.popitem(last=False)
        self.kept.move_to_end(key)
        return self.kept[key][1]


def _parts(study: PortStudy, compared: Sequence[Port]) -> list[_Part]:
    """The parts of a study's system at which something is compared."""
    system = study.prepared.system
    part = {one.name: {one.name} for one in system.instances}
    always = {port for port in study.fed if all(port in run.logs for run in study.runs)}
    for one in system.connections:
        reads = [port for link in one.wire.every_link for port in link.reads] if one.wire else []
        for port in [] if one.target in always else (*one.sources, *reads):
            if port not in always and part[port.instance] is not part[one.target.instance]:
                part[port.instance] |= part[one.target.instance]
                for name in part[port.instance]:
                    part[name] = part[port.instance]
    found = []
    for names in {id(one): frozenset(one) for one in part.values()}.values():
        columns = [k for k, port in enumerate(compared) if port.instance in names]
        if columns:
            seen = tuple(compared[k] for k in columns)
            found.append(_Part(names, seen, columns, player_of(study, study.fed, seen)))
    return found


class PlayedModel(StateModel):
    """A study's system as its master simulates it; see `StateModel`.

    States are the outputs whose start values the study takes from the logs.
    """

    filters: ClassVar[bool] = False

    def _make(self) -> None:
        study, system = self.study, self.study.prepared.system
        self.fed, self.compared = (*study.fed, *study.varied), tuple(study.compared)
        self.instances = list(system.instances)
        driven = {one.target for one in system.connections}
        begun = {port for port, one in study.columns.items() if one.start}
        self.rows = np.zeros((len(self.instances), COLUMNS), np.int64)
        for row, one in zip(self.rows, self.instances, strict=True):
            about = one.fmu.description.variables
            names = [name for name, each in about.items() if each.kind is Kind.REAL and not each.shape]
            outputs = [name for name in names if about[name].causality is Causality.OUTPUT]
            inputs = [name for name in names if about[name].causality is Causality.INPUT]
            states = [name for name in outputs if Port(one.name, name) in begun]
            self._place(row, one, states, inputs, outputs)
        self.parameters = [Port.of(name) for name in study.nominal if Port.of(name) not in self.states]
        self.start = np.array([float(system.start(one)) for one in self.states])
        self.measured = np.array([self.outputs.index(one) for one in self.compared if one in self.outputs])
        self._take_numbers()
        self._driven = driven
        self._parts = _parts(study, self.compared)
        every = [*self.outputs, *(one for one in self.inputs if one in driven)]
        self._seeing = player_of(study, study.fed, every)

    def places(self) -> list[Place]:
        """Inputs and outputs."""
        return [one for one in super().places() if one.kind is not Kinds.RATE]

    def seen_at(self, place: Place) -> list[int]:
        """See `StateModel.seen_at`: what is compared in the same part."""
        name = self.instances[place.component].name
        return next((part.columns for part in self._parts if name in part.instances), [])

    def signals_of(self, place: Place) -> dict[str, int]:
        """Signals of a place's component: index into [states, inputs, outputs] by name."""
        row, nx, nu = self.rows[place.component], len(self.states), len(self.inputs)
        own = nx + place.index if place.kind is Kinds.INPUT else -1
        found = {
            str(self.inputs[i]): nx + i
            for i in self.inputs_of(row) if nx + i == own or self.inputs[i] in self._driven
        }  # fmt: skip
        return found | {str(self.outputs[i]): nx + nu + i for i in self.outputs_of(row)}

    def simulated(
        self, ext: Array, z: Array, laws: Sequence[Inserted] = (), signals: bool = False
    ) -> tuple[Array, Array]:
        """Compared outputs of an open run, and all signals [states, inputs, outputs] on request.

        Args: see `smoother.simulated`.
        """
        logs = {port: ext[:, k] for k, port in enumerate(self.fed) if not np.isnan(ext[:, k]).any()}
        nx, hidden = len(self.states), sum(one.states for one in laws)
        at = nx + hidden + len(self.parameters)
        start: dict[Port, Value] = {
            port: float(logs.pop(port)[0]) for port in self.study.varied if port in logs
        }
        names, values = (*self.states, *self.parameters), (*z[:nx], *z[nx + hidden : at])
        start |= {port: float(value) for port, value in zip(names, values, strict=True)}
        put = []
        for one in laws:
            place, signal = self._port(one.place), one.signals[0]
            own = signal == nx + one.place.index + (len(self.inputs) if one.place.kind is Kinds.OUTPUT else 0)
            effect: Effect
            if one.delay and own:
                # A fit may try any time. What is as late as the run is long never comes, and needs no memory.
                time = min(abs(float(z[at])), len(ext) * self.study.interval)
                effect = Delay(time=time, before=None)
                if one.delay == "held":
                    effect = SampleAndHold(period=time, phase=float(z[at + 1]) % 1.0 * time)
            else:
                effect = LawEffect(
                    address=float(one.address), own=own, states=one.states,
                    settled=sum(1 << k for k in one.settled), interval=self.study.interval,
                    values=tuple(z[at : at + one.numbers].tolist()),
                )  # fmt: skip
            put.append(AtPort(effect, place, () if own else (self._signal(signal),)))
            at += one.numbers
        # What is kept differs from copy to copy of the process. So parts that laws change count, whether kept
        # or not: the others are kept.
        acting = [part for part in self._parts if any(one.port.instance in part.instances for one in put)]
        stepped = sum(len(part.instances) for part in acting or self._parts)
        self.effort.add(_STEP * self.study.parts * len(ext) * stepped)
        if not signals:
            outputs = np.zeros((len(ext), len(self.compared)))
            for part in self._parts:
                outputs[:, part.columns] = part.simulated(ext, logs, start, put)
            return outputs, np.zeros((0, 0))
        found = self._seeing.run(logs, len(ext), start, put)
        nothing = np.zeros(len(ext))
        ports = (*self.states, *self.inputs, *self.outputs)
        columns = [found.get(port, logs.get(port, nothing)) for port in ports]
        return np.column_stack([found[port] for port in self.compared]), np.column_stack(columns)

    def _unlogged(self, port: Port) -> float:
        return float("nan")  # the system's own signal

    def _port(self, place: Place) -> Port:
        return (self.inputs if place.kind is Kinds.INPUT else self.outputs)[place.index]

    def _signal(self, index: int) -> Port:
        return [*self.states, *self.inputs, *self.outputs][index]
