"""Connections of a config -> checked connections: arrays element by element, units through every effect."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ..base.errors import Problem, close, listed, nearest
from ..base.quantities import Measure
from ..base.units import ONE, UnitError, convert, parse_unit
from ..config import Absent, ConnectionModel, Places, SourceModel
from ..effects import create_effect
from ..effects.base import times_unit
from ..effects.choose import BUILT_IN
from ..effects.gain import split
from ..fmi import Causality, Kind, ModelDescription
from . import checks
from .connection import Connection, Leg, Link, Port, Wire


@dataclass(frozen=True)
class Ends:
    """A connection as a config has it, or one element of one between arrays.

    Attributes:
        index: of the connection in the config.
        sources: output and gain of each.
        target: the input.
        through: its effects.
        element: of an array, counted from 0; None for a scalar.
        known: whether it is all there is of the connection. Of one that is not, sources may be missing and
            the target be empty; what is there is checked, and no connection is made.
    """

    index: int
    sources: tuple[tuple[str, Any], ...]
    target: str
    through: tuple[Any, ...] = ()
    element: int | None = None
    known: bool = True

    @staticmethod
    def of(index: int, connection: str | ConnectionModel | Mapping[str, Any], known: bool = True) -> Ends:
        """The ends of "a.y -> b.u" or of the long form."""
        if isinstance(connection, str):
            source, target = connection.split("->")
            return Ends(index, ((source.strip(), 1),), target.strip(), known=known)
        if isinstance(connection, Mapping):
            connection = ConnectionModel.model_validate(connection)
        given = connection.source if isinstance(connection.source, list) else [connection.source]
        sources = [one if isinstance(one, SourceModel) else SourceModel(port=one, gain=1) for one in given]
        return Ends(
            index,
            tuple((one.port.strip(), one.gain) for one in sources),
            connection.target.strip(),
            tuple(connection.through),
            known=known,
        )

    @property
    def leading(self) -> str:
        """The first source and the target, by which bonds name a connection: "a.y -> b.u"."""
        return f"{self.sources[0][0] if self.sources else ''} -> {self.target}"

    def __str__(self) -> str:
        return f"{' + '.join(name for name, _ in self.sources) or '...'} -> {self.target or '...'}"

    @property
    def plain(self) -> bool:
        """Whether the value at the target is that at the source, but for its unit."""
        return len(self.sources) == 1 and self.sources[0][1] in (1, "1") and not self.through


def _family(text: str, descriptions: Mapping[str, ModelDescription], causality: Causality) -> dict[str, str]:
    """Elements of an array port by their indices, "[1]", in the description's order; none of a scalar."""
    name, _, variable = text.partition(".")
    description = descriptions.get(name)
    if description is None or not variable or variable in description.variables:
        return {}
    return {
        one.name[len(variable) :].replace(" ", ""): f"{name}.{one.name}"
        for one in description.elements(variable)
        if one.causality is causality
    }


def elements(
    ends: Ends, descriptions: Mapping[str, ModelDescription], places: Places
) -> tuple[list[Ends], list[str], list[Problem]]:
    """A connection between arrays, element by element; one between scalars stays as it is.

    Args:
        descriptions: by instance.
    Returns: the connections, the inputs that they are meant to feed, and problems.
    """
    sources = [_family(name, descriptions, Causality.OUTPUT) for name, _ in ends.sources]
    target = _family(ends.target, descriptions, Causality.INPUT)
    if not target and not any(sources):
        return [ends], [ends.target], []
    fed = [*target.values()] or [ends.target]
    named = {name.partition(".")[0] for name in (ends.target, *(name for name, _ in ends.sources))}
    if not ends.known or not named <= descriptions.keys():
        # Of an array at one end alone it cannot be determined whether it fits.
        return [replace(ends, known=False)], fed, []
    for (name, _), found in zip(ends.sources, sources, strict=True):
        if found.keys() != target.keys():
            what = f"cannot connect {name} ({_shape(found)}) to {ends.target} ({_shape(target)})"
            place = places.text(("connections", ends.index))
            allowed = "arrays are connected element by element, and need the same elements on both sides"
            return [], fed, [Problem(place, what, allowed, "Connect single elements by their names.")]
    return (
        [
            Ends(
                ends.index,
                tuple((found[key], gain) for found, (_, gain) in zip(sources, ends.sources, strict=True)),
                target[key],
                ends.through,
                number,
            )
            for number, key in enumerate(target)
        ],
        fed,
        [],
    )


def intended_inputs(ends: Ends, descriptions: Mapping[str, ModelDescription]) -> set[str]:
    """The inputs that a connection may be meant for: its target or, if that is none, those of a like name."""
    name, _, variable = ends.target.partition(".")
    if not variable:
        near = close(name, descriptions) or descriptions
        return {f"{one}.{v.name}" for one in near for v in descriptions[one].inputs}
    if name not in descriptions:
        return {f"{one}.{variable}" for one in close(name, descriptions) or descriptions}
    if variable in descriptions[name].variables:
        return {ends.target}
    inputs = [v.name for v in descriptions[name].inputs]
    return {f"{name}.{one}" for one in close(variable, inputs) or inputs}


def _shape(found: Mapping[str, str]) -> str:
    return f"elements {listed(found, 9)}" if found else "no array"


def connect(
    ends: Ends,
    descriptions: Mapping[str, ModelDescription],
    absent: Absent,
    places: Places,
    folder: Path,
    step_size: float | None,
    problems: list[Problem],
    notes: list[str],
) -> Connection | None:
    """Check a connection between scalars.

    Args:
        descriptions: by instance; absent: instances that have a problem of their own.
        places: where the values were written; folder: what relative paths start from.
        step_size: the communication step [s]; None if it is not known.
        problems, notes: what is found is added.
    Returns: None if there is a problem.
    """
    check = _ConnectionCheck(ends, descriptions, absent, places, problems)
    sources = [check.port(name) for name, _ in ends.sources]
    target = check.port(ends.target) if ends.target else None
    if not ends.known or target is None or None in sources:
        check.apart([one for one in sources if one is not None], target)
        check.links(ends, None, folder, step_size)
        return None
    found = [one for one in sources if one is not None]
    if ends.plain:
        source = found[0]
        result = checks.connection(
            source, descriptions[source.instance], target, descriptions[target.instance], check.place
        )
        if isinstance(result, list):
            problems += result
            return None
        gain, offset, note = result
        if note:
            notes.append(f"{check.place}: {note}")
        return Connection(source, target, gain, offset)
    before = len(problems)
    for one in found:
        check.end(one, Causality.OUTPUT)
    check.end(target, Causality.INPUT)
    if len(problems) == before:
        check.kinds([*found, target])
    if len(problems) > before:
        # What the effects are is checked without units then.
        check.links(ends, None, folder, step_size)
        return None
    legs, measure = check.legs(found)
    links, measure = check.links(ends, measure, folder, step_size)
    if len(problems) > before:
        return None
    made = Connection(found[0], target, wire=Wire(tuple(legs), tuple(links)))
    variable = descriptions[target.instance].variables[target.variable]
    wanted = Measure(variable.unit_name, variable.unit)
    what = f"cannot connect {made}: what comes out is in {measure.name or 'no unit'}"
    factors = _converted(measure, wanted, check.place, what, f"{target.instance}.{variable}")
    if isinstance(factors, Problem):
        problems.append(factors)
        return None
    gain, offset, checked = factors
    if not checked:
        notes.append(f"{check.place}: {made}: units not checked")
    elif (gain, offset) != (1.0, 0.0):
        shift = f" + {offset!r}" if offset else ""
        notes.append(f"{check.place}: {made}: converted, {gain!r} * value{shift}")
    return Connection(found[0], target, gain, offset, made.wire)


def _converted(
    one: Measure, other: Measure, place: str, what: str, taker: str
) -> tuple[float, float, bool] | Problem:
    """Gain, offset, and whether units could be checked."""
    if one.unit is None or other.unit is None:
        if one.name == other.name:
            return 1.0, 0.0, True
        if one.name and other.name:
            return Problem(place, what, f"it is to be that of {taker}, and not both units are known")
        return 1.0, 0.0, False
    if not one.unit.same_dimension(other.unit):
        allowed = f"{taker} is [{other.unit.base()}], not [{one.unit.base()}]"
        return Problem(place, what, allowed, "A gain with a unit changes the unit: {gain: 2 N/m}.")
    try:
        return *convert(one.unit, other.unit), True
    except UnitError as error:
        return Problem(place, what, str(error))


class _ConnectionCheck:
    """Checks the parts of one connection."""

    def __init__(
        self,
        ends: Ends,
        descriptions: Mapping[str, ModelDescription],
        absent: Absent,
        places: Places,
        problems: list[Problem],
    ) -> None:
        self._ends, self._descriptions, self._absent = ends, descriptions, absent
        self._places, self._problems = places, problems
        self._path = ("connections", ends.index)
        self.place = places.text(self._path)

    def port(self, text: str) -> Port | None:
        """A port by its name; None if there is a problem, or nothing is known of the instance."""
        name, dot, variable = text.partition(".")
        if name in self._absent:
            return None
        if name not in self._descriptions:
            what = f"no instance {name!r} in {self._ends}"
            names = self._absent.among(self._descriptions)
            self._problems.append(
                Problem(self.place, what, f"instances: {listed(names)}", nearest(name, names))
            )
        elif not dot:
            self._problems.append(
                Problem(self.place, f"{text!r} names no variable", f"written as {name}.variable")
            )
        else:
            return Port(name, variable)
        return None

    def apart(self, sources: list[Port], target: Port | None) -> None:
        """Check each end of a connection that is known in part."""
        ends = [(port, Causality.OUTPUT) for port in sources]
        ends += [(target, Causality.INPUT)] if target is not None else []
        for port, causality in ends:
            if _family(str(port), self._descriptions, causality):
                continue
            if not self._ends.plain:
                self.end(port, causality)
                continue
            problem = checks.end(port, self._descriptions[port.instance], causality, self.place)
            self._problems += [problem] if problem is not None else []

    def end(self, port: Port, causality: Causality) -> bool:
        """Whether a port can be an end of a connection with effects."""
        description = self._descriptions[port.instance]
        problem = checks.end(port, description, causality, self.place)
        kind = Kind.REAL if problem is not None else description.variables[port.variable].kind
        if kind is not Kind.REAL and not (self._tables and kind.numeric):
            what = f"{port} is of type {kind}"
            problem = Problem(self.place, what, "effects and sums take real numbers only, except map")
        if problem is not None:
            self._problems.append(problem)
        return problem is None

    @property
    def _tables(self) -> bool:
        """Whether whole numbers, booleans and enumerations may pass: by tables only."""
        ends = self._ends
        single = len(ends.sources) == 1 and ends.sources[0][1] in (1, "1")
        return single and all(isinstance(item, Mapping) and "map" in item for item in ends.through)

    def kinds(self, ports: list[Port]) -> None:
        """Check whether values of the one end's kind are values of the other's."""
        kinds = {self._descriptions[port.instance].variables[port.variable].kind for port in ports}
        if len(kinds) > 1 and kinds != {Kind.INTEGER, Kind.ENUMERATION}:
            what = f"cannot connect {self._ends}: types differ, {listed(sorted(kinds))}"
            allowed = "a table turns integers into enumerations and back, and leaves other types as they are"
            self._problems.append(Problem(self.place, what, allowed))

    def _measure(self, port: Port) -> Measure:
        variable = self._descriptions[port.instance].variables[port.variable]
        return Measure(variable.unit_name, variable.unit, variable.display_units)

    def legs(self, ports: list[Port]) -> tuple[list[Leg], Measure]:
        """The summands, in the unit of the first that is no difference, or else of the first."""
        read: list[tuple[Port, float, Measure]] = []
        for number, (port, (_, given)) in enumerate(zip(ports, self._ends.sources, strict=True)):
            measure = self._measure(port)
            try:
                factor, unit_name = split(given)
                unit = parse_unit(unit_name)
            except UnitError as error:
                place = self._places.text((*self._path, "from", number, "gain"))
                allowed = "a number, with a unit or without"
                self._problems.append(Problem(place, f"gain of {port}: {error}", allowed))
                continue
            if unit != ONE:
                if measure.unit is None:
                    what = f"gain of {port} in {unit_name}: the unit of {port} is not known"
                    self._problems.append(Problem(self.place, what, remedy="Give a bare number."))
                    continue
                if measure.unit.offset:
                    what = f"gain of {port} in {unit_name}: {measure.name} has an offset"
                    self._problems.append(Problem(self.place, what, remedy="Give a bare number."))
                    continue
                measure = times_unit(measure, unit)
            read.append((port, factor, measure))
        if not read:
            return [], Measure()
        values = [one for one in read if one[2].unit is None or not one[2].unit.difference]
        lead, _, first = (values or read)[0]
        # Of values, not of differences: a sum of 1 gives a value, a sum of 0 a difference.
        total = sum(factor for _, factor, _ in values)
        legs: list[Leg] = []
        shifted = False
        for port, factor, measure in read:
            if port is lead and not legs:
                legs.append(Leg(port, factor))
                continue
            own = first
            if measure.unit is not None and measure.unit.difference and first.unit is not None:
                own = first._replace(unit=first.unit.of_differences())
            what = f"cannot add {port} [{measure.name}] to {lead} [{first.name}]"
            converted = _converted(measure, own, self.place, what, str(lead))
            if isinstance(converted, Problem):
                self._problems.append(converted)
                continue
            gain, offset, _ = converted
            shifted |= offset != 0.0
            legs.append(
                Leg(port, gain * factor, offset * factor) if factor != 1.0 else Leg(port, gain, offset)
            )
        if shifted and min(abs(total), abs(total - 1.0)) > 1e-9:
            what = f"cannot add {listed(map(str, ports))}: the origins of their units differ"
            allowed = f"gains whose sum is 1 (a value) or 0 (a difference), got {total:g}"
            self._problems.append(Problem(self.place, what, allowed))
        if values and first.unit is not None and (first.unit.offset or shifted) and abs(total) < 1e-12:
            # The difference of two temperatures: origins cancel.
            first = first._replace(unit=first.unit.of_differences())
        return legs, first

    def links(
        self, ends: Ends, measure: Measure | None, folder: Path, step_size: float | None
    ) -> tuple[list[Link], Measure]:
        """The effects in turn, and the unit of what comes out.

        Args:
            measure: of what goes in; None: not known, and what depends on it is not checked.
        """
        links: list[Link] = []
        known = measure is not None
        current = measure or Measure()
        for number, item in enumerate(ends.through):
            path = (*self._path, "through", number)

            def place(key: str = "", path: tuple[str | int, ...] = path) -> str:
                return self._places.text((*path, key) if key else path)

            made = create_effect(item, current, place, folder, ends.element, units=known)
            if isinstance(made, list):
                self._problems += made
                # Of the unit behind an effect that is not known nothing is known.
                known &= (
                    isinstance(item, Mapping) and "gain" not in item and not BUILT_IN.keys().isdisjoint(item)
                )
                continue
            reads = [self.port(text) for text in made.reads]
            if not all(port is not None and self.end(port, Causality.OUTPUT) for port in reads):
                continue
            links.append(
                Link(
                    made.effect,
                    made.name,
                    tuple(port for port in reads if port is not None),
                    made.effect.passes_at_once(step_size),
                )
            )
            current = made.measure
        return links, current
