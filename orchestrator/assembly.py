"""Parts and connections -> a system.

Everything that can be known before a run is checked here, and all problems are told at once.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

from . import bundled, checks, graph
from .bonds import Bond, declared_bonds, find_bonds
from .config import BondModel, Config, ConnectionModel, InstanceModel, Places, Scalar
from .connecting import Ends, connect, elements
from .errors import ConfigError, FmuError, Problem, listed, nearest
from .external import ExternalFmu
from .fmi import Fmu, Handling, Interface, Kind, ModelDescription, Value, Variable, load_fmu
from .system import Connection, Instance, Port, System, port_graph

__all__ = ["Part", "assemble", "load_system"]


@dataclass(frozen=True)
class Part:
    """An instance as it is asked for, before it is checked.

    Attributes:
        name: of the instance.
        fmu: what it is made from.
        start: start values with units, as in a config.
        feedthrough: dependencies that replace the FMU's own, per output.
        ratio: its own step size over the communication step size, n or 1/n.
    """

    name: str
    fmu: Fmu
    start: Mapping[str, Scalar] = field(default_factory=dict)
    feedthrough: Mapping[str, Sequence[str]] = field(default_factory=dict)
    ratio: Fraction = Fraction(1)


def load_system(
    config: Config, needed: Mapping[str, tuple[str, ...]] | None = None, *, loops: bool = False
) -> System:
    """The system of a config.

    Args:
        config: a validated config.
        needed: signals that are recorded whatever the config says, as instance.variable, and the path in the
            config that asks for each.
        loops: see `assemble`.
    Raises: ConfigError with all problems.
    """
    problems: list[Problem] = []
    parts: list[Part] = []
    known: dict[tuple[str, str | None, Handling], Fmu | None] = {}
    for name, instance in config.model.instances.items():
        choice = instance.fmu, instance.form, _handling(instance)
        if choice not in known:
            known[choice] = _find_fmu(*choice, config, ("instances", name), problems)
        fmu = known[choice]
        if fmu is not None:
            ratio = _ratio(name, config, problems)
            parts.append(Part(name, fmu, instance.start, instance.feedthrough, ratio))
    parts += [Part(name, ExternalFmu(name, one)) for name, one in config.model.external.items()]
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
        loops=loops,
        step_size=float(config.model.run.times()[2]),
        folder=config.folder,
        bonds=None if config.model.bonds == "auto" else config.model.bonds,
    )


def _ratio(name: str, config: Config, problems: list[Problem]) -> Fraction:
    """An instance's own step size over the communication step size."""
    instance, run = config.model.instances[name], config.model.run
    own = instance.own_step()
    begin, end, step = run.times()
    if own is None or step <= 0:
        return Fraction(1)
    ratio = own / step
    if ratio > 0 and 1 in (ratio.numerator, ratio.denominator):
        if ratio <= 1 or ((end - begin) / own).denominator == 1:
            return ratio
        what = f"a run of {float(end - begin)!r} s is {float((end - begin) / own):.6g} steps of it"
        allowed = "a whole number is needed"
    else:
        what = f"it is {float(ratio):.6g} communication steps of {run.step_size}"
        allowed = "a whole multiple, or a whole part of one, is needed"
    place = config.places.text(("instances", name, "step_size"))
    problems.append(Problem(place, f"cannot step {name} by {instance.step_size}: {what}", allowed))
    return Fraction(1)


def _handling(instance: InstanceModel) -> Handling:
    return Handling(
        any_step=instance.any_step,
        interface=None if instance.interface is None else Interface(instance.interface),
        tolerance=instance.tolerance,
        event_mode=instance.event_mode,
        isolated=instance.isolate is not None,
        time_limit=instance.seconds(),
    )


def _find_fmu(
    text: str,
    form: str | None,
    handling: Handling,
    config: Config,
    path: tuple[str, ...],
    problems: list[Problem],
) -> Fmu | None:
    place = config.places.text((*path, "fmu"))
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
    if form is not None:
        forms = {} if file.is_file() else bundled.fmu_forms(text)
        if form not in forms:
            what = f"{text!r} comes in one form only, there is no form to choose"
            names = [name for name in bundled.fmu_names() if bundled.fmu_forms(name)]
            allowed = f"bundled FMUs in the forms python and native: {listed(names)}"
            problems.append(Problem(config.places.text((*path, "form")), what, allowed, "Leave form out."))
            return None
        found = forms[form]
    try:
        fmu = load_fmu(found, handling)
        fmu.check()
        return fmu
    except FmuError as error:
        first, _, rest = str(error).partition("\n")
        problems.append(Problem(place, first, "\n".join(line.strip() for line in rest.splitlines())))
        return None


def assemble(
    parts: Iterable[Part],
    connections: Iterable[str | ConnectionModel | Mapping[str, Any]] = (),
    *,
    record: Sequence[str] | None = None,
    needed: Mapping[str, tuple[str, ...]] | None = None,
    places: Places | None = None,
    problems: Iterable[Problem] = (),
    absent: frozenset[str] = frozenset(),
    loops: bool = False,
    step_size: float | None = None,
    folder: Path | None = None,
    bonds: Sequence[BondModel] | None = None,
) -> System:
    """Check parts and connections and make a system of them.

    Args:
        parts: instances with distinct names.
        connections: "a.y -> b.u" each, or the long form, {"from": "a.y", "to": "b.u", "through": [...]}.
        record: signals to record as instance.variable; None: every numeric output.
        needed: signals to record besides, and the path in the config that asks for each.
        places: where the values were written, for messages.
        problems: found earlier, to be told together with those found here.
        absent: names of instances that already have a problem: what concerns them is not judged.
        loops: whether algebraic loops at communication points are let pass, for a master that solves them.
        step_size: the largest communication step that the system is to take [s]: a delay that is no shorter
            breaks direct feedthrough. None: not known, and no delay does.
        folder: what relative paths of effects start from; the working directory if not given.
        bonds: power bonds as a config declares them; None: those that units and graph leave no doubt about.
    Raises: ConfigError with all problems.
    """
    parts = list(parts)
    places = places or Places("system")
    found = list(problems)
    notes: list[str] = []
    descriptions = {part.name: part.fmu.description for part in parts}
    stated, single, fed = _stated(connections, descriptions, places, found)
    wired: dict[Port, tuple[int, Port]] = {}
    checked: list[Connection] = []
    told: set[Problem] = set()
    for one in single:
        apart: list[Problem] = []
        made = connect(one, descriptions, absent, places, folder or Path.cwd(), step_size, apart, notes)
        # Of an effect on an array every element tells the same.
        found += [problem for problem in apart if problem not in told]
        told.update(apart)
        if made is None:
            continue
        if made.target in wired:
            first, source = wired[made.target]
            what = f"{made.target} has two sources, {source} and {made.source}"
            allowed = f"connections[{first}] already feeds it; an input takes one connection"
            remedy = "Remove one of the two, or add them up: from: [..., ...]."
            found.append(Problem(places.text(("connections", one.index)), what, allowed, remedy))
            continue
        wired[made.target] = (one.index, made.source)
        checked.append(made)
    instances = [_settle(part, wired, fed, places, found, notes) for part in parts]
    for part in parts:
        notes += _remarks(part, places)
        found += checks.integration(part.name, part.fmu, places)
    found += checks.shared_process(((part.name, part.fmu) for part in parts), places)
    wanted: dict[str, tuple[str | int, ...]] = {}
    for index, text in enumerate(record or ()):
        wanted.setdefault(text, ("run", "record", index))
    for text, path in (needed or {}).items():
        wanted.setdefault(text, path)
    recorded = _recorded(record is None, wanted, instances, absent, places, found)
    solvable: tuple[tuple[Port, ...], ...] = ()
    if not found:
        solvable = _algebraic_loops(instances, checked, places, loops, found, step_size)
    bonded = _bonded(bonds, instances, checked, stated, absent, places, found, notes)
    if found:
        raise ConfigError(found)
    broken = any(not link.at_once for one in checked if one.wire for link in one.wire.every_link)
    longest = step_size if broken else None
    return System(tuple(instances), tuple(checked), recorded, tuple(notes), solvable, longest, bonded)


def _stated(
    connections: Iterable[str | ConnectionModel | Mapping[str, Any]],
    descriptions: Mapping[str, ModelDescription],
    places: Places,
    problems: list[Problem],
) -> tuple[list[Ends], list[Ends], set[str]]:
    """Take connections apart, element by element.

    Returns: the elements, before those of a connection that has problems the whole of it; the elements alone;
        all inputs that are fed.
    """
    stated: list[Ends] = []
    single: list[Ends] = []
    fed: set[str] = set()
    for index, connection in enumerate(connections):
        whole = Ends.of(index, connection)
        ends, targets, wrong = elements(whole, descriptions, places)
        fed.update(targets)
        problems += wrong
        single += ends
        stated += [whole, *ends] if wrong else ends
    return stated, single, fed


def _remarks(part: Part, places: Places) -> list[str]:
    """What the user should know of an FMU that is let pass."""
    description, place = part.fmu.description, places.text(("instances", part.name))
    notes = []
    if description.deviations:
        first, *more = description.deviations
        further = f" and {len(more)} more" if more else ""
        notes.append(f"{place}: breaks a rule of FMI: {first}{further}")
    tool = description.tool or "which it does not name"
    # pythonfmu declares a need that is met wherever this runs: Python.
    if description.capabilities.execution_tool and not tool.startswith("PythonFMU"):
        notes.append(f"{place}: runs only where the tool that made it is installed, {tool}")
    return notes


def _bonded(
    bonds: Sequence[BondModel] | None,
    instances: Sequence[Instance],
    connections: Sequence[Connection],
    stated: Sequence[Ends],
    absent: frozenset[str],
    places: Places,
    problems: list[Problem],
    notes: list[str],
) -> tuple[Bond, ...]:
    """Power bonds as declared or, with doubts as notes, as they are found."""
    variables = {one.name: one.fmu.description.variables for one in instances}

    def variable(port: Port) -> Variable:
        return variables[port.instance][port.variable]

    if bonds is None:
        bonded, doubts = find_bonds(connections, variable)
        notes += doubts
        return bonded
    outputs = [Port(one.name, name.name) for one in instances for name in one.fmu.description.outputs]
    numeric = {str(port): port for port in outputs if variable(port).kind is Kind.REAL}
    unjudged = [one.leading for one in stated]
    return declared_bonds(bonds, connections, variable, numeric, places, problems, unjudged, absent)


def _settle(
    part: Part,
    wired: Mapping[Port, tuple[int, Port]],
    fed: set[str],
    places: Places,
    problems: list[Problem],
    notes: list[str],
) -> Instance:
    """Start values and dependencies of a part, and its inputs that nothing feeds.

    Inputs in `fed` that are not in `wired` have a connection with a problem of its own.
    """
    path = ("instances", part.name)
    description = part.fmu.description
    start: dict[str, Value] = {}
    for name, value in part.start.items():
        result = checks.start_value(part.name, description, name, value, places.text((*path, "start", name)))
        if isinstance(result, Problem):
            problems.append(result)
        else:
            start[name] = result
    used = {
        variable.reference
        for variable in description.inputs
        if variable.name in part.start or f"{part.name}.{variable.name}" in fed
    }
    for variable in description.inputs:
        if variable.elements > 1 and variable.reference not in used:
            if variable.element == 0:
                array = variable.name.rpartition("[")[0]
                notes.append(f"{places.text(path)}: input array {part.name}.{array} is left alone")
            continue
        feed = wired.get(Port(part.name, variable.name))
        place = places.text((*path, "start", variable.name) if variable.name in part.start else path)
        if feed is not None and variable.name in part.start:
            what = f"{part.name}.{variable.name} has two sources, {feed[1]} and a start value"
            problems.append(
                Problem(place, what, f"connections[{feed[0]}] feeds it", "Remove one of the two.")
            )
        elif feed is None and variable.name not in part.start and f"{part.name}.{variable.name}" not in fed:
            if variable.shape or not variable.settable:
                notes.append(f"{place}: input {part.name}.{variable.name} ({variable.type}) is left alone")
                continue
            what = f"input {part.name}.{variable} is not connected and has no start value"
            remedy = f"Connect it, or give it a constant value under instances.{part.name}.start."
            problems.append(Problem(place, what, remedy=remedy))
    feedthrough, initial = checks.dependencies(part.name, description, part.feedthrough, places, problems)
    return Instance(part.name, part.fmu, start, feedthrough, initial, part.ratio)


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
        for one in instances
        if outputs
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


def _algebraic_loops(
    instances: Sequence[Instance],
    connections: Sequence[Connection],
    places: Places,
    accepted: bool,
    problems: list[Problem],
    step_size: float | None,
) -> tuple[tuple[Port, ...], ...]:
    """Algebraic loops at communication points that are accepted; the others become problems.

    Those at initialisation are always accepted, if they can be solved at all: FMI lets inputs be set and
    outputs be read there as often as it takes.
    """
    told: dict[frozenset[Port], Problem] = {}
    found: list[tuple[Port, ...]] = []
    targets = {connection.target: connection for connection in connections}
    variables = {one.name: one.fmu.description.variables for one in instances}
    assumed = {
        Port(one.name, output)
        for one in instances
        for output in one.fmu.description.assumed
        if one.feedthrough[output] == one.fmu.description.feedthrough[output]
    }
    for initial in (False, True):
        nodes, successors = port_graph(instances, connections, initial=initial)
        ports = list(nodes)
        for component in graph.strong_components(successors):
            cycle = graph.shortest_cycle(successors, component[0], component)
            if not cycle:
                continue
            members = [ports[index] for index in component]
            kinds = {port: variables[port.instance][port.variable].kind for port in members}
            other = [port for port, kind in kinds.items() if kind is not Kind.REAL]
            loop = [ports[index] for index in cycle]
            if loop[0] not in targets:
                loop = [*loop[1:], loop[0]]
            key = frozenset(loop)
            if not other and (accepted or initial):
                if not initial:
                    found.append(tuple(loop))
                continue
            if key not in told:
                reason = ""
                if other:
                    reason = f"{other[0]} is of type {kinds[other[0]]}, and only real numbers can be iterated"
                place = places.text(("connections",))
                told[key] = checks.loop_problem(loop, targets, assumed, place, initial, reason, step_size)
    problems += told.values()
    return tuple(found)
