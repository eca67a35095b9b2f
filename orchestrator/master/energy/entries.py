"""Which samples a system's bonds multiply, and which energies each product counts in."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ...fmi import Array
from ...system.connection import Connection, Port
from ...system.power_bonds import Bond
from ...system.system import System


@dataclass
class Entries:
    """Columns of the samples that are multiplied, and how products add up to energies.

    Attributes:
        columns: of samples: "output", "input" or "carried" (what comes out of a connection's effects), each
            of a port.
        products: columns of effort and motion, and whether the motion is a displacement.
        taken, given: of each bond, the place of its energy among all; created: of each of its connections.
        partners: column of the input by which a column's instance answers within the bond, by column.
        jumping: columns that depend directly on an input; curved: those that run on a parabola anyway.
    """

    columns: list[tuple[str, Port]] = field(default_factory=list)
    products: list[tuple[int, int, bool]] = field(default_factory=list)
    taken: list[int] = field(default_factory=list)
    given: list[int] = field(default_factory=list)
    created: list[list[int]] = field(default_factory=list)
    partners: dict[int, int] = field(default_factory=dict)
    jumping: set[int] = field(default_factory=set)
    curved: set[int] = field(default_factory=set)
    _terms: list[tuple[int, int, float]] = field(default_factory=list)
    _count: int = 0

    @staticmethod
    def of(system: System) -> Entries:
        """Those of all bonds of a system."""
        found = Entries()
        for bond in system.bonds:
            found._enter(bond, _jumps(bond, system))
        return found

    def sums(self) -> Array:
        """By which products are added up to energies, shape (products, energies)."""
        found = np.zeros((len(self.products), self._count))
        for product, place, factor in self._terms:
            found[product, place] += factor
        return found

    def _enter(self, bond: Bond, jumps: dict[Port, bool]) -> None:
        whole, *displaced = bond.displaced
        effort = self._output(bond.effort[0].source, bond.flow[-1].target if bond.flow else None, jumps)
        motion = self._output(bond.motion, bond.effort[-1].target, jumps, whole)
        given_to = self._column("input", bond.effort[-1].target)
        self.taken.append(self._energy((given_to, motion, whole, bond.sign)))
        if bond.flow:
            last = self._column("input", bond.flow[-1].target)
            self.given.append(self._energy((effort, last, displaced[-1], bond.sign)))
        else:
            self.given.append(self._energy((effort, motion, whole, bond.sign)))
        created = []
        for number, leg in enumerate(bond.effort):
            source = self._output(leg.source, bond.effort[number - 1].target, jumps) if number else effort
            source, target = self._carried(leg, source, jumps), self._column("input", leg.target)
            created.append(
                self._energy((target, motion, whole, bond.sign), (source, motion, whole, -bond.sign))
            )
        for number, (leg, moved) in enumerate(zip(bond.flow, displaced, strict=True)):
            source = (
                self._output(leg.source, bond.flow[number - 1].target, jumps, moved) if number else motion
            )
            source, target = self._carried(leg, source, jumps), self._column("input", leg.target)
            created.append(
                self._energy((effort, target, moved, -bond.sign), (effort, source, moved, bond.sign))
            )
        self.created.append(created)

    def _output(self, port: Port, fed: Port | None, jumps: dict[Port, bool], moved: bool = False) -> int:
        """The column of an output, whose instance answers by the input `fed`, if it has one in the bond."""
        column = self._column("output", port)
        if fed is not None:
            self.partners[column] = self._column("input", fed)
        if jumps[port]:
            self.jumping.add(column)
        if moved or fed is None:
            self.curved.add(column)
        return column

    def _carried(self, leg: Connection, plain: int, jumps: dict[Port, bool]) -> int:
        """What the target was to be given: what comes out of the connection's effects, if any."""
        if leg.wire is None:
            return plain
        column = self._column("carried", leg.target)
        self.partners[column] = self.partners.get(plain, -1)
        if jumps[leg.source] and leg.source in leg.passed_at_once:
            self.jumping.add(column)
        if plain in self.curved:
            self.curved.add(column)
        return column

    def _energy(self, *terms: tuple[int, int, bool, float]) -> int:
        """A place of its own for the sum of products of effort and motion, each with a factor."""
        for effort, motion, displaced, factor in terms:
            self._terms.append((self._product(effort, motion, displaced), self._count, factor))
        self._count += 1
        return self._count - 1

    def _column(self, kind: str, port: Port) -> int:
        key = kind, port
        if key not in self.columns:
            self.columns.append(key)
        return self.columns.index(key)

    def _product(self, effort: int, motion: int, displaced: bool) -> int:
        key = effort, motion, displaced
        if key not in self.products:
            self.products.append(key)
        return self.products.index(key)


def _jumps(bond: Bond, system: System) -> dict[Port, bool]:
    """Which outputs on a bond's way depend directly on an input that is connected."""
    targets = {connection.target for connection in system.connections}
    found = {}
    for port in (bond.motion, *(leg.source for leg in (*bond.effort, *bond.flow))):
        one = system.instances[system.position[port.instance]]
        fed = one.feedthrough.get(port.variable, ())
        found[port] = any(Port(port.instance, name) in targets for name in fed)
    return found
