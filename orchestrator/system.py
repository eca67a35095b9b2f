"""A system that is known to fit together: instances, connections and the order that they impose.

Systems are made, and checked, by `orchestrator.assembly`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import NamedTuple

from . import graph
from .fmi import Fmu, Value, Variable

__all__ = ["Connection", "Instance", "Port", "System", "port_graph"]


class Port(NamedTuple):
    """A variable of an instance."""

    instance: str
    variable: str

    def __str__(self) -> str:
        return f"{self.instance}.{self.variable}"


@dataclass(frozen=True)
class Instance:
    """A checked instance: start values are numbers in the FMU's units, dependencies are settled.

    Attributes:
        ratio: its own step size over the communication step size: n or 1/n.
    """

    name: str
    fmu: Fmu
    start: Mapping[str, Value]
    feedthrough: Mapping[str, tuple[str, ...]]
    initial_feedthrough: Mapping[str, tuple[str, ...]]
    ratio: Fraction = Fraction(1)

    def variable(self, name: str) -> Variable:
        """A variable of the FMU."""
        return self.fmu.description.variables[name]


@dataclass(frozen=True)
class Connection:
    """A checked connection: value at the target = gain * value at the source + offset (unit conversion)."""

    source: Port
    target: Port
    gain: float = 1.0
    offset: float = 0.0

    def __str__(self) -> str:
        return f"{self.source} -> {self.target}"


@dataclass(frozen=True)
class System:
    """A checked system.

    Attributes:
        instances: in the config's order.
        connections: in the config's order.
        recorded: numeric signals to record; the names that measures and results use.
        notes: what was accepted but could not be checked.
        loops: algebraic loops at communication points, inputs and outputs in turn; only some masters solve
            them.
    """

    instances: tuple[Instance, ...]
    connections: tuple[Connection, ...]
    recorded: tuple[Port, ...]
    notes: tuple[str, ...] = ()
    loops: tuple[tuple[Port, ...], ...] = ()

    @cached_property
    def position(self) -> Mapping[str, int]:
        """Index of each instance by name."""
        return {instance.name: index for index, instance in enumerate(self.instances)}

    def variable(self, port: Port) -> Variable:
        """The variable behind a port."""
        return self.instances[self.position[port.instance]].variable(port.variable)

    @cached_property
    def order(self) -> tuple[int, ...]:
        """Indices of the instances in the order of direct feedthrough; the config's order breaks ties.

        An instance comes after those whose outputs it passes on within one instant.
        """
        through = [{port for ports in one.feedthrough.values() for port in ports} for one in self.instances]
        successors: list[set[int]] = [set() for _ in self.instances]
        for connection in self.connections:
            source = self.position[connection.source.instance]
            target = self.position[connection.target.instance]
            if source != target and connection.target.variable in through[target]:
                successors[source].add(target)
        return graph.stable_order([sorted(below) for below in successors])

    @cached_property
    def initial_levels(self) -> tuple[tuple[Connection, ...], ...]:
        """Connections by the round in which they are served at initialisation.

        All sources of a round can be read once the targets of the earlier rounds are set, and the loops of
        this one (see `initial_loops`) are solved.
        """
        return self._initial[0]

    @cached_property
    def initial_loops(self) -> tuple[tuple[tuple[Connection, ...], ...], ...]:
        """Per round of `initial_levels`, the connections of each algebraic loop that it begins with."""
        return self._initial[1]

    @cached_property
    def _initial(
        self,
    ) -> tuple[tuple[tuple[Connection, ...], ...], tuple[tuple[tuple[Connection, ...], ...], ...]]:
        nodes, successors = port_graph(self.instances, self.connections, initial=True)
        level = graph.levels(successors)
        components = graph.strong_components(successors)
        home = {node: index for index, members in enumerate(components) for node in members}
        served: dict[int, list[Connection]] = {}
        loops: dict[int, dict[int, list[Connection]]] = {}
        for connection in self.connections:
            source, target = nodes[connection.source], nodes[connection.target]
            if home[source] == home[target]:
                loops.setdefault(level[source], {}).setdefault(home[source], []).append(connection)
            else:
                served.setdefault(level[source], []).append(connection)
        keys = sorted(served.keys() | loops.keys())
        return (
            tuple(tuple(served.get(key, ())) for key in keys),
            tuple(tuple(tuple(one) for one in loops.get(key, {}).values()) for key in keys),
        )


def port_graph(
    instances: Sequence[Instance], connections: Sequence[Connection], *, initial: bool = False
) -> tuple[dict[Port, int], list[list[int]]]:
    """Ports as nodes; edges from source to target and from input to each output that depends on it."""
    nodes: dict[Port, int] = {}
    successors: list[list[int]] = []

    def node(port: Port) -> int:
        if port not in nodes:
            nodes[port] = len(successors)
            successors.append([])
        return nodes[port]

    for connection in connections:
        successors[node(connection.source)].append(node(connection.target))
    for one in instances:
        for output, inputs in (one.initial_feedthrough if initial else one.feedthrough).items():
            for name in inputs:
                # Ports without a connection are on no path.
                port = Port(one.name, name)
                if port in nodes and Port(one.name, output) in nodes:
                    successors[nodes[port]].append(nodes[Port(one.name, output)])
    return nodes, successors
