"""Connections with effects while a system runs: their values, and what their effects remember."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

import numpy as np

from ..base.errors import StepError
from ..effects import Effect
from ..fmi import Array
from .connection import Connection, Port
from .signal_vector import Layout, Wired


class RunningConnections:
    """Evaluates the connections with effects of a layout.

    Attributes:
        memories: per connection and effect, what it remembers.
    """

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        self._latest = 0.0
        self.memories = [[np.zeros(effect.room(None)) for effect, _ in one.links] for one in layout.wired]
        self._number = {one.place: number for number, one in enumerate(layout.wired)}
        self._sums = [
            list(zip(one.source.tolist(), one.gain.tolist(), one.offset.tolist(), strict=True))
            for one in layout.wired
        ]
        self._links: list[list[_Running]] = [[_Running(*link) for link in one.links] for one in layout.wired]
        self._after = [tuple(self._number[one.place] for one in after) for after in layout.wired_after]

    def update_after(self, index: int, time: float, values: Array) -> None:
        """Evaluate, on trial, what depends on an instance that has stepped to `time`, into `values`."""
        self._latest = time
        for number in self._after[index]:
            values[self._layout.wired[number].place] = self._evaluate(number, time, values, False)

    def evaluate_on_trial(self, wired: Iterable[Wired], time: float, values: Array) -> None:
        """Evaluate some connections on trial, into `values`."""
        self._latest = time
        self._evaluate_all(wired, time, values)

    def _evaluate_all(self, wired: Iterable[Wired], time: float, values: Array) -> None:
        for one in wired:
            values[one.place] = self._evaluate(self._number[one.place], time, values, False)

    def commit(self, time: float, values: Array) -> None:
        """Evaluate all connections at an accepted instant, and write their memories."""
        for number, one in enumerate(self._layout.wired):
            values[one.place] = self._evaluate(number, time, values, True)

    def slopes(self, connection: Connection, ports: Iterable[Port], values: Array) -> dict[Port, float]:
        """How a connection's signal answers to some of its sources, by differences at the latest instant."""
        chain, found = self._layout.chain(connection), {}
        for port in ports:
            place = self._layout.index[port]
            varied = values.copy()
            # Both are short in binary, so that their sum is exact, and the slope of no effect exactly one.
            begin = float(np.float32(varied[place]))
            step = 2.0 ** math.floor(math.log2(max(abs(begin), self._layout.nominal[place])) - 20)
            varied[place] = begin + step
            self._evaluate_all(chain, self._latest, varied)
            above = float(varied[chain[-1].place])
            varied[place] = begin
            self._evaluate_all(chain, self._latest, varied)
            found[port] = (above - float(varied[chain[-1].place])) / step
        return found

    def _evaluate(self, number: int, time: float, values: Array, commit: bool) -> float:
        # The same operations as in orchestrator.simulation.native.effects, in the same order.
        total, first = 0.0, True
        for place, gain, offset in self._sums[number]:
            term = float(values[place])
            if gain != 1.0 or offset != 0.0:
                term = gain * term + offset
            total = term if first else total + term
            first = False
        memories = self.memories[number]
        for position, link in enumerate(self._links[number]):
            if not math.isfinite(total):
                return total  # ends the run in any case
            link.x[0] = total
            for further, place in enumerate(link.reads, 1):
                link.x[further] = float(values[place])
            memory = memories[position]
            if commit and len(memory) and (longer := link.grown(memory)) is not memory:
                memory = memories[position] = longer
            try:
                total = float(link.kernel(time, link.x, link.options, memory, commit))
            except Exception as error:  # a user's kernel may fail in any way
                raise self._failed(number, position, time, error) from error
        return total

    def _failed(self, number: int, position: int, time: float, error: Exception) -> StepError:
        connection = self._layout.wired[number].connection
        assert connection.wire is not None
        name = connection.wire.every_link[position - len(self._links[number])].name
        return StepError(
            f"effect {name} on {connection} failed: {type(error).__name__}: {error}",
            instance=connection.source.instance,
            time=time,
            status="error",
        )

    def snapshot(self) -> Callable[[], None]:
        """Copy the memories. Returns: a function that restores them, as often as it is called."""
        kept = [[memory.copy() for memory in memories] for memories in self.memories]

        def back() -> None:
            self.memories = [[memory.copy() for memory in memories] for memories in kept]

        return back

    def reserve(self, step_size: float) -> None:
        """Make room for instants that are `step_size` apart [s], so that no memory has to grow."""
        for number, one in enumerate(self._layout.wired):
            for position, (effect, _) in enumerate(one.links):
                memory = self.memories[number][position]
                while len(memory) < effect.room(step_size):
                    memory = effect.enlarged(memory)
                self.memories[number][position] = memory


class _Running:
    """An effect with what its kernel is given."""

    def __init__(self, effect: Effect, reads: np.ndarray) -> None:
        self.kernel, self.grown = effect.kernel, effect.grown
        # Lists: what kernels take of them are Python's floats, which are faster than numpy's.
        self.options = effect.numbers()
        self.x = [0.0] * (1 + len(reads))
        self.reads = reads.tolist()
