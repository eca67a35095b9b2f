"""Configured instances and connections -> a checked system, and all problems known before a run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..base.errors import Problem, listed
from ..config import Absent, BondModel, ConnectionModel, Draft, Gaps, Places
from ..config.base import exact_time
from ..fmi import Kind, ModelDescription, Variable
from . import checks
from .algebraic_loops import algebraic_loops
from .array_start_values import elementwise
from .connection import Connection, Port
from .connections import Ends, connect, elements, intended_inputs
from .instance_models import Part, configured_instances
from .power_bonds import Bond, declared_bonds, find_bonds
from .start_values import inputs_with_unreadable_start, remarks, resolve_start_values
from .system import Instance, System


@dataclass(frozen=True)
class CheckedSystem:
    """A system as far as nothing is wrong with it.

    Attributes:
        system: without what has problems.
        problems: what is wrong.
        unchecked: see `ConfigError`.
        unsettled: instances whose steps, or what their FMUs are asked for, are not known.
    """

    system: System
    problems: tuple[Problem, ...]
    unchecked: tuple[str, ...]
    unsettled: frozenset[str] = frozenset()


def check_system(
    draft: Draft, needed: Mapping[str, tuple[str, ...]] | None = None, *, loops: bool = False
) -> CheckedSystem:
    """The system of a config that may have problems, as far as it is known, and its further problems.

    Args:
        draft: a config that can be read in part.
        needed: signals that are recorded whatever the config says, as instance.variable, and the path in the
            config that asks for each.
        loops: whether algebraic loops at communication points are accepted, for a master that solves them.
    """
    config, gaps = draft.config, draft.gaps
    assert config is not None
    model, made = config.model, configured_instances(draft)
    asked = ("step_size", "any_step", "interface", "event_mode", "isolate")
    unsettled = {
        part.name for part in made.parts if not all(gaps.whole("instances", part.name, key) for key in asked)
    }
    missing = sorted(made.absent.names)
    unchecked = (f"ports and start values of {listed(missing)}",) if missing else ()
    record = [] if model.run.record == "all" else list(model.run.record)
    known = gaps.knows("run", "step_size")
    checked = assemble_instances(
        made.parts,
        model.connections,
        record=None
        if model.run.record == "all"
        else {one: ("run", "record", n) for n, one in enumerate(record) if gaps.knows("run", "record", n)},
        needed=needed,
        places=config.places,
        absent=made.absent,
        loops=loops,
        step_size=float(exact_time(model.run.step_size)) if known else None,
        folder=config.folder,
        bonds=None if model.bonds == "auto" else model.bonds,
        gaps=gaps,
        keep=model.run.unconnected == "keep",
    )
    return CheckedSystem(
        checked.system,
        (*made.problems, *checked.problems),
        (*unchecked, *checked.unchecked),
        made.unsettled | unsettled,
    )


def assemble_instances(
    parts: Sequence[Part],
    connections: Iterable[str | ConnectionModel | Mapping[str, Any] | None],
    *,
    record: Mapping[str, tuple[str | int, ...]] | None,
    needed: Mapping[str, tuple[str, ...]] | None,
    places: Places,
    absent: Absent,
    loops: bool,
    step_size: float | None,
    folder: Path,
    bonds: Sequence[BondModel | None] | None,
    gaps: Gaps,
    keep: bool = True,
) -> CheckedSystem:
    """Check parts and connections, and make a system of what is right.

    Args:
        parts: instances with distinct names.
        connections: "a.y -> b.u" each, or the long form, {"from": "a.y", "to": "b.u", "through": [...]}.
        record: signals to record as instance.variable, and where each was asked for; None: every numeric
            output.
        needed, loops: see `check_system`.
        places: where the values were written, for messages.
        absent: names of instances that already have a problem: what concerns them is not checked.
        step_size: the largest communication step that the system is to take [s]: a delay that is no shorter
            breaks direct feedthrough. None: not known, and no delay does.
        folder: what relative paths of effects start from.
        bonds: power bonds as a config declares them; None: those that units and graph leave no doubt about.
        gaps: what of connections (None: all), start values and dependencies is not known.
        keep: whether inputs that nothing feeds keep the start value that their FMU declares.
    """
    found, notes, unchecked = list[Problem](), list[str](), list[str]()
    descriptions = {part.name: part.fmu.description for part in parts}
    starts = {one.name: elementwise(one.name, one.fmu.description, one.start, places, found) for one in parts}
    stated, single, fed = _stated(connections, descriptions, found, unchecked, places, absent, gaps)
    wired: dict[Port, tuple[int, Port]] = {}
    checked: list[Connection] = []
    reported: set[Problem] = set()
    for one in single:
        apart: list[Problem] = []
        made = connect(one, descriptions, absent, places, folder, step_size, apart, notes)
        # Every element reports the same problem of an effect on an array.
        found += [problem for problem in apart if problem not in reported]
        reported.update(apart)
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
    fed |= {name for part in parts for name in inputs_with_unreadable_start(part, gaps)}
    unsure: set[str] = set()  # instances whose direct feedthrough is not known
    instances = [
        resolve_start_values(part, starts[part.name], wired, fed, places, found, notes, unsure, keep)
        for part in parts
    ]
    notes += _kept(instances)
    unread = {one.name for one in parts if not gaps.whole("instances", one.name, "feedthrough")}
    for part in parts:
        notes += remarks(part, places)
        if all(gaps.knows("instances", part.name, key) for key in ("tolerance", "interface")):
            notes += checks.integration(part.name, part.fmu, places)
    together = [one for one in parts if gaps.knows("instances", one.name, "isolate")]
    found += checks.shared_process(((part.name, part.fmu) for part in together), places)
    wanted = dict(record or {})
    for text, path in (needed or {}).items():
        wanted.setdefault(text, path)
    recorded = _recorded(record is None, wanted, instances, absent, places, found)
    sure = [one for one in instances if one.name not in unsure | unread]
    passing = checked if gaps.knows("run", "step_size") else [one for one in checked if not _may_hold(one)]
    rounds = algebraic_loops(sure, passing, places, loops, found, step_size)
    notes += rounds.notes
    if unread or len(passing) < len(checked):
        unchecked.append("algebraic loops by way of effects or instances that are not known")
    unknown = gaps.further("connections") or not all(one.known for one in stated)
    bonded = _bonded(bonds, instances, checked, stated, unknown, absent, places, found, notes)
    if bonds and unknown:
        unchecked.append("whether the connections of bonds are there")
    broken = any(not link.at_once for one in checked if one.wire for link in one.wire.every_link)
    longest = step_size if broken else None
    system = System(
        tuple(instances),
        tuple(checked),
        recorded,
        notes=tuple(notes),
        loops=tuple(rounds.solvable),
        longest_step=longest,
        bonds=bonded,
        held=frozenset(rounds.held),
    )
    return CheckedSystem(system, tuple(found), tuple(unchecked))


def _kept(instances: Sequence[Instance]) -> list[str]:
    """One line that counts the inputs that nothing feeds."""
    names = [f"{one.name}.{name}" for one in instances for name in one.unconnected]
    if not names:
        return []
    many = len(names) > 1
    subject = f"{len(names)} inputs have" if many else f"input {names[0]} has"
    return [
        f"{subject} no connection and keep{'' if many else 's'} the start value that the FMU declares; "
        "`orchestrator check -v` lists such inputs, `run.unconnected: error` refuses them"
    ]


def _may_hold(connection: Connection) -> bool:
    """Whether over a step that is short enough an effect passes nothing at once."""
    links = connection.wire.every_link if connection.wire else ()
    return any(not link.effect.passes_at_once(1e-12) for link in links)


def _stated(
    connections: Iterable[str | ConnectionModel | Mapping[str, Any] | None],
    descriptions: Mapping[str, ModelDescription],
    problems: list[Problem],
    unchecked: list[str],
    places: Places,
    absent: Absent,
    gaps: Gaps,
) -> tuple[list[Ends], list[Ends], set[str]]:
    """Take connections apart, element by element.

    Returns: the elements, and, of a connection with problems, all of it before them; the elements alone;
        all inputs that are fed, or may be meant to be.
    """
    stated: list[Ends] = []
    single: list[Ends] = []
    fed: set[str] = set()
    every, unknown = intended_inputs(Ends(0, (), ""), descriptions), gaps.further("connections")
    for index, connection in enumerate(connections):
        # Also an unknown one: it may feed any input.
        known = gaps.whole("connections", index)
        whole = Ends(index, (), "", known=False) if connection is None else Ends.of(index, connection, known)
        ends, targets, wrong = elements(whole, descriptions, places)
        fed.update(targets)
        there = whole.target in every or whole.target.partition(".")[0] in absent.names
        if targets == [whole.target] and not there:
            like = intended_inputs(whole, descriptions)
            unknown |= bool(every) and like >= every
            fed |= like
        problems += wrong
        single += ends
        stated += [whole, *ends] if wrong else ends
    if unknown:
        unchecked.append("whether all inputs are connected")
    return stated, single, fed | (every if unknown else set())


def _bonded(
    bonds: Sequence[BondModel | None] | None,
    instances: Sequence[Instance],
    connections: Sequence[Connection],
    stated: Sequence[Ends],
    unknown: bool,
    absent: Absent,
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
    faulty = [one.leading for one in stated]
    return declared_bonds(bonds, connections, variable, numeric, places, problems, faulty, absent, unknown)


def _recorded(
    outputs: bool,
    wanted: Mapping[str, tuple[str | int, ...]],
    instances: Sequence[Instance],
    absent: Absent,
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
        description = descriptions.get(name)
        members: list[str] = []
        if description is not None and variable not in description.variables:
            members = [one.name for one in description.elements(variable)]
        for one in members or [variable]:
            problem = checks.recordable(
                name, one, descriptions, places.text(path), absent.among(descriptions)
            )
            if problem is not None:
                problems.append(problem)
                break
            ports[Port(name, one)] = None
    return tuple(ports)
