"""All signals of a system in one flat vector, and where each port stands in it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..effects import Effect
from ..fmi import Array, Kind
from .connection import Connection, Leg, Port, Wire
from .system import System

_DOUBLES = ("Real", "Float64")


class Signals(NamedTuple):
    """Values of all read ports at one instant, and of the signals that connections make of them.

    Attributes:
        values: numeric ports, in the FMUs' units, Boolean 0 or 1; then what comes out of connections with
            effects; shape (layout.size,).
        texts: String outputs that are connected.
    """

    values: Array
    texts: Mapping[Port, str | bytes] = {}


@dataclass(frozen=True)
class Inputs:
    """What an instance's numeric inputs are fed from: value = gain * signals[source] + offset.

    Attributes:
        names: of the inputs.
        source: indices into the signal vector.
        gain, offset: None where no connection converts, so that values pass bit-identical.
    """

    names: tuple[str, ...]
    source: NDArray[np.intp]
    gain: Array | None
    offset: Array | None


@dataclass(frozen=True)
class Wired:
    """A connection with effects, or several sources, whose signal has a place of its own.

    A leg with effects of its own has an entry, too, which is computed before the sum.

    Attributes:
        connection: which one.
        place: of the signal in the vector.
        source, gain, offset: of its legs, shape (n,): the signal begins as the sum of gain * value + offset.
        links: its effects, each with the places of the further signals that it reads.
    """

    connection: Connection
    place: int
    source: NDArray[np.intp]
    gain: Array
    offset: Array
    links: tuple[tuple[Effect, NDArray[np.intp]], ...]


@dataclass(frozen=True)
class Layout:
    """Where every port stands.

    Attributes:
        size: length of the signal vector.
        index: place of each read port.
        outputs: per instance, the names of the ports that are read, in the vector's order.
        spans: per instance, its slice of the vector.
        inputs: per instance, its numeric inputs.
        text_inputs: per instance, its inputs of text and binary values, and their sources.
        text_outputs: per instance, its connected outputs of text and binary values.
        recorded: places of the recorded ports.
        wired: connections with effects, in the order of their places, which follow those of the ports.
        owners: per place, the port that stands there, or the first source of the connection that does.
        nominal: usual magnitude of each signal, shape (size,).
        smooth: which signals may be extrapolated, shape (size,): others keep their value over a step.
    """

    size: int
    index: Mapping[Port, int]
    outputs: tuple[tuple[str, ...], ...]
    spans: tuple[slice, ...]
    inputs: tuple[Inputs, ...]
    text_inputs: tuple[tuple[tuple[str, Port], ...], ...]
    text_outputs: tuple[tuple[str, ...], ...]
    recorded: NDArray[np.intp]
    wired: tuple[Wired, ...]
    owners: tuple[Port, ...]
    nominal: Array
    smooth: NDArray[np.bool_]

    @staticmethod
    def of(system: System) -> Layout:
        """The layout of a system: recorded ports, the sources of connections and the motions of bonds are
        read, others are not.
        """
        read: list[dict[str, None]] = [{} for _ in system.instances]
        sources = (port for one in system.connections for port in one.sources)
        for port in (*system.recorded, *sources, *(bond.motion for bond in system.bonds)):
            read[system.position[port.instance]][port.variable] = None
        outputs, spans, text_outputs = [], [], []
        index: dict[Port, int] = {}
        for instance, names in zip(system.instances, read, strict=True):
            variables = [instance.variable(name) for name in names]
            numeric = [variable for variable in variables if variable.kind.numeric]
            # Doubles first: what lies side by side is read straight into the vector.
            numeric.sort(key=lambda variable: variable.type not in _DOUBLES)
            start = len(index)
            index.update({Port(instance.name, one.name): start + n for n, one in enumerate(numeric)})
            outputs.append(tuple(variable.name for variable in numeric))
            spans.append(slice(start, len(index)))
            text_outputs.append(tuple(one.name for one in variables if one.carried))
        wired = _wired(system, index)
        numeric_inputs, text_inputs = _inputs(system, index, {one.connection.target: one for one in wired})
        variables = [system.variable(port) for port in index]
        nominal = [variable.nominal for variable in variables]
        smooth = [variable.kind is Kind.REAL for variable in variables]
        for one in wired:
            # Of a sum that cancels, the largest part counts.
            magnitude = max(
                abs(g) * nominal[n] for g, n in zip(one.gain.tolist(), one.source.tolist(), strict=True)
            )
            for effect, _ in one.links:
                magnitude = effect.nominal(magnitude)
            nominal.append(magnitude or 1.0)
            effects = [effect for effect, _ in one.links]
            smooth.append(
                all(effect.smooth() for effect in effects)
                and all(smooth[n] for n in one.source.tolist() if n >= len(index))
            )
        return Layout(
            size=len(index) + len(wired),
            index=index,
            outputs=tuple(outputs),
            spans=tuple(spans),
            inputs=numeric_inputs,
            text_inputs=text_inputs,
            text_outputs=tuple(text_outputs),
            recorded=np.array([index[port] for port in system.recorded], np.intp),
            wired=wired,
            owners=(*index, *(one.connection.source for one in wired)),
            nominal=np.array(nominal),
            smooth=np.array(smooth, np.bool_),
        )

    @cached_property
    def within(self) -> tuple[NDArray[np.intp], ...]:
        """Per instance, the places of its signals, and of those that connections make of them."""
        return tuple(
            np.array([*range(span.start, span.stop), *(one.place for one in wired)], np.intp)
            for span, wired in zip(self.spans, self.wired_after, strict=True)
        )

    @cached_property
    def wired_after(self) -> tuple[tuple[Wired, ...], ...]:
        """Per instance, the connections that make a signal of its own."""
        return tuple(self.wired_to(range(span.start, span.stop)) for span in self.spans)

    def wired_to(self, places: Iterable[int]) -> tuple[Wired, ...]:
        """Connections that make a signal of one at `places`."""
        if not self.wired:
            return ()
        found = {one.place: one for place in places for one in self._made_of.get(int(place), ())}
        return tuple(found[place] for place in sorted(found))

    def chain(self, connection: Connection) -> tuple[Wired, ...]:
        """Steps that compute a connection's signal: legs with their own effects first, then the sum."""
        (whole,) = (one for one in self.wired if one.connection is connection)
        return (*(one for one in self.wired if one.place in whole.source), whole)

    @cached_property
    def _made_of(self) -> Mapping[int, list[Wired]]:
        made: dict[int, list[Wired]] = {}
        behind: dict[int, set[int]] = {}
        for one in self.wired:
            places = {*one.source.tolist(), *(n for _, reads in one.links for n in reads.tolist())}
            # A sum comes after what its legs are made of, too.
            places = places.union(*(behind.get(place, ()) for place in one.source.tolist()))
            behind[one.place] = places
            for place in places:
                made.setdefault(place, []).append(one)
        return made

    def describe(self, place: int) -> str:
        """A signal's name for messages."""
        ports = len(self.owners) - len(self.wired)
        return str(self.owners[place]) if place < ports else str(self.wired[place - ports].connection)


def _wired(system: System, index: Mapping[Port, int]) -> tuple[Wired, ...]:
    made: list[Wired] = []
    for connection in system.connections:
        if connection.wire is None:
            continue
        places = []
        for leg in _wire(connection).legs:
            places.append(index[leg.port])
            if leg.links:
                own = replace(connection, source=leg.port, wire=Wire((Leg(leg.port),), leg.links))
                places[-1] = len(index) + len(made)
                made.append(_made(own, index, places[-1], [index[leg.port]]))
        made.append(_made(connection, index, len(index) + len(made), places))
    return tuple(made)


def _wire(connection: Connection) -> Wire:
    """How a connection's signal is computed; effects of a single leg without a factor act on the sum."""
    assert connection.wire is not None
    legs, links = connection.wire
    if len(legs) == 1 and (legs[0].gain, legs[0].offset) == (1.0, 0.0):
        return Wire((Leg(legs[0].port),), (*legs[0].links, *links))
    return connection.wire


def _made(connection: Connection, index: Mapping[Port, int], place: int, source: Sequence[int]) -> Wired:
    legs, links = _wire(connection)
    return Wired(
        connection=connection,
        place=place,
        source=np.array(source, np.intp),
        gain=np.array([leg.gain for leg in legs]),
        offset=np.array([leg.offset for leg in legs]),
        links=tuple((link.effect, np.array([index[port] for port in link.reads], np.intp)) for link in links),
    )


def _inputs(
    system: System, index: Mapping[Port, int], wired: Mapping[Port, Wired]
) -> tuple[tuple[Inputs, ...], tuple[tuple[tuple[str, Port], ...], ...]]:
    numeric: list[list[tuple[str, int, float, float, bool]]] = [[] for _ in system.instances]
    texts: list[list[tuple[str, Port]]] = [[] for _ in system.instances]
    for connection in system.connections:
        position = system.position[connection.target.instance]
        variable = system.variable(connection.target)
        if variable.carried:
            texts[position].append((variable.name, connection.source))
        else:
            other = variable.type not in _DOUBLES
            made = wired.get(connection.target)
            place = index[connection.source] if made is None else made.place
            feed = (variable.name, place, connection.gain, connection.offset, other)
            numeric[position].append(feed)
    inputs = []
    for feeds in numeric:
        feeds.sort(key=lambda feed: feed[4])
        plain = all(gain == 1.0 and offset == 0.0 for _, _, gain, offset, _ in feeds)
        inputs.append(
            Inputs(
                names=tuple(feed[0] for feed in feeds),
                source=np.array([feed[1] for feed in feeds], np.intp),
                gain=None if plain else np.array([feed[2] for feed in feeds]),
                offset=None if plain else np.array([feed[3] for feed in feeds]),
            )
        )
    return tuple(inputs), tuple(tuple(one) for one in texts)
