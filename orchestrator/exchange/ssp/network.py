"""Nested systems -> components and the ports that connections and parameters meet at.

A component that is itself a package or a description takes the place of its top-level system. Parameters of
higher systems take precedence over those of lower ones, later bindings over earlier ones (SSP 2.0, 5.2.3).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ...base.errors import ConfigError, FmuError, Problem, listed, nearest
from ...base.units import Unit
from ...fmi import Interface, ModelDescription, Variable, read_description
from .archive import Package, TooMuch, referenced
from .model import (
    Binding,
    Connection,
    Connector,
    Dictionary,
    Document,
    Element,
    End,
    MappingEntry,
    Parameter,
    Reference,
    Transformation,
)
from .schema import Reader

Path_ = tuple[str, ...]
Key = tuple[Path_, str]
_FMU = "application/x-fmu-sharedlibrary"
_NESTED = ("application/x-ssp-definition", "application/x-ssp-package")
_INTERFACES = {"CoSimulation": Interface.CO_SIMULATION, "ModelExchange": Interface.MODEL_EXCHANGE}
DEEPEST = 64
# References to one system multiply: this many are far beyond any package, and below what fills the memory.
MOST_SYSTEMS = 2000
# Kinds of connectors through which values leave an element, and through which they enter it.
_GIVING = ("output", "local", "calculatedParameter", "constant")
_TAKING = ("input", "parameter", "structuralParameter")


@dataclass(frozen=True)
class Leaf:
    """A component: its place among the systems, its FMU, and what the description says of it."""

    path: Path_
    file: Path
    description: ModelDescription
    interface: Interface | None
    place: str


@dataclass(frozen=True)
class Node:
    """A connector. `unit` and `unit_name`: of the connector, or else of the FMU's variable."""

    unit: Unit | None
    unit_name: str
    variable: Variable | None
    items: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class Edge:
    """What feeds a connector."""

    source: Key
    suppress: bool
    transformation: Transformation | None
    place: str


@dataclass(frozen=True)
class Assigned:
    """A parameter's value, and how it is changed before it is applied."""

    parameter: Parameter
    suppress: bool = False
    transformation: Transformation | None = None


def family(description: ModelDescription, name: str) -> list[Variable]:
    """The variable of that name, or the elements of the array."""
    if name in description.variables:
        return [description.variables[name]]
    return [one for one in description.variables.values() if one.name.startswith(f"{name}[")]


@dataclass
class _Scope:
    """Where an element stands: its file, and the dictionaries that can be seen from there."""

    package: Package
    file: str
    document: Document
    chain: tuple[tuple[str, str], ...]
    dictionaries: Mapping[str, tuple[Path_, Dictionary]] = field(default_factory=dict)


class Network:
    """What a description comes to.

    Attributes:
        leaves: components by path, in the order in which they stand.
        nodes: connectors by element and name.
        edges: what feeds a connector, by connector, in the order of the connections.
        values: what parameters give variables and connectors of systems.
        unused: parameters that no variable has the name of.
    """

    def __init__(self, problems: list[Problem], notes: list[str]) -> None:
        self.problems, self.notes = problems, notes
        self.leaves: dict[Path_, Leaf] = {}
        self.nodes: dict[Key, Node] = {}
        self.edges: dict[Key, Edge] = {}
        self.values: dict[Key, Assigned] = {}
        self.unused: list[str] = []
        self._descriptions: dict[tuple[Path, Interface | None], ModelDescription] = {}
        # Nested descriptions that have been read in place of their component.
        self._replaced: dict[Path_, Element] = {}
        # Files that many bindings refer to are read once.
        self._parsed: dict[tuple[str, str, str], Any] = {}
        self._systems = 0

    def add(self, package: Package, file: str) -> Document:
        """Read a description and all that it leads to. Returns: the description. Raises: ConfigError."""
        document = self._document(package, file)
        self._system(document.system, (), _Scope(package, file, document, ((package.label, file),)))
        return document

    def _document(self, package: Package, file: str) -> Document:
        reader = Reader(package.label, self.problems, self.notes)
        return reader.document(file, package.read(file, package.label))

    def _system(self, system: Element, path: Path_, scope: _Scope) -> None:
        if len(path) > DEEPEST:
            raise ConfigError([Problem(system.place, f"systems within systems, {DEEPEST} deep", "refused")])
        self._systems += 1
        if self._systems > MOST_SYSTEMS:
            what = f"references make more than {MOST_SYSTEMS} systems of it"
            raise TooMuch([Problem(system.place, what, "refused")])
        own = {one.name: (path, one) for one in system.dictionaries}
        scope = replace(scope, dictionaries={**scope.dictionaries, **own})
        for connector in system.connectors.values():
            self.nodes[path, connector.name] = Node(connector.unit, connector.unit_name, None)
        for element in system.elements:
            inner = (*path, element.name)
            if element.what == "system":
                self._system(element, inner, scope)
            elif element.what == "component":
                self._component(element, inner, scope)
        for connection in system.connections:
            self._connect(connection, system, path, scope)
        self._bind(system.bindings, system, path, scope, None)

    def _component(self, element: Element, path: Path_, scope: _Scope) -> None:
        reference = element.reference
        if reference is None:
            remedy = "Give it a source, such as resources/Model.fmu."
            what = f"component {element.name} has no source"
            self.problems.append(Problem(element.place, what, "there is nothing to run", remedy))
            return
        kind = reference.type
        if kind not in (_FMU, *_NESTED):
            what = f"component {element.name} is of type {kind!r}"
            self.problems.append(Problem(element.place, what, f"types: {listed((_FMU, *_NESTED))}"))
            return
        try:
            found, fragment = referenced(reference.source, scope.file, element.place)
            if kind in _NESTED or (not found.endswith(".fmu") and found.endswith((".ssp", ".ssd"))):
                self._nested(element, found, fragment, path, scope)
            else:
                self._fmu(element, found, path, scope)
        except TooMuch:
            raise
        except ConfigError as error:
            self.problems += error.problems

    def _nested(self, element: Element, file: str, fragment: str, path: Path_, scope: _Scope) -> None:
        """A component whose place a system takes."""
        package, system = scope.package, None
        if file == scope.file and fragment:  # a system of this very description
            system = _identified(scope.document.system, fragment)
            if system is None:
                what = f"no system with the id {fragment!r} in {file}"
                raise ConfigError([Problem(element.place, what)])
            document, link = scope.document, (package.label, f"{file}#{fragment}")
            if fragment == scope.document.system.identity:
                link = (package.label, file)
        elif file.endswith(".ssd"):
            document, link = self._document(package, file), (package.label, file)
        else:
            package = scope.package.inner(file, element.place)
            file = fragment or "SystemStructure.ssd"
            document, link = self._document(package, file), (package.label, file)
        if link in scope.chain:
            ring = " > ".join(one for _, one in (*scope.chain, link))
            what = f"component {element.name} contains itself: {ring}"
            raise ConfigError([Problem(element.place, what, "systems within systems must end")])
        system = system or document.system
        # The component's own parameters count after those of the system.
        self._replaced[path] = system
        self._system(system, path, _Scope(package, file, document, (*scope.chain, link), scope.dictionaries))
        self._bind(element.bindings, system, path, scope, None)

    def _fmu(self, element: Element, file: str, path: Path_, scope: _Scope) -> None:
        if element.implementation not in (*_INTERFACES, "any"):
            what = f"component {element.name} is to run as {element.implementation!r}"
            allowed = f"implementations: {listed(['any', *_INTERFACES])}"
            raise ConfigError([Problem(element.place, what, allowed)])
        interface = _INTERFACES.get(element.implementation)
        on_disk = scope.package.file(file, element.place)
        try:
            if (on_disk, interface) not in self._descriptions:
                self._descriptions[on_disk, interface] = read_description(on_disk, interface)
        except FmuError as error:
            first, _, rest = str(error).partition("\n")
            raise ConfigError([Problem(element.place, first, rest.strip())]) from None
        description = self._descriptions[on_disk, interface]
        self.leaves[path] = Leaf(path, on_disk, description, interface, element.place)
        for connector in element.connectors.values():
            variables = family(description, connector.name)
            if not variables:
                what = f"{element.name}'s FMU has no variable {connector.name!r}"
                near = nearest(connector.name, description.variables)
                self.problems.append(
                    Problem(connector.place, what, "a connector has a variable's name", near)
                )
                continue
            for variable in variables:
                self.nodes[path, variable.name] = self._port(connector, variable, element.name)
        self._bind(element.bindings, element, path, scope, (file, description))

    def _port(self, connector: Connector, variable: Variable, name: str) -> Node:
        """A connector of a component. Where its unit is that of the FMU, the FMU's word is taken for it."""
        unit, own = connector.unit, variable.unit
        if own is not None and unit is not None and own != unit and connector.unit_name != variable.unit_name:
            what = f"connector {name}.{connector.name} is in {connector.unit_name}, not {variable.unit_name}"
            if own.same_dimension(unit):
                self.notes.append(f"{connector.place}: {what}, as in the FMU: values are those of the FMU")
            else:
                allowed = f"{variable.unit_name} by the FMU; a component's connector is its variable"
                self.problems.append(Problem(connector.place, what, allowed))
        if own is not None or unit is None:
            return Node(own, variable.unit_name or connector.unit_name, variable, variable.items)
        return Node(unit, connector.unit_name, variable, variable.items)

    def _connect(self, connection: Connection, system: Element, path: Path_, scope: _Scope) -> None:
        ends = [self._end(end, connection, system, path, scope) for end in (connection.start, connection.end)]
        if ends[0] is None or ends[1] is None:
            return
        (start, gives), (end, takes) = ends
        if gives is None and takes is None:
            what = f"{connection.start} and {connection.end} are both of the kind inout"
            self.problems.append(Problem(connection.place, what, "its direction is ambiguous"))
            return
        forward = gives if gives is not None else not takes
        if gives is not None and gives == takes:
            both = "give" if gives else "take"
            what = f"cannot connect {connection.start} to {connection.end}: both {both} values"
            allowed = "one end is an output of an element, or an input of the system around"
            self.problems.append(Problem(connection.place, what, allowed))
            return
        source, target = (start, end) if forward else (end, start)
        if target in self.edges:
            what = f"{connection.end if forward else connection.start} is fed twice"
            remedy = "Remove one of the connections."
            self.problems.append(
                Problem(connection.place, what, f"also by {self.edges[target].place}", remedy)
            )
            return
        self.edges[target] = Edge(source, connection.suppress, connection.transformation, connection.place)

    def _end(
        self, end: End, connection: Connection, system: Element, path: Path_, scope: _Scope
    ) -> tuple[Key, bool | None] | None:
        """One end of a connection: its connector, and whether values come out of it; None: either way."""
        if end.element is None:
            element, inner = system, path
        else:
            inner = (*path, end.element)
            found = [one for one in system.elements if one.name == end.element]
            if not found:
                names = [one.name for one in system.elements]
                what = f"no element {end.element!r} in system {system.name}"
                self.problems.append(
                    Problem(connection.place, what, f"elements: {listed(names)}", nearest(end.element, names))
                )
                return None
            element = found[0]
        connector = element.connectors.get(end.connector)
        if connector is None and inner in self._replaced:
            connector = self._replaced[inner].connectors.get(end.connector)
        if connector is None:
            names = list(element.connectors)
            what = f"no connector {end.connector!r} of {element.name}"
            allowed = f"connectors: {listed(names)}"
            self.problems.append(Problem(connection.place, what, allowed, nearest(end.connector, names)))
            return None
        if element.what == "dictionary":
            return self._entry(element, end, connector, connection, scope)
        if connector.kind in _GIVING:
            gives: bool | None = end.element is not None
        elif connector.kind in _TAKING:
            gives = end.element is None
        else:
            what = f"connector {end} is of kind {connector.kind!r}"
            allowed = f"kinds: {listed((*_TAKING, *_GIVING))}; inout for signal dictionaries only"
            self.problems.append(Problem(connection.place, what, allowed))
            return None
        return (inner, end.connector + end.indices), gives

    def _entry(
        self, element: Element, end: End, connector: Connector, connection: Connection, scope: _Scope
    ) -> tuple[Key, bool | None] | None:
        """A connector of a reference to a signal dictionary: the entry, wherever it is referred to."""
        if element.dictionary not in scope.dictionaries:
            what = f"no signal dictionary {element.dictionary!r}"
            allowed = f"in this system and those around: {listed(scope.dictionaries)}"
            self.problems.append(Problem(element.place, what, allowed))
            return None
        path, dictionary = scope.dictionaries[element.dictionary]
        entries = dictionary.entries
        if isinstance(entries, Reference):
            file, _ = referenced(entries.source, scope.file, dictionary.place)
            reader = Reader(scope.package.label, self.problems, self.notes)
            entries = reader.dictionary(file, scope.package.read(file, dictionary.place))
        if end.connector not in entries:
            what = f"no entry {end.connector!r} in signal dictionary {dictionary.name}"
            near = nearest(end.connector, entries)
            self.problems.append(Problem(connection.place, what, f"entries: {listed(entries)}", near))
            return None
        key = ((*path, f"signal dictionary {dictionary.name}"), end.connector)
        entry = entries[end.connector]
        self.nodes.setdefault(key, Node(entry.unit, entry.unit_name, None))
        gives = {"output": True, "input": False}.get(connector.kind)
        return key, gives

    def _bind(
        self,
        bindings: Iterable[Binding],
        element: Element,
        path: Path_,
        scope: _Scope,
        component: tuple[str, ModelDescription] | None,
    ) -> None:
        for binding in bindings:
            try:
                given = self._assigned(binding, scope, component is not None)
            except TooMuch:
                raise
            except ConfigError as error:
                self.problems += error.problems
                continue
            for name, one in given:
                targets = self._targets(element, path, name)
                if not targets:
                    self.unused.append(f"{one.parameter.place}: {name}")
                for key in targets:
                    self.values[key] = one

    def _assigned(self, binding: Binding, scope: _Scope, component: bool) -> list[tuple[str, Assigned]]:
        """What a binding gives, by the names in the element."""
        reader = Reader(scope.package.label, self.problems, self.notes)

        def read(reference: Reference, parse: Callable[[str, bytes], Any], kind: str) -> Any:
            if reference.base == "component" and component:
                what = f"{reference.source!r} lies within the component's FMU"
                raise ConfigError([Problem(binding.place, what, "only files of the package itself are read")])
            file, _ = referenced(reference.source, scope.file, binding.place)
            content, key = scope.package.read(file, binding.place), (scope.package.label, file, kind)
            if key not in self._parsed:
                self._parsed[key] = parse(file, content)
            return self._parsed[key]

        values, mapping = binding.values, binding.mapping
        if isinstance(values, Reference):
            values = read(values, reader.parameters, "parameters")
        if isinstance(mapping, Reference):
            mapping = read(mapping, reader.mapping, "mapping")
        named = {binding.prefix + one.name: one for one in values}
        if mapping is None:
            return [(name, Assigned(one)) for name, one in named.items()]
        missing = [entry.source for entry in mapping if entry.source not in named]
        if missing:
            self.notes.append(
                f"{binding.place}: the mapping names parameters that are not given: {listed(missing)}"
            )
        return [
            (entry.target, _mapped(named[entry.source], entry)) for entry in mapping if entry.source in named
        ]

    def _targets(self, element: Element, path: Path_, name: str) -> list[Key]:
        """Variables and connectors that a hierarchical name stands for; all, if there are several."""
        if element.what == "component" and path not in self._replaced:
            leaf = self.leaves.get(path)
            return [(path, name)] if leaf is not None and family(leaf.description, name) else []
        element = self._replaced.get(path, element)
        found = [(path, name)] if name in element.connectors else []
        for one in element.elements:
            if name.startswith(f"{one.name}."):
                found += self._targets(one, (*path, one.name), name[len(one.name) + 1 :])
        return found


def _mapped(parameter: Parameter, entry: MappingEntry) -> Assigned:
    return Assigned(parameter, entry.suppress, entry.transformation)


def _identified(system: Element, identity: str) -> Element | None:
    if identity and system.identity == identity:
        return system
    for one in system.elements:
        found = _identified(one, identity) if one.what == "system" else None
        if found is not None:
            return found
    return None
