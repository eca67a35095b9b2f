"""System structure packages and descriptions -> configs.

What a config has no word for is refused with its place; what SSP leaves to its reader is a note. Step
size and master algorithm are no part of SSP: they come from our annotation, or have to be given.

Of the libraries for SSP, fmpy's reader knows version 1.0 only and drops transformations of connections and
inline mappings, `pyssp-standard` (0.9, alpha) edits single files and neither flattens systems nor applies
parameters; so the files are read here, with fmpy's schemas beside.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...base.errors import ConfigError, Problem, listed
from ...base.units import Unit, UnitError, convert
from ...fmi import Kind
from . import annotations
from .archive import open_package
from .code import take_code
from .model import Document
from .network import Assigned, Edge, Key, Leaf, Network, Node, Path_, family
from .values import SignalPath, SignalPathError, scalars

MAIN = "SystemStructure.ssd"


@dataclass
class Read:
    """What a package holds, as a config.

    Attributes:
        data: plain values; without run.step_size and run.master where nothing gives them.
        files: FMU of each instance.
        notes: what was accepted without being clear.
        remedies: what to do about keys that are missing, by key.
        code: files of Python code, of effects.
    """

    data: dict[str, Any]
    files: dict[str, Path]
    notes: list[str]
    remedies: dict[str, str] = field(default_factory=dict)
    code: list[Path] = field(default_factory=list)


def read_ssp(path: Path, folder: Path, variant: str = MAIN, *, with_code: bool = False) -> Read:
    """Read a system structure package or description.

    Args:
        path: a .ssp or .ssd file.
        folder: where FMUs of packages are unpacked to; nothing is written elsewhere.
        variant: the description in a package.
        with_code: whether to take Python code of effects, which runs when the config is loaded.
    Raises: ConfigError with all problems.
    """
    problems: list[Problem] = []
    notes: list[str] = []
    package = open_package(path, folder)
    file = path.name if path.suffix.lower() == ".ssd" else variant
    if not package.has(file):
        names = [name for name in package.names() if name.endswith(".ssd") and "/" not in name]
        what = f"no {file} at the top, hence no system structure package"
        raise ConfigError([Problem(package.label, what, f"descriptions in it: {listed(names)}")])
    network = Network(problems, notes)
    document = network.add(package, file)
    if not network.leaves and not problems:
        raise ConfigError([Problem(f"{package.label}: {file}", "no components", "there is nothing to run")])
    names = _names(network.leaves, notes)
    instances: dict[str, dict[str, Any]] = {}
    for at, leaf in network.leaves.items():
        instances[names[at]] = {"fmu": str(leaf.file)}
        if leaf.interface is not None:
            instances[names[at]]["interface"] = str(leaf.interface)
    connections, fed = _connections(network, names, problems)
    starts = _starts(network, names, fed, problems)
    for name, start in starts.items():
        if start:
            instances[name]["start"] = start
    if problems:
        raise ConfigError(problems)
    if network.unused:
        notes.append(f"{package.label}: parameters of no variable, ignored: {listed(network.unused, 5)}")
    data: dict[str, Any] = {"run": _run(document), "instances": instances, "connections": connections}
    title = document.system.description
    if title:
        data = {"title": title, **data}
    read = Read(data, {names[at]: leaf.file for at, leaf in network.leaves.items()}, notes)
    descriptions = {names[at]: leaf.description for at, leaf in network.leaves.items()}
    annotations.apply(read.data, document, read.files, descriptions, notes, package.label)
    read.code = take_code(read.data, package, f"{package.label}: {file}", with_code=with_code)
    _remedies(read, document)
    return read


def _names(leaves: Mapping[Path_, Leaf], notes: list[str]) -> dict[Path_, str]:
    """A name for each component: its own, those of the systems around joined by "_"."""
    names: dict[Path_, str] = {}
    taken: set[str] = set()
    for path in leaves:
        name = re.sub(r"[^A-Za-z0-9_-]", "_", "_".join(path))
        if not re.match(r"[A-Za-z_]", name):
            name = f"_{name}"
        unique, number = name, 2
        while unique in taken:
            unique, number = f"{name}_{number}", number + 1
        taken.add(unique)
        names[path] = unique
        if unique != ".".join(path):
            notes.append(f"component {'.'.join(path)} is called {unique} here")
    return names


def _run(document: Document) -> dict[str, Any]:
    run: dict[str, Any] = {}
    if document.start is not None and document.start.strip("0.+-") != "":
        run["start_time"] = f"{document.start} s"
    if document.stop is not None:
        run["stop_time"] = f"{document.stop} s"
    return run


def _connections(
    network: Network, names: Mapping[Path_, str], problems: list[Problem]
) -> tuple[list[Any], dict[Key, Key | None]]:
    """Connections between components, and for each fed port of one where its value begins; None: nowhere."""
    found: list[Any] = []
    begins: dict[Key, Key | None] = {}
    for target, edge in network.edges.items():
        if target[0] not in network.leaves:
            continue
        chain = _chain(network, target, edge, problems)
        if chain is None:
            begins[target] = None
            continue
        begin = chain[0][0]
        begins[target] = begin
        if begin[0] not in network.leaves:
            continue  # a connector of a system that nothing feeds: a parameter, or the FMU's own start value
        try:
            found.append(_connection(network, names, begin, target, [one for _, one in chain]))
        except SignalPathError as error:
            problems.append(Problem(edge.place, f"{_key_text(begin)} to {_key_text(target)}: {error}"))
    return found, begins


def _chain(
    network: Network, target: Key, edge: Edge, problems: list[Problem]
) -> list[tuple[Key, tuple[Key, Edge]]] | None:
    """The way to a port from where its value begins: what leads on from each connector, and where to."""
    chain = [(edge.source, (target, edge))]
    seen = {target}
    while (source := chain[0][0]) in network.edges and source[0] not in network.leaves:
        if source in seen:
            problems.append(Problem(edge.place, f"{_key_text(source)} feeds itself", "connectors in a ring"))
            return None
        seen.add(source)
        chain.insert(0, (network.edges[source].source, (source, network.edges[source])))
    return chain


def _key_text(key: Key) -> str:
    return ".".join((*key[0], key[1]))


def _node(network: Network, key: Key) -> Node:
    """A connector; all elements of an array are equal."""
    found = network.nodes.get(key)
    if found is not None:
        return found
    path, name = key
    alike = [
        node for (at, other), node in network.nodes.items() if at == path and other.startswith(f"{name}[")
    ]
    return alike[0] if alike else network.nodes.get((path, name.partition("[")[0]), Node(None, "", None))


def _signal_path(network: Network, begin: Key, steps: list[tuple[Key, Edge]]) -> SignalPath:
    """Raises: SignalPathError."""
    node = _node(network, begin)
    signal_path = SignalPath(node.unit, node.unit_name, node.items)
    for key, edge in steps:
        signal_path.through(_node(network, key), edge.suppress, edge.transformation)
    return signal_path


def _connection(
    network: Network, names: Mapping[Path_, str], begin: Key, target: Key, steps: list[tuple[Key, Edge]]
) -> Any:
    """A connection of a config that does what a chain of connections does. Raises: SignalPathError."""
    signal_path = _signal_path(network, begin, steps)
    source, sink = _node(network, begin), _node(network, target)
    ends = f"{names[begin[0]]}.{begin[1]}", f"{names[target[0]]}.{target[1]}"
    through: list[dict[str, Any]] = [{"map": list(table)} for table in signal_path.tables]
    kinds = {node.variable.kind for node in (source, sink) if node.variable is not None}
    if not signal_path.tables:
        through = _linear(signal_path, source, sink)
    if not through and kinds == {Kind.INTEGER, Kind.ENUMERATION}:
        through = [{"map": []}]  # a config's word for an integer that is meant as an item
    if not through:
        return f"{ends[0]} -> {ends[1]}"
    return {"from": ends[0], "to": ends[1], "through": through}


def _linear(signal_path: SignalPath, source: Node, sink: Node) -> list[dict[str, Any]]:
    """Effects for factor * value + offset of plain numbers, given that a config converts units after them."""
    own = [None if node.variable is None else node.variable.unit for node in (source, sink)]
    one, other = own
    gain, shift, unit = 1.0, 0.0, ""
    name = "" if source.variable is None else source.variable.unit_name
    if one is not None and other is not None:
        if one.same_dimension(other):
            try:
                gain, shift = convert(one, other)
            except UnitError as error:
                raise SignalPathError(str(error)) from None
        elif one.offset or other.offset:
            raise SignalPathError("a unit with an offset cannot become another quantity")
        else:
            # The number that makes the one unit's values the other's, in base units.
            exponents = tuple(b - a for a, b in zip(one.exponents, other.exponents, strict=True))
            unit = Unit("", exponents).base()
            factor = signal_path.factor * float(other.factor / one.factor)
            effects: list[dict[str, Any]] = [{"gain": f"{_short(factor)!r} {unit}"}]
            if signal_path.offset:
                base = Unit("", other.exponents).base()
                value = _short(signal_path.offset * float(other.factor))
                effects.append({"offset": value if base == "1" else f"{value!r} {base}"})
            return effects
    factor, offset = signal_path.factor / gain, signal_path.offset
    found: list[dict[str, Any]] = []
    if factor != 1.0:
        found.append({"gain": _short(factor)})
    rest = (offset - shift) / gain
    if rest:
        plain = not name or (one is not None and one.base() == "1" and one.factor == 1)
        found.append({"offset": _short(rest) if plain else f"{_short(rest)!r} {name}"})
    return found


def _short(value: float) -> int | float:
    return int(value) if value == int(value) and abs(value) < 1e15 else value


def _starts(
    network: Network, names: Mapping[Path_, str], begins: Mapping[Key, Key | None], problems: list[Problem]
) -> dict[str, dict[str, Any]]:
    """Start values of each instance: by parameters, and by connectors of systems that parameters give."""
    found: dict[str, dict[str, Any]] = {name: {} for name in names.values()}
    for (path, name), given in network.values.items():
        if path in network.leaves and (path, name) not in begins:
            _start(network, names, (path, name), given, found, problems, begins)
    for target, begin in begins.items():
        if begin is None or begin[0] in network.leaves:
            continue
        given = network.values.get(begin)
        if given is None:
            continue
        steps = _steps(network, target)
        for key, edge in steps[:-1]:
            if edge.transformation is not None or edge.suppress:
                name = _key_text(begin)
                what = f"parameter {name} is transformed more than once on its way to {_key_text(key)}"
                problems.append(Problem(edge.place, what, "one transformation, at the component, is read"))
        last = steps[-1][1]
        if last.transformation is not None and given.transformation is not None:
            what = f"{_key_text(begin)} is transformed by a mapping and by a connection"
            problems.append(Problem(last.place, what, "one of the two is read"))
        given = Assigned(
            given.parameter, given.suppress or last.suppress, last.transformation or given.transformation
        )
        _start(network, names, target, given, found, problems, {})
    return found


def _steps(network: Network, target: Key) -> list[tuple[Key, Edge]]:
    steps: list[tuple[Key, Edge]] = []
    while target in network.edges and (not steps or target[0] not in network.leaves):
        steps.insert(0, (target, network.edges[target]))
        target = network.edges[target].source
    return steps


def _start(
    network: Network,
    names: Mapping[Path_, str],
    key: Key,
    given: Assigned,
    found: dict[str, dict[str, Any]],
    problems: list[Problem],
    fed: Mapping[Key, Key | None],
) -> None:
    """One start value, or those of an array's elements; elements that something feeds have none."""
    path, name = key
    variables = family(network.leaves[path].description, name)
    values = scalars(given, variables, _key_text(key))
    if isinstance(values, Problem):
        problems.append(values)
    else:
        found[names[path]].update({one: v for one, v in values.items() if (path, one) not in fed})


def _remedies(read: Read, document: Document) -> None:
    """What to do about what SSP does not say, for the message that it is missing."""
    run = read.data["run"]
    for hint, origin in annotations.step_hints(document):
        if "step_size" not in run:
            run["step_size"] = f"{hint} s"
            read.notes.append(f"step size {hint} s by an annotation of {origin}")
    for key, example in (("step_size", "1 ms"), ("master", "gauss-seidel"), ("stop_time", "10 s")):
        if key not in run:
            said = (
                "SSP does not say it" if key != "stop_time" else "the file has no DefaultExperiment stopTime"
            )
            text = f'"{example}"' if " " in example else example
            read.remedies[key] = f"{said}: add --set run.{key}={text}, or whatever is right."
