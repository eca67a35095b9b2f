"""Instances and connections -> a system that is known to fit together.

Everything that can be known before a run is checked here, and all problems are told at once.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

from . import bundled, checks, graph
from .config import Config, ConnectionModel, Places, Scalar, endpoints
from .errors import ConfigError, FmuError, Problem, listed, nearest
from .fmi import Fmu, Value, Variable, load_fmu

__all__ = ["Connection", "Instance", "Part", "Port", "System", "assemble", "load_system"]


class Port(NamedTuple):
    """A variable of an instance."""

    instance: str
    variable: str

    def __str__(self) -> str:
        return f"{self.instance}.{self.variable}"


@dataclass(frozen=True)
class Part:
    """An instance as it is asked for, before it is checked.

    Attributes:
        name: of the instance.
        fmu: what it is made from.
        start: start values with units, as in a config.
        feedthrough: dependencies that replace the FMU's own, per output.
    """

    name: str
    fmu: Fmu
    start: Mapping[str, Scalar] = field(default_factory=dict)
    feedthrough: Mapping[str, Sequence[str]] = field(default_factory=dict)


@dataclass(frozen=True)
class Instance:
    """A checked instance: start values are numbers in the FMU's units, dependencies are settled."""

    name: str
    fmu: Fmu
    start: Mapping[str, Value]
    feedthrough: Mapping[str, tuple[str, ...]]
    initial_feedthrough: Mapping[str, tuple[str, ...]]

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
    """

    instances: tuple[Instance, ...]
    connections: tuple[Connection, ...]
    recorded: tuple[Port, ...]
    notes: tuple[str, ...] = ()

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

        All sources of a round can be read once the targets of the earlier rounds are set.
        """
        nodes, successors = _port_graph(self.instances, self.connections, initial=True)
        level = graph.levels(successors)
        rounds: dict[int, list[Connection]] = {}
        for connection in self.connections:
            rounds.setdefault(level[nodes[connection.source]], []).append(connection)
        return tuple(tuple(rounds[key]) for key in sorted(rounds))


def load_system(config: Config, needed: Mapping[str, tuple[str, ...]] | None = None) -> System:
    """The system of a config.

    Args:
        config: a validated config.
        needed: signals that are recorded whatever the config says, as instance.variable, and the path in the
            config that asks for each.
    Raises: ConfigError with all problems.
    """
    problems: list[Problem] = []
    parts: list[Part] = []
    known: dict[str, Fmu | None] = {}
    for name, instance in config.model.instances.items():
        if instance.fmu not in known:
            known[instance.fmu] = _find_fmu(instance.fmu, config, ("instances", name, "fmu"), problems)
        fmu = known[instance.fmu]
        if fmu is not None:
            parts.append(Part(name, fmu, instance.start, instance.feedthrough))
    absent = frozenset(config.model.instances) - {part.name for part in parts}
    record = config.model.run.record
    return assemble(
        parts,
        config.model.connections,
        record=None if record == "all" else record,
        needed=needed,
        places=config.places,
        problems=problems,
        absent=absent,
    )


def _find_fmu(text: str, config: Config, path: tuple[str, ...], problems: list[Problem]) -> Fmu | None:
    place = config.places.text(path)
    file = config.folder / text
    found = file if file.is_file() else bundled.find_fmu(text)
    if found is None:
        names = bundled.fmu_names()
        is_path = "/" in text or "\\" in text or text.endswith(".fmu")
        what = f"no file {file}" if is_path else f"no FMU {text!r}"
        allowed = "" if is_path else f"no file {file}; "
        allowed += f"bundled FMUs: {listed(names)}"
        problems.append(Problem(place, what, allowed, nearest(Path(text).stem, names)))
        return None
    try:
        return load_fmu(found)
    except FmuError as error:
        first, _, rest = str(error).partition("\n")
        problems.append(Problem(place, first, "\n".join(line.strip() for line in rest.splitlines())))
        return None


def assemble(
    parts: Iterable[Part],
    connections: Iterable[str | ConnectionModel] = (),
    *,
    record: Sequence[str] | None = None,
    needed: Mapping[str, tuple[str, ...]] | None = None,
    places: Places | None = None,
    problems: Iterable[Problem] = (),
    absent: frozenset[str] = frozenset(),
) -> System:
    """Check parts and connections and make a system of them.

    Args:
        parts: instances with distinct names.
        connections: "a.y -> b.u" each, or the long form.
        record: signals to record as instance.variable; None: every numeric output.
        needed: signals to record besides, and the path in the config that asks for each.
        places: where the values were written, for messages.
        problems: found earlier, to be told together with those found here.
        absent: names of instances that already have a problem: what concerns them is not judged.
    Raises: ConfigError with all problems.
    """
    parts = list(parts)
    places = places or Places("system")
    found = list(problems)
    notes: list[str] = []
    by_name = {part.name: part for part in parts}
    wired: dict[Port, tuple[int, Port]] = {}
    checked: list[Connection] = []
    for index, connection in enumerate(connections):
        made = _connect(endpoints(connection), ("connections", index), by_name, absent, places, found, notes)
        if made is None:
            continue
        if made.target in wired:
            first, source = wired[made.target]
            what = f"{made.target} has two sources, {source} and {made.source}"
            allowed = f"connections[{first}] already feeds it; an input takes one source"
            found.append(Problem(places.text(("connections", index)), what, allowed, "Remove one of the two."))
            continue
        wired[made.target] = (index, made.source)
        checked.append(made)
    instances = [_settle(part, wired, places, found) for part in parts]
    found += checks.shared_process(parts, places)
    wanted: dict[str, tuple[str | int, ...]] = {}
    for index, text in enumerate(record or ()):
        wanted.setdefault(text, ("run", "record", index))
    for text, path in (needed or {}).items():
        wanted.setdefault(text, path)
    recorded = _recorded(record is None, wanted, instances, absent, places, found)
    if not found:
        found += _algebraic_loops(instances, checked, places)
    if found:
        raise ConfigError(found)
    return System(tuple(instances), tuple(checked), recorded, tuple(notes))


def _connect(
    ends: tuple[str, str],
    path: tuple[str | int, ...],
    parts: Mapping[str, Part],
    absent: frozenset[str],
    places: Places,
    problems: list[Problem],
    notes: list[str],
) -> Connection | None:
    place = places.text(path)
    ports = []
    for text in ends:
        name, dot, variable = text.partition(".")
        if name in absent:
            return None
        if name not in parts:
            what = f"no instance {name!r} in {ends[0]} -> {ends[1]}"
            problems.append(Problem(place, what, f"instances: {listed(parts)}", nearest(name, parts)))
        elif not dot:
            problems.append(Problem(place, f"{text!r} names no variable", f"written as {name}.variable"))
        else:
            ports.append(Port(name, variable))
    if len(ports) < 2:
        return None
    source, target = ports
    result = checks.connection(
        source, parts[source.instance].fmu.description, target, parts[target.instance].fmu.description, place
    )
    if isinstance(result, list):
        problems += result
        return None
    gain, offset, note = result
    if note:
        notes.append(f"{place}: {note}")
    return Connection(source, target, gain, offset)


def _settle(
    part: Part, wired: Mapping[Port, tuple[int, Port]], places: Places, problems: list[Problem]
) -> Instance:
    """Start values and dependencies of a part, and its inputs that nothing feeds."""
    path = ("instances", part.name)
    description = part.fmu.description
    start: dict[str, Value] = {}
    for name, value in part.start.items():
        result = checks.start_value(part.name, description, name, value, places.text((*path, "start", name)))
        if isinstance(result, Problem):
            problems.append(result)
        else:
            start[name] = result
    for variable in description.inputs:
        feed = wired.get(Port(part.name, variable.name))
        place = places.text((*path, "start", variable.name) if variable.name in part.start else path)
        if feed is not None and variable.name in part.start:
            what = f"{part.name}.{variable.name} has two sources, {feed[1]} and a start value"
            problems.append(Problem(place, what, f"connections[{feed[0]}] feeds it", "Remove one of the two."))
        elif feed is None and variable.name not in part.start and not variable.shape:
            what = f"input {part.name}.{variable} is not connected and has no start value"
            remedy = f"Connect it, or give it a constant value under instances.{part.name}.start."
            problems.append(Problem(place, what, remedy=remedy))
    feedthrough, initial = checks.dependencies(part.name, description, part.feedthrough, places, problems)
    return Instance(part.name, part.fmu, start, feedthrough, initial)


def _recorded(
    outputs: bool,
    wanted: Mapping[str, tuple[str | int, ...]],
    instances: Sequence[Instance],
    absent: frozenset[str],
    places: Places,
    problems: list[Problem],
) -> tuple[Port, ...]:
    """Ports to record: all numeric outputs if `outputs`, and what is wanted besides."""
    ports = {
        Port(one.name, variable.name): None
        for one in instances if outputs
        for variable in one.fmu.description.outputs
        if variable.kind.numeric and not variable.shape
    }
    descriptions = {one.name: one.fmu.description for one in instances}
    for text, path in wanted.items():
        name, _, variable = text.partition(".")
        if name in absent:
            continue
        problem = checks.recordable(name, variable, descriptions, places.text(path))
        if problem is not None:
            problems.append(problem)
        ports[Port(name, variable)] = None
    return tuple(ports)


def _port_graph(
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


def _algebraic_loops(
    instances: Sequence[Instance], connections: Sequence[Connection], places: Places
) -> list[Problem]:
    problems: dict[frozenset[Port], Problem] = {}
    targets = {connection.target for connection in connections}
    assumed = {
        Port(one.name, output)
        for one in instances
        for output in one.fmu.description.assumed
        if one.feedthrough[output] == one.fmu.description.feedthrough[output]
    }
    for initial in (False, True):
        nodes, successors = _port_graph(instances, connections, initial=initial)
        ports = list(nodes)
        for component in graph.strong_components(successors):
            cycle = graph.shortest_cycle(successors, component[0], component)
            if not cycle:
                continue
            loop = [ports[index] for index in cycle]
            if loop[0] not in targets:
                loop = [*loop[1:], loop[0]]
            key = frozenset(loop)
            if key not in problems:
                problems[key] = checks.loop_problem(loop, assumed, places.text(("connections",)), initial)
    return list(problems.values())
