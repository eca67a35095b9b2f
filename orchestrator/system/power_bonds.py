"""Power bonds: which connections carry energy from one instance to another, and the motion it goes with."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

from ..base.errors import Problem, listed, nearest
from ..base.units import Unit, parse_unit
from ..config import BondModel, Places
from ..fmi import Kind, Variable

if TYPE_CHECKING:
    from .connection import Connection, Port

# Effort, flow, and the displacement whose rate the flow is.
_DOMAINS = tuple(
    tuple(parse_unit(text) for text in row)
    for row in (
        ("N", "m/s", "m"),
        ("N.m", "rad/s", "rad"),
        ("V", "A", "C"),
        ("Pa", "m3/s", "m3"),
        ("K", "W/K", "J/K"),
    )
)
_JOULE, _WATT = parse_unit("J").exponents, parse_unit("W").exponents
_RAD = 7  # place of the radian among a unit's exponents: a torque times an angle is an energy
_MOST_LEGS, _MOST_TRIED = 4, 100_000


@dataclass(frozen=True)
class Bond:
    """A cycle of connections on which an effort goes one way, and the motion that it works on the other.

    Attributes:
        name: of the bond.
        effort: the connections from the instance that gives the energy to the one that takes it; more than
            one where instances in between (a force sensor, a controller) pass the effort on.
        motion: flow or displacement of the taker; positive effort along it gives the taker energy.
        flow: the connections from the taker back to the giver, by way of a robot, for example; none where the
            source does not receive the motion.
        displaced: for `motion` and each connection of `flow`, whether it is a displacement, not a flow.
        sign: -1 where a positive effort along the motion takes energy from the taker.
        rates: connections between the same instances as displacements of `flow`, of their rates, which are
            not counted; of bonds that were found.
    """

    name: str
    effort: tuple[Connection, ...]
    motion: Port
    flow: tuple[Connection, ...]
    displaced: tuple[bool, ...]
    sign: float = 1.0
    rates: tuple[Connection, ...] = ()

    @property
    def giver(self) -> str:
        """The instance that the effort comes from."""
        return self.effort[0].source.instance

    @property
    def taker(self) -> str:
        """The instance that the effort acts on."""
        return self.effort[-1].target.instance

    def __str__(self) -> str:
        way = " ".join(f"{one}," for one in (*self.effort, *self.flow))
        text = f"{self.name}: {way.rstrip(',') if self.flow else f'{way} {self.motion}'}"
        return f"{text} (not the rate: {listed(map(str, self.rates))})" if self.rates else text


def moves_by(effort: Unit, motion: Unit) -> bool | None:
    """Whether effort times motion is an energy (True) or a power (False), radians left aside; else None."""
    product = tuple(one + other for one, other in zip(effort.exponents, motion.exponents, strict=True))
    return {_JOULE[:_RAD]: True, _WATT[:_RAD]: False}.get(product[:_RAD])


@dataclass
class _Budget:
    """How many more legs of ways are tried."""

    left: int


def find_bonds(
    connections: Sequence[Connection], variable: Callable[[Port], Variable]
) -> tuple[tuple[Bond, ...], tuple[str, ...]]:
    """The bonds that units and graph leave no doubt about.

    A bond is sought wherever connections whose unit is an effort's lead from one instance to another, and
    connections of the same domain's flow or displacement lead back. Where two that have a connection in
    common are found, nobody but the author can say which of them carries the energy: both are left out,
    and with them all others between the same two instances.
    Between two instances that are connected by a flow and its displacement, the displacement counts, and the
    bond names the other.

    Args:
        connections: of the system.
        variable: gives the variable of a port.
    Returns: bonds in the order of the connections, and what was left out, as texts.
    """
    found: list[Bond] = []
    budget = _Budget(_MOST_TRIED)
    for effort, flow, displacement in _DOMAINS:
        efforts = _leaving(connections, variable, (effort,))
        motions = _leaving(connections, variable, (displacement, flow))
        informed = {one.target.instance for leaving in motions.values() for one in leaving}
        for first in [one for leaving in efforts.values() for one in leaving]:
            if first.source.instance not in informed:
                continue
            for way in _ways(efforts, first.source.instance, None, budget, (first,)):
                giver, taker = first.source.instance, way[-1].target.instance
                passed = frozenset(one.source.instance for one in way[1:])
                for back in _ways(motions, taker, giver, budget, (), passed):
                    if not _subscripts_differ(way, back):
                        displaced = tuple(
                            _has_unit(variable(one.source), displacement) for one in (back[0], *back)
                        )
                        found.append(Bond(f"{giver}-{taker}", way, back[0].source, back, displaced))
        if budget.left <= 0:
            return (), (
                "no power bonds are looked for: too many ways between instances; say them under bonds",
            )
    whole = [bond for bond in found if not any(map(_mixed, (*bond.effort, *bond.flow)))]
    mixed = dict.fromkeys(bond.name for bond in found if bond not in whole)
    kept, notes = _undoubted(whole, connections)
    if mixed:
        notes += (f"no books are kept of power bonds {listed(mixed)}: {_MIXED}",)
    return tuple(replace(bond, rates=_rates(bond, connections, variable)) for bond in kept), notes


def _rates(
    bond: Bond, connections: Sequence[Connection], variable: Callable[[Port], Variable]
) -> tuple[Connection, ...]:
    """Connections of a flow beside those of its displacement."""
    counted = [one for one, displaced in zip(bond.flow, bond.displaced[1:], strict=True) if displaced]
    effort = variable(bond.effort[0].source).unit

    def rate(port: Port) -> bool:
        unit = variable(port).unit
        return effort is not None and unit is not None and moves_by(effort, unit) is False

    return tuple(
        other
        for one in counted
        for other in connections
        if (other.source.instance, other.target.instance) == (one.source.instance, one.target.instance)
        and rate(other.source)
        and rate(other.target)
        and not _subscripts_differ((one, other))
    )


_MIXED = "one of their connections is made of several signals"


def _mixed(connection: Connection) -> bool:
    """Whether a connection carries more than the energy of one bond: a sum, or what several instances give.

    What the masters feed of such a signal over a step, with some of its sources at the step's end, stands in
    no communication point, besides.
    """
    legs = 1 if connection.wire is None else len(connection.wire.legs)
    return legs > 1 or len({port.instance for port in connection.sources}) > 1


def _undoubted(
    found: list[Bond], connections: Sequence[Connection]
) -> tuple[tuple[Bond, ...], tuple[str, ...]]:
    shared = Counter(one for bond in found for one in {*bond.effort, *bond.flow})
    clear = [bond for bond in found if all(shared[one] == 1 for one in (*bond.effort, *bond.flow))]
    doubted = dict.fromkeys(bond.name for bond in found if bond not in clear)
    kept = [bond for bond in clear if bond.name not in doubted]
    rank = {one: place for place, one in enumerate(connections)}
    kept.sort(key=lambda bond: rank[bond.effort[0]])
    notes = (
        (f"power bonds {listed(doubted)} overlap: say under bonds which connections carry energy",)
        if doubted
        else ()
    )
    return _named(kept), notes


def _named(bonds: Iterable[Bond]) -> tuple[Bond, ...]:
    """Bonds of the same name are numbered."""
    seen: Counter[str] = Counter()
    made = []
    for bond in bonds:
        seen[bond.name] += 1
        made.append(replace(bond, name=f"{bond.name}-{seen[bond.name]}") if seen[bond.name] > 1 else bond)
    return tuple(made)


def _has_unit(variable: Variable, unit: Unit) -> bool:
    return variable.unit is not None and variable.unit.same_dimension(unit)


def _leaving(
    connections: Sequence[Connection], variable: Callable[[Port], Variable], units: tuple[Unit, ...]
) -> dict[str, list[Connection]]:
    """Connections of these units by the instance that they leave; effects may not change the dimension.

    Of two to the same instance that have not the same unit only that of the earlier unit is given.
    """
    leaving: dict[str, list[Connection]] = {}
    for connection in connections:
        source, target = variable(connection.source), variable(connection.target)
        if source.kind is Kind.REAL and any(_has_unit(source, u) and _has_unit(target, u) for u in units):
            leaving.setdefault(connection.source.instance, []).append(connection)
    if len(units) == 1:
        return leaving
    for name, members in leaving.items():
        better = {c.target.instance for c in members if _has_unit(variable(c.source), units[0])}
        leaving[name] = [
            c for c in members if c.target.instance not in better or _has_unit(variable(c.source), units[0])
        ]
    return leaving


def _ways(
    leaving: Mapping[str, Sequence[Connection]],
    begin: str,
    end: str | None,
    budget: _Budget,
    taken: tuple[Connection, ...],
    barred: frozenset[str] = frozenset(),
) -> Iterator[tuple[Connection, ...]]:
    """Paths of connections that meet no instance twice: to `end`, or all that continue `taken`."""
    last = taken[-1].target.instance if taken else begin
    budget.left -= 1
    if budget.left <= 0:
        return
    if taken and last in {begin, *(one.source.instance for one in taken)}:
        return
    if taken and (end is None or last == end):
        yield taken
    if last == end or len(taken) == _MOST_LEGS:
        return
    for connection in leaving.get(last, ()):
        if connection.target.instance not in barred:
            yield from _ways(leaving, begin, end, budget, (*taken, connection), barred)


def _subscripts_differ(*ways: tuple[Connection, ...]) -> bool:
    """Whether array elements of different places meet: the second force and the first velocity."""
    names = (port.variable for way in ways for one in way for port in (one.source, one.target))
    return len({name.partition("[")[2] for name in names if "[" in name}) > 1


def declared_bonds(
    models: Sequence[BondModel | None],
    connections: Sequence[Connection],
    variable: Callable[[Port], Variable],
    ports: Mapping[str, Port],
    places: Places,
    problems: list[Problem],
    faulty: Collection[str] = (),
    absent: Container[str] = (),
    further: bool = False,
) -> tuple[Bond, ...]:
    """The bonds that a config declares.

    Args:
        models: as in the config; None is left out.
        connections: of the system.
        variable: gives the variable of a port.
        ports: all numeric outputs, by instance.variable.
        places: where the values were written.
        problems: what is wrong is added here.
        faulty: connections of the config that have a problem of their own, as "a.y -> b.u"; absent: such
            instances. A bond is not blamed for them.
        further: whether there may be connections that are not known.
    """
    known: dict[str, Connection | None] = dict.fromkeys(faulty)
    known |= {f"{one.source} -> {one.target}": one for one in connections}
    made = []
    for index, model in enumerate(models):
        if model is None:
            continue
        place = places.text(("bonds", index))
        before = len(problems)
        missing = [] if further else problems
        effort = [_leg(text, known, place, missing) for text in model.effort_legs()]
        flow = [_leg(text, known, place, missing) for text in model.flow_legs()]
        motion = None
        if model.flow_port() is not None:
            motion = ports.get(model.flow_port() or "")
            if motion is None and (model.flow_port() or "").partition(".")[0] in absent:
                continue
            if motion is None:
                what = f"no output {model.flow_port()!r}"
                problems.append(Problem(place, what, remedy=nearest(model.flow_port() or "", ports)))
        way, back = [one for one in effort if one], [one for one in flow if one]
        if len(problems) > before or len(way) < len(effort) or len(back) < len(flow):
            continue
        motion = motion or back[0].source
        bond = Bond("", tuple(way), motion, tuple(back), ())
        bond = replace(bond, name=model.name or f"{bond.giver}-{bond.taker}", sign=float(model.sign))
        wrong = _broken(bond)
        if wrong:
            problems.append(Problem(place, wrong, "a bond leads from one instance to another and back"))
            continue
        displaced = _kinds(bond, model.displacement, variable, place, problems)
        made.append(replace(bond, displaced=displaced))
    return _named(made)


def _leg(
    text: str, known: Mapping[str, Connection | None], place: str, problems: list[Problem]
) -> Connection | None:
    ends = [end.strip() for end in text.split("->")]
    name = " -> ".join(ends)
    wrong = [one.split(" -> ") for one, made in known.items() if made is None]
    # A connection with a problem of its own may be meant, where that is in the name of its other end.
    if name not in known and not any(ends[0] == one[0] or ends[-1] == one[-1] for one in wrong):
        problems.append(Problem(place, f"no connection {text!r}", "", nearest(name, known)))
    return known.get(name)


def _broken(bond: Bond) -> str:
    """What does not fit together; empty if all does."""
    for one in (*bond.effort, *bond.flow):
        if _mixed(one):
            return f"{one} is made of several signals, whose energies cannot be distinguished"
    for way in (bond.effort, bond.flow):
        for one, other in pairwise(way):
            if one.target.instance != other.source.instance:
                return f"{one} does not lead on to {other}"
    if bond.motion.instance != bond.taker:
        return f"{bond.motion} is no motion of {bond.taker}, which {bond.effort[-1]} acts on"
    if bond.flow and bond.flow[-1].target.instance != bond.giver:
        return f"{bond.flow[-1]} does not lead back to {bond.giver}"
    return ""


def _kinds(
    bond: Bond,
    declared: bool | None,
    variable: Callable[[Port], Variable],
    place: str,
    problems: list[Problem],
) -> tuple[bool, ...]:
    """Per motion of a declared bond, whether it is a displacement."""
    effort = variable(bond.effort[0].source)
    kinds = []
    for port in (bond.motion, *(one.source for one in bond.flow)):
        motion = variable(port)
        if effort.unit is None or motion.unit is None:
            kinds.append(bool(declared))
            continue
        found = moves_by(effort.unit, motion.unit)
        if found is None:
            what = f"{bond.effort[0].source} [{effort.unit_name}] times {port} [{motion.unit_name}]"
            problems.append(Problem(place, f"{what} is no power", "W, or J for a displacement, is needed"))
        kinds.append(bool(found))
    return tuple(kinds)
