"""Algebraic loops: rounds of connections and direct feedthrough within one instant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

from ..base import graph
from ..base.errors import Problem, listed
from ..config import Places
from ..config.text import flow
from ..fmi import Kind
from .connection import Connection, Port
from .system import Instance, port_graph


@dataclass
class Loops:
    """Algebraic loops of a system that are no problems.

    Attributes:
        solvable: those at communication points that the master solves, inputs and outputs in turn.
        held: ports of those that exist by assumed dependencies alone, and that the master does not solve.
        notes: of the latter, how they are run.
    """

    solvable: list[tuple[Port, ...]] = field(default_factory=list)
    held: set[Port] = field(default_factory=set)
    notes: list[str] = field(default_factory=list)


def algebraic_loops(
    instances: Sequence[Instance],
    connections: Sequence[Connection],
    places: Places,
    accepted: bool,
    problems: list[Problem],
    step_size: float | None,
) -> Loops:
    """Algebraic loops at communication points that are accepted; the others become problems.

    Those at initialisation are always accepted, if they can be solved at all: FMI lets inputs be set and
    outputs be read there as often as it takes. Where the master solves none, a loop that only assumed
    dependencies close is accepted, too: most FMUs that declare none have no direct feedthrough.

    Args:
        instances: all that loops are to be looked for through; connections may lead to others, too.
        accepted: whether a master solves them.
        step_size: of the communication step [s]; None if it is not known.
    """
    reported: dict[frozenset[Port], Problem] = {}
    found = Loops()
    place = places.text(("connections",))
    targets = {connection.target: connection for connection in connections}
    variables = {one.name: one.fmu.description.variables for one in instances}
    assumed = {Port(one.name, output) for one in instances for output in one.assumed}
    for initial in (False, True):
        nodes, successors = port_graph(instances, connections, initial=initial)
        ports = list(nodes)
        for component in graph.strong_components(successors):
            cycle = graph.shortest_cycle(successors, component[0], component)
            if not cycle:
                continue
            members = [ports[index] for index in component]
            declared = _declared(component, successors, ports, targets, assumed)
            if not accepted and not declared:
                found.held.update(members)
                found.notes += [] if initial else [_note(members, targets, place)]
                continue
            if declared and not any(hop in declared for hop in pairwise([*cycle, cycle[0]])):
                # A loop is reported because it is rejected.
                node, output = declared[0]
                cycle = graph.shortest_cycle(
                    [[output] if index == node else after for index, after in enumerate(successors)],
                    node,
                    component,
                )
            kinds = {port: variables[port.instance][port.variable].kind for port in members}
            other = [port for port, kind in kinds.items() if kind is not Kind.REAL]
            loop = [ports[index] for index in cycle]
            if loop[0] not in targets:
                loop = [*loop[1:], loop[0]]
            key = frozenset(loop)
            if not other and (accepted or initial):
                if not initial:
                    found.solvable.append(tuple(loop))
                continue
            if key not in reported:
                reason = ""
                if other:
                    reason = f"{other[0]} is of type {kinds[other[0]]}, and only real numbers can be iterated"
                reported[key] = loop_problem(loop, targets, assumed, place, initial, reason, step_size)
    problems += reported.values()
    return found


def _declared(
    component: Sequence[int],
    successors: Sequence[Sequence[int]],
    ports: Sequence[Port],
    targets: Mapping[Port, Connection],
    assumed: set[Port],
) -> list[tuple[int, int]]:
    """Inputs and outputs of a component, as nodes, where the output depends on the input by declaration."""
    within = set(component)
    return [
        (node, after)
        for node in component
        if ports[node] in targets
        for after in successors[node]
        if after in within and ports[after] not in assumed
    ]


def _note(members: Sequence[Port], targets: Mapping[Port, Connection], place: str) -> str:
    """How a loop of assumed dependencies is run, and what to do about it."""
    outputs: dict[str, list[str]] = {}
    for port in members:
        if port not in targets:
            outputs.setdefault(port.instance, []).append(port.variable)
    names = [f"{name}.{one}" for name, ones in outputs.items() for one in ones]
    stated = [_stated(name, ones) for name, ones in outputs.items()]
    return (
        f"{place}: an algebraic loop that is only assumed: the FMUs do not say what {listed(names, 6)} "
        "depend on. Its inputs hold their values over a step, one step of delay (under gauss-seidel only "
        "those from instances that step later); at the start, begun with start values, they are passed on "
        "until they agree. If the outputs do not depend on inputs of the same instant, say so: "
        f"{'; '.join(stated)}. If they do, take the master iterative."
    )


def _stated(instance: str, outputs: Sequence[str]) -> str:
    """How a config says that outputs depend on nothing at once."""
    return f"instances.{instance}.feedthrough: {flow({one: [] for one in outputs})}"


def loop_problem(
    loop: Sequence[Port],
    connections: Mapping[Port, Connection],
    assumed: set[Port],
    place: str,
    initial: bool,
    reason: str = "",
    step_size: float | None = None,
) -> Problem:
    """An algebraic loop, described connection by connection.

    Args:
        loop: inputs and outputs in turn, beginning with an input.
        connections: by target.
        assumed: outputs whose dependencies the FMU does not declare.
        reason: why no master could solve it; empty if one that iterates would.
        step_size: of the communication step [s]; None if it is not known.
    """
    hops, doubtful, short = [], None, False
    for index, port in enumerate(loop):
        after = loop[(index + 1) % len(loop)]
        if index % 2:
            wire, through = connections[after].wire, []
            for link in wire.links if wire else ():
                label = link.name
                # A delay: over a step short enough it passes nothing at once.
                if not initial and step_size is not None and link.at_once:
                    if not link.effect.passes_at_once(1e-9 * step_size):
                        label += f" (shorter than the step of {step_size!r} s, hence passed at once)"
                        short = True
                through.append(label)
            hops.append(f"{port} is connected to {after}{' through ' if through else ''}{', '.join(through)}")
            continue
        doubt = ""
        if after in assumed:
            doubt, doubtful = " (assumed: the FMU does not say what it depends on)", doubtful or after
        hops.append(f"{port} is direct-feedthrough to {after}{doubt}")
    shown = doubtful or loop[1]
    remedy = (
        (f"It cannot be solved: {reason}. " if reason else "The master iterative solves it; or take")
        + ("Take" if reason else "")
        + " a connection out of the loop, or put an instance without direct feedthrough into it.\n"
        + ("A delay that is no shorter than the step breaks the loop.\n" if short else "")
        + f"If {shown} does not depend on the inputs of the same instant, say so: "
        f"{_stated(shown.instance, [shown.variable])}"
    )
    return Problem(place, f"algebraic loop{' at initialisation' if initial else ''}", "\n".join(hops), remedy)
