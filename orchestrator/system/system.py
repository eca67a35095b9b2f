"""A system that is known to fit together: instances, connections and the order that they impose.

Systems are made, and checked, by `orchestrator.system.assembly`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property

from ..base import graph
from ..fmi import Fmu, Value, Variable
from .connection import Connection, Port
from .power_bonds import Bond


@dataclass(frozen=True)
class Instance:
    """A checked instance: start values are numbers in the FMU's units, dependencies are settled.

    Attributes:
        ratio: its own step size over the communication step size: n or 1/n.
        assumed: outputs whose dependencies neither the FMU nor the config declares.
        unconnected: inputs without a connection that keep the start value that the FMU declares.
    """

    name: str
    fmu: Fmu
    start: Mapping[str, Value]
    feedthrough: Mapping[str, tuple[str, ...]]
    initial_feedthrough: Mapping[str, tuple[str, ...]]
    ratio: Fraction = Fraction(1)
    assumed: frozenset[str] = frozenset()
    unconnected: frozenset[str] = frozenset()

    def variable(self, name: str) -> Variable:
        """A variable of the FMU."""
        return self.fmu.description.variables[name]


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
        longest_step: the largest communication step [s] for which delays keep what they connect apart, on
            which order and loops rely; None if none does.
        bonds: connections that carry energy.
        held: ports on algebraic loops that only assumed dependencies close, and that are not solved but held
            over a step; at initialisation, too, they need not agree.
    """

    instances: tuple[Instance, ...]
    connections: tuple[Connection, ...]
    recorded: tuple[Port, ...]
    notes: tuple[str, ...] = ()
    loops: tuple[tuple[Port, ...], ...] = ()
    longest_step: float | None = None
    bonds: tuple[Bond, ...] = ()
    held: frozenset[Port] = frozenset()

    @cached_property
    def position(self) -> Mapping[str, int]:
        """Index of each instance by name."""
        return {instance.name: index for index, instance in enumerate(self.instances)}

    def variable(self, port: Port) -> Variable:
        """The variable behind a port."""
        return self.instances[self.position[port.instance]].variable(port.variable)

    def start(self, port: Port) -> float:
        """Start value of a scalar real variable: the config's, else its FMU's; 0 where neither gives one."""
        part = self.instances[self.position[port.instance]]
        return float(part.start.get(port.variable, part.variable(port.variable).start or 0.0))

    @cached_property
    def order(self) -> tuple[int, ...]:
        """Indices of the instances in the order of direct feedthrough; the config's order breaks ties.

        An instance comes after those whose outputs it passes on within one instant. Where that leaves it
        open, effects count as if they passed signals on at once. So a delay that outgrows the step does not
        change the order.
        """
        through = [{port for ports in one.feedthrough.values() for port in ports} for one in self.instances]
        successors: list[set[int]] = [set() for _ in self.instances]
        kept_back: list[tuple[int, int]] = []
        for connection in self.connections:
            target = self.position[connection.target.instance]
            if connection.target.variable in through[target]:
                sources = {self.position[port.instance] for port in connection.passed_at_once} - {target}
                for source in sources:
                    successors[source].add(target)
                others = {self.position[port.instance] for port in connection.sources} - sources - {target}
                kept_back += [(source, target) for source in others]
        if not kept_back:
            return graph.stable_order([sorted(below) for below in successors])
        every = [set(below) for below in successors]
        for source, target in kept_back:
            every[source].add(target)
        wished = graph.stable_order([sorted(below) for below in every])
        rank = {index: place for place, index in enumerate(wished)}
        ranked = [sorted(rank[below] for below in successors[index]) for index in wished]
        return tuple(wished[place] for place in graph.stable_order(ranked))

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
            sources, own = [nodes[port] for port in connection.sources], home[nodes[connection.target]]
            latest = max(level[source] for source in sources)
            if any(home[source] == own for source in sources):
                loops.setdefault(latest, {}).setdefault(own, []).append(connection)
            else:
                served.setdefault(latest, []).append(connection)
        keys = sorted(served.keys() | loops.keys())
        return (
            tuple(tuple(served.get(key, ())) for key in keys),
            tuple(tuple(tuple(one) for one in loops.get(key, {}).values()) for key in keys),
        )


def port_graph(
    instances: Sequence[Instance], connections: Sequence[Connection], *, initial: bool = False
) -> tuple[dict[Port, int], list[list[int]]]:
    """Ports as nodes; edges from source to target and from input to each output that depends on it.

    A connection whose effects keep the two apart has no edge, except at initialisation, where they remember
    nothing.
    """
    nodes: dict[Port, int] = {}
    successors: list[list[int]] = []

    def node(port: Port) -> int:
        if port not in nodes:
            nodes[port] = len(successors)
            successors.append([])
        return nodes[port]

    for connection in connections:
        for port in connection.sources:
            node(port)
        target = node(connection.target)
        for port in connection.sources if initial else connection.passed_at_once:
            successors[nodes[port]].append(target)
    for one in instances:
        for output, inputs in (one.initial_feedthrough if initial else one.feedthrough).items():
            for name in inputs:
                # Ports without a connection are on no path.
                port = Port(one.name, name)
                if port in nodes and Port(one.name, output) in nodes:
                    successors[nodes[port]].append(nodes[Port(one.name, output)])
    return nodes, successors
