"""The coupling ledger of a run: receives every step, and sums the energy exchanged and created."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...fmi import Array, Point
from ...system.signal_vector import Layout, Signals
from ...system.system import System
from ..running_instances import Instances
from .books import Before, Books, Step

_ROWS = 1024
# Largest number of points that are kept; above it, every second point is dropped, repeatedly.
_MOST_KEPT = 1 << 16


@dataclass(frozen=True)
class Account:
    """Energies of a bond over a run [J].

    Attributes:
        taken, given: by the taker from the connections, and by the giver to them.
        created: by the coupling.
        parts: of `created`, per connection.
        exchanged: all energy that went to or from the taker, regardless of its direction.
    """

    taken: float
    given: float
    created: float
    parts: dict[str, float]
    exchanged: float

    def summary(self) -> dict[str, Any]:
        """As in summary.json."""
        return {
            "created": self.created,
            "relative": self.created / self.exchanged if self.exchanged > 0.0 else None,
            "exchanged": self.exchanged,
            "taken": self.taken,
            "given": self.given,
            "between": self.taken - self.given - self.created,
            "connections": self.parts,
        }


class Ledger:
    """Energies of all bonds at every point of a run, from the steps that it receives.

    Attributes:
        books: how energies are computed.
    """

    def __init__(self, system: System, *, every: int = 1) -> None:
        """
        Args:
            system: what runs.
            every: keep the course of the energies at every n-th communication point; of long runs at every
                2 n-th, 4 n-th, ..., so that memory does not grow with them.
        """
        self.layout = Layout.of(system)
        self.books = Books(system, self.layout)
        self._every = every
        bonds = len(self.books.bonds)
        self._totals = np.zeros((3, bonds))
        self._exchanged = np.zeros(bonds)
        self._parts = np.zeros(sum(len(one) for one in self.books.names))
        self._times: list[Array] = []
        self._recorded: list[Array] = []
        # Rows of steps that are still to be entered; outputs have one row more, the first being the begin.
        self._sizes = np.empty(_ROWS)
        self._outputs = self.books.outputs(np.empty((_ROWS + 1, self.layout.size)))
        self._inputs = np.empty((_ROWS, 3, len(self.books.inputs)))
        self._used = 0
        # Points that are kept: after which rows they are reached, time, index.
        self._ends: list[tuple[int, float, int]] = []
        self._kept = 0
        self._before: Before | None = None
        self._late: NDArray[np.bool_] | None = None

    def __bool__(self) -> bool:
        return bool(self.books.bonds)

    def begin(self, time: float, values: Array) -> None:
        """See the first point: signals, shape (layout.size,)."""
        self._before = self.books.start(values)
        self._outputs[0] = self.books.outputs(values)
        self._kept = 1
        self._times.append(np.array([time]))
        self._recorded.append(np.zeros((1, 3, len(self.books.bonds))))

    def stepped(self, point: Point, steps: Sequence[Step]) -> None:
        """See what happened between the point that is reached and the one before it.

        Args:
            point: where the steps end.
            steps: one, or the parts that it was divided in.
        """
        for step in steps:
            if self._used == len(self._sizes):
                self._grow()
            self._used = row = self._used + 1
            self._sizes[row - 1] = step.size
            self._outputs[row] = self.books.outputs(step.after)
            self._inputs[row - 1] = step.inputs
        if point.index % self._every == 0:
            self._ends.append((self._used, point.time, point.index))
        if self._used >= _ROWS and self._used % self.books.stride == 0:
            self.settle()

    def _grow(self) -> None:
        """Make room for twice as many steps."""
        room = len(self._sizes)
        self._sizes = np.concatenate([self._sizes, np.empty(room)])
        self._outputs = np.concatenate([self._outputs, np.empty((room, self._outputs.shape[1]))])
        self._inputs = np.concatenate([self._inputs, np.empty((room, *self._inputs.shape[1:]))])

    def settle(self) -> None:
        """Bring the books up to date."""
        whole = self._used // self.books.stride * self.books.stride
        if self._before is None or not whole:
            return
        kept = [one for one in self._ends if one[0] <= whole and one[2] % self._every == 0]
        self._account(
            self._sizes[:whole],
            self._outputs[: whole + 1],
            self._inputs[:whole],
            np.array([row for row, _, _ in kept], np.intp),
            np.array([time for _, time, _ in kept]),
        )
        left = self._used - whole
        self._sizes[:left] = self._sizes[whole : self._used].copy()
        self._inputs[:left] = self._inputs[whole : self._used].copy()
        self._outputs[: left + 1] = self._outputs[whole : self._used + 1].copy()
        self._ends = [(row - whole, time, index) for row, time, index in self._ends if row > whole]
        self._used = left

    def _account(
        self, sizes: Array, outputs: Array, inputs: Array, rows: NDArray[np.intp], times: Array
    ) -> None:
        """Enter steps; `rows`: after how many of them points were reached that are kept, at `times`."""
        assert self._before is not None
        # Energies of a run that diverges leave the range of numbers before its signals do, and it ends then.
        with np.errstate(over="ignore", invalid="ignore"):
            taken, given, parts, self._before = self.books.energies(sizes, outputs, inputs, self._before)
            steps = np.stack([taken, given, self.books.per_bond(parts)], axis=1)
            course = _summed(self._totals, steps)
            self._exchanged = _summed(self._exchanged, np.abs(taken))[-1]
            self._parts = _summed(self._parts, parts)[-1]
        self._times.append(times)
        self._recorded.append(course[rows - 1])
        self._totals = course[-1]
        self._kept += len(times)
        while self._kept > _MOST_KEPT:
            self._every *= 2
            self._times = [np.concatenate(self._times)[::2].copy()]
            self._recorded = [np.concatenate(self._recorded)[::2].copy()]
            self._kept = len(self._times[0])

    # For the native loop, whose inputs follow from the order of stepping.

    def schedule(self, instances: Instances, order: Sequence[int], late: bool, step_size: float) -> None:
        """Set how inputs are fed, see `Books.late`, and the step size [s]."""
        self._late = self.books.late(instances, order, late)
        self._step_size = step_size
        self._tail = np.empty((0, self.layout.size))

    def observe_block(self, first: int, times: Array, values: Array) -> None:
        """See consecutive points of a run whose inputs are held; see BlockObserver."""
        assert self._late is not None
        if self._before is None:
            self.begin(float(times[0]), values[0])
            self._tail = values[:1].copy()
            first, times, values = first + 1, times[1:], values[1:]
        if not len(values):
            return
        rows = np.concatenate([self._tail, values])
        sizes = np.full(len(values), self._step_size)
        kept = np.flatnonzero((first + np.arange(len(values))) % self._every == 0)
        inputs = self.books.held(rows, self._late)
        self._account(sizes, self.books.outputs(rows), inputs, kept + 1, times[kept])
        self._tail = values[-1:].copy()

    def __call__(self, point: Point, signals: Signals) -> None:
        """See one point of a run whose inputs are held."""
        self.observe_block(point.index, np.array([point.time]), signals.values[None])

    # What came of it.

    def accounts(self) -> dict[str, Account]:
        """The energies of each bond over the run so far, by the bond's name."""
        self.settle()
        made, first = {}, 0
        for place, (bond, names) in enumerate(zip(self.books.bonds, self.books.names, strict=True)):
            parts = self._parts[first : first + len(names)].tolist()
            first += len(names)
            taken, given, created = self._totals[:, place].tolist()
            exchanged = float(self._exchanged[place])
            by_connection = dict(zip(names, parts, strict=True))
            made[bond.name] = Account(taken, given, created, by_connection, exchanged)
        return made

    def summary(self) -> dict[str, Any]:
        """As in summary.json, by the bond's name."""
        return {name: account.summary() for name, account in self.accounts().items()}

    def energies_over_time(self) -> tuple[Array, dict[str, Array]]:
        """Energies over time, from the start: times, shape (n,) [s], and per bond, shape (n, 3) [J]: taken,
        given, created.
        """
        self.settle()
        times = np.concatenate(self._times) if self._times else np.zeros(0)
        whole = np.concatenate(self._recorded) if self._recorded else np.zeros((0, 3, len(self.books.bonds)))
        return times, {bond.name: whole[:, :, n] for n, bond in enumerate(self.books.bonds)}


def _summed(total: Array, steps: Array) -> Array:
    """Sums up to each step, one after the other: how a run is cut into blocks changes no digit of them."""
    return np.cumsum(np.concatenate([total[None], steps]), axis=0)[1:]
