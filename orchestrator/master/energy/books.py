"""The coupling ledger: the energy that holding inputs over communication steps makes or destroys.

Take an effort e [N, N.m, V, Pa] that instance A gives and B takes, and the flow f [m/s, rad/s, A, m3/s] with
which B answers and which A receives. Over a step B works with what it was given for e, written e~, A with
what it was given for f, written f~. Then

    taken   = integral of e~ f dt       energy that B takes in
    given   = integral of e f~ dt       energy that A gives away
    created = taken - given             energy that neither had: the coupling made it

This is the integral of the power residual of Sadjina, Kyllingstad, Skjong and Pedersen (Energy conservation
and power bonds in co-simulations, Engineering with Computers 33, 2017). Benedikt's NEPCE corrects it. It is
the sum of what its two connections do, each with the true partner of what it carries:

    created = integral of (e~ - e) f dt  -  integral of e (f~ - f) dt

In this form it also holds for longer ways, as through a robot that moves by the motion which it is given. A
force that is held on the way adds (e~ - e) times the taker's flow; a motion that is held there takes e times
(f~ - f). The rest of taken - given is what the instances on the way inject of themselves, `between`. If they
filter what a connection carries, its share is right to leading order only: as if they passed it on at once.

Where effects stand on a connection, e and f of it are what comes out of them: they are part of the system,
and what they take or give counts as `between`.

Where A is reported a displacement x, the work is the integral of e dx~: a held x~ jumps at the communication
points, by what the source moved, against the mean of the effort before and after.

Signals are known at communication points, inputs over the whole step; products are integrated by Simpson's
rule. While an instance holds its input, its output runs straight between two points, as that of a mass or a
spring does. Where the input runs, too, it runs on the parabola through the point before. Displacements always
do the latter. The error of an energy is then of second order in the step at most, while what is measured is
of first order for held inputs. An output that depends directly on a held input jumps with it. Its jump is
taken from the change over the step, as if it depended on that input alone. That is exact for components
without states (contacts, springs, gears), and of first order where a state is added to the input.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import lcm

import numpy as np
from numpy.typing import NDArray

from ...fmi import Array
from ...system.connection import Port
from ...system.signal_vector import Layout
from ...system.system import System
from ..running_instances import Instances
from .entries import Entries


@dataclass(frozen=True)
class Step:
    """A step that counts, for who looks at it.

    Attributes:
        size: [s].
        after: signals at its end, shape (layout.size,).
        inputs: see `Instances.inputs_over_step`.
    """

    size: float
    after: Array
    inputs: Array


@dataclass
class Before:
    """What a step needs of the one before it: its inputs' ends, its outputs' slopes, and its size."""

    ends: Array
    slopes: Array | None = None
    size: float = 0.0


class Books:
    """How the energies of a system's bonds are computed from signals and inputs.

    Attributes:
        bonds: of the system.
        names: of the connections, per bond.
        inputs: places of the inputs that are needed, see `Instances.inputs_over_step`.
    """

    def __init__(self, system: System, layout: Layout) -> None:
        self.bonds = system.bonds
        entries = Entries.of(system)
        self.names = [[str(one) for one in (*bond.effort, *bond.flow)] for bond in system.bonds]
        self._taken, self._given, self._created = entries.taken, entries.given, entries.created
        self._sums = entries.sums()
        self._effort = np.array([one[0] for one in entries.products], np.intp)
        self._motion = np.array([one[1] for one in entries.products], np.intp)
        self._displaced = np.array([one[2] for one in entries.products], np.bool_)
        self._bind(system, layout, entries.columns)
        # Without an input of its own in the bond an output counts as jumping all at once.
        partners = [entries.partners.get(column, -1) for column in self._outputs.tolist()]
        self._partner = np.array(partners, np.intp)
        self._is_jumping = np.isin(self._outputs, list(entries.jumping))
        self._is_curved = np.isin(self._outputs, list(entries.curved))

    def _bind(self, system: System, layout: Layout, columns: Sequence[tuple[str, Port]]) -> None:
        """Find the columns in the vectors of signals and inputs, and bring them to SI units."""
        first = np.cumsum([0, *(len(one.names) for one in layout.inputs)])
        kinds = [kind == "input" for kind, _ in columns]
        self._outputs = np.flatnonzero(np.logical_not(kinds))
        self._fed = np.flatnonzero(kinds)
        units = [system.variable(port).unit for _, port in columns]
        self._factor = np.array([float(unit.factor) if unit else 1.0 for unit in units])
        self._offset = np.array([float(unit.offset) if unit else 0.0 for unit in units])
        wired = {one.connection.target: one for one in layout.wired}
        self._read = np.zeros(len(self._outputs), np.intp)
        for row, column in enumerate(self._outputs.tolist()):
            kind, port = columns[column]
            if kind == "output":
                self._read[row] = layout.index[port]
                continue
            connection = wired[port].connection
            self._read[row] = wired[port].place
            self._offset[column] += self._factor[column] * connection.offset
            self._factor[column] *= connection.gain
        self.inputs = np.zeros(len(self._fed), np.intp)
        self._sources = np.zeros(len(self._fed), np.intp)
        self._gain, self._shift = np.ones(len(self._fed)), np.zeros(len(self._fed))
        owners = []
        for row, column in enumerate(self._fed.tolist()):
            port = columns[column][1]
            index = system.position[port.instance]
            owners.append(index)
            inputs = layout.inputs[index]
            place = inputs.names.index(port.variable)
            self.inputs[row] = first[index] + place
            self._sources[row] = inputs.source[place]
            if inputs.gain is not None and inputs.offset is not None:
                self._gain[row], self._shift[row] = inputs.gain[place], inputs.offset[place]
        self._owners = np.array(owners, np.intp)
        self._every = [one.ratio.numerator for one in system.instances]
        owned = (layout.owners[place].instance for place in self._read.tolist())
        self._read_owner = np.array([system.position[name] for name in owned], np.intp)

    # How often energies can be computed where instances are slow: after so many communication steps.
    @property
    def stride(self) -> int:
        """Communication steps after which every instance of a bond has ended a step."""
        owners = {int(one) for one in (*self._owners, *self._read_owner)}
        return lcm(*(self._every[one] for one in owners)) if owners else 1

    def outputs(self, values: Array) -> Array:
        """Of signals, shape (..., layout.size), those that are needed."""
        return values[..., self._read]

    def start(self, values: Array) -> Before:
        """What precedes the first step: inputs as their sources were at the start, shape (layout.size,)."""
        return Before(self._scaled_inputs(self._gain * values[self._sources] + self._shift))

    def held(self, values: Array, late: NDArray[np.bool_]) -> Array:
        """Inputs that were held over steps.

        Args:
            values: signals at the points, shape (n + 1, layout.size).
            late: which of `inputs` were given the value of the step's end, not of its beginning.
        Returns: shape (n, 3, len(inputs)).
        """
        sources = values[:, self._sources]
        held = np.where(late, sources[1:], sources[:-1]) * self._gain + self._shift
        return np.broadcast_to(held[:, None, :], (len(held), 3, len(self._fed)))

    def late(self, instances: Instances, order: Sequence[int], last: bool) -> NDArray[np.bool_]:
        """Which inputs are given the value of the step's end, by a master that steps in this order.

        Args:
            last: whether inputs are fed right before each instance's own step, not all at the beginning.
        """
        rank = {index: place for place, index in enumerate(order)}
        owners, position = instances.layout.owners, instances.system.position
        gives = [position[owners[place].instance] for place in self._sources.tolist()]
        return np.array(
            [last and rank[one] < rank[int(own)] for one, own in zip(gives, self._owners, strict=True)],
            np.bool_,
        )

    def _scaled_inputs(self, values: Array) -> Array:
        return values * self._factor[self._fed] + self._offset[self._fed]

    def energies(
        self, sizes: Array, outputs: Array, inputs: Array, before: Before
    ) -> tuple[Array, Array, Array, Before]:
        """Energies of consecutive steps.

        Args:
            sizes: of the steps, shape (n,) [s].
            outputs: at the points, see `outputs`, shape (n + 1, ...).
            inputs: over the steps, shape (n, 3, len(inputs)).
            before: what precedes the first of the steps.
        Returns: taken, given, shape (n, bonds) each, created, shape (n, connections of all bonds) [J]; and
            what precedes the next step.
        """
        outputs, inputs = self._unfrozen(outputs, inputs)
        count, width = len(sizes), len(self._factor)
        # One row a signal: the steps of a signal lie side by side in memory.
        own = np.ascontiguousarray(outputs.T) * self._factor[self._outputs, None]
        own += self._offset[self._outputs, None]
        fed = np.ascontiguousarray(np.moveaxis(self._scaled_inputs(inputs), 0, 2))
        earlier = np.concatenate([before.ends[:, None], fed[2, :, :-1]], axis=1) if count else fed[2]
        last, first, middle, end = (np.empty((width, count)) for _ in range(4))
        last[self._outputs] = first[self._outputs] = own[:, :-1]
        end[self._outputs] = own[:, 1:]
        slopes = (own[:, 1:] - own[:, :-1]) / sizes
        slopes_before = slopes[:, :1] if before.slopes is None else before.slopes[:, None]
        sizes_before = np.concatenate([[before.size], sizes[:-1]])
        bend = slopes - np.concatenate([slopes_before, slopes[:, :-1]], axis=1)
        weight = sizes**2 / (4.0 * (sizes + sizes_before))
        last[self._fed] = earlier
        first[self._fed], middle[self._fed], end[self._fed] = fed
        runs = (first[self._partner] != end[self._partner]) & (self._partner >= 0)[:, None]
        runs |= self._is_curved[:, None]
        middle[self._outputs] = 0.5 * (own[:, 1:] + own[:, :-1]) - np.where(runs, weight * bend, 0.0)
        self._jump(last, first, middle, end)
        p, q, moved = self._effort, self._motion, self._displaced
        # Where a bond gives positions: slopes, times the step, of the parabola through three samples.
        a, b, c = first[q], middle[q], end[q]
        x, y, z = a[moved], b[moved], c[moved]
        a[moved], b[moved], c[moved] = -3.0 * x + 4.0 * y - z, z - x, x - 4.0 * y + 3.0 * z
        work = np.where(moved[:, None], 1.0, sizes) / 6.0
        work *= first[p] * a + 4.0 * middle[p] * b + end[p] * c
        p, q = p[moved], q[moved]
        work[moved] += 0.5 * (last[p] + first[p]) * (first[q] - last[q])
        # Not by a matrix product of BLAS, whose rounding depends on where arrays lie in memory.
        sums = np.einsum("ps,pt->st", work, self._sums)
        created = [place for places in self._created for place in places]
        if not count:
            return sums[:, self._taken], sums[:, self._given], sums[:, created], before
        after = Before(fed[2, :, -1], slopes[:, -1], float(sizes[-1]))
        return sums[:, self._taken], sums[:, self._given], sums[:, created], after

    def _jump(self, last: Array, first: Array, middle: Array, end: Array) -> None:
        """Let outputs that depend directly on an input jump with it at the beginning of the step."""
        for place in np.flatnonzero(self._is_jumping):
            row, by = self._outputs[place], self._partner[place]
            share = np.ones(last.shape[1])
            if by >= 0:
                whole, at_once = end[by] - last[by], first[by] - last[by]
                np.divide(at_once, whole, out=share, where=whole != 0.0)
                np.clip(share, 0.0, 1.0, out=share)
            straight = last[row] + share * (end[row] - last[row])
            # What does not jump keeps its parabola.
            middle[row] += share * (0.5 * (straight + end[row]) - middle[row])
            first[row] = straight

    def _unfrozen(self, outputs: Array, inputs: Array) -> tuple[Array, Array]:
        """Let slow instances move between the ends of their steps, where their outputs stand still.

        What jumps with a held input has the value of the step's end all along; the rest runs straight.
        """
        if self.stride == 1:
            return outputs, inputs
        outputs, inputs = outputs.copy(), inputs.copy()
        rows = np.arange(len(outputs))
        for column, owner in enumerate(self._read_owner):
            every = self._every[owner]
            if every > 1:
                ends = outputs[::every, column]
                if self._is_jumping[column]:
                    outputs[1:, column] = np.repeat(ends[1:], every)
                else:
                    outputs[:, column] = np.interp(rows, rows[::every], ends)
        for column, owner in enumerate(self._owners):
            every = self._every[owner]
            if every > 1:
                inputs[:, :, column] = np.repeat(inputs[every - 1 :: every, :, column], every, axis=0)
        return outputs, inputs

    def per_bond(self, created: Array) -> Array:
        """What each bond created, shape (n, bonds), from what its connections did."""
        ends = np.cumsum([0, *(len(one) for one in self.names)])
        return np.stack([created[:, begin:end].sum(1) for begin, end in pairwise(ends)], axis=1)
