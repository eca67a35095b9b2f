"""A system that is replayed by its master, for components that give no access to their states.

FMUs of other tools, Python FMUs, connections with effects and algebraic loops are simulated as `run` does it.
Laws act at inputs and outputs, at communication points.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ...base.compiled_functions import njit
from ...effects import Effect
from ...effects.base import Array as Memory
from ...effects.base import Numbers
from ...fmi import Causality, Kind, Value
from ...system.connection import Port
from ..study.player import Inserted as AtPort
from ..study.player import Player
from ..study.replay import player_of
from .calls import call_law
from .model import COLUMNS, Inserted, Kinds, Place, StateModel

__all__ = ["LawEffect", "PlayedModel"]

Array = NDArray[np.float64]
# Numbers, and states, that a law has at most; steps of its states between two communication points.
_MOST, _PARTS = 4, 8


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


class PlayedModel(StateModel):
    """A study's system as its master simulates it; see `StateModel`.

    States are the outputs whose start values the study takes from the logs.
    """

    filters: ClassVar[bool] = False

    def _make(self) -> None:
        study, system = self.study, self.study.prepared.system
        self.fed, self.compared = tuple(study.fed), tuple(study.compared)
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
        self._player = player_of(study, self.fed, self.compared)
        every = [*self.outputs, *(one for one in self.inputs if one in driven)]
        self._seeing = player_of(study, self.fed, every)

    def places(self) -> list[Place]:
        """Inputs and outputs."""
        return [one for one in super().places() if one.kind is not Kinds.RATE]

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
            port: float(value)
            for port, value in zip(
                (*self.states, *self.parameters), (*z[:nx], *z[nx + hidden : at]), strict=True
            )
        }
        put = []
        for one in laws:
            place, signal = self._port(one.place), one.signals[0]
            own = signal == nx + one.place.index + (len(self.inputs) if one.place.kind is Kinds.OUTPUT else 0)
            effect = LawEffect(
                address=float(one.address), own=own, states=one.states,
                settled=sum(1 << k for k in one.settled), interval=self.study.interval,
                values=tuple(z[at : at + one.numbers].tolist()),
            )  # fmt: skip
            put.append(AtPort(effect, place, () if own else (self._signal(signal),)))
            at += one.numbers
        player: Player = self._seeing if signals else self._player
        found = player.run(logs, len(ext), start, put)
        if not signals:
            return np.column_stack([found[port] for port in self.compared]), np.zeros((0, 0))
        nothing = np.zeros(len(ext))
        columns = [found.get(port, nothing) for port in (*self.states, *self.inputs, *self.outputs)]
        return np.column_stack([found[port] for port in self.compared]), np.column_stack(columns)

    def _unlogged(self, port: Port) -> float:
        return float("nan")  # the system's own signal

    def _port(self, place: Place) -> Port:
        return (self.inputs if place.kind is Kinds.INPUT else self.outputs)[place.index]

    def _signal(self, index: int) -> Port:
        return [*self.states, *self.inputs, *self.outputs][index]
