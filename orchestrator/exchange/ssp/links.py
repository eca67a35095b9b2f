"""Connections of a system as SSP has them: linear, or by a table, and what it has no word for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import islice

from ...base.units import UnitError, convert
from ...effects.gain import Gain
from ...effects.map import Map
from ...effects.offset import Offset
from ...fmi import ModelDescription, Variable
from ...simulation.run import Prepared
from ...system.connection import Connection
from ...system.connections import Ends, elements


@dataclass(frozen=True)
class Link:
    """A connection as SSP has it: target = factor * source + offset, or by a table.

    Attributes:
        source, target: the variables.
        suppress: whether factor and offset hold for the numbers as they are, units included.
        table: of whole numbers; None: it is linear.
    """

    connection: Connection
    source: Variable
    target: Variable
    factor: float
    offset: float
    suppress: bool
    table: list[tuple[float, float]] | None


def links_of(
    prepared: Prepared, descriptions: Mapping[str, ModelDescription]
) -> tuple[list[list[Link]], list[str]]:
    """What the file says of each connection of the config.

    Args:
        descriptions: of each instance's FMU.
    Returns: the links, by connection of the config, and what SSP has no word for.
    """
    lost: list[str] = []
    made = iter(prepared.system.connections)
    found = []
    for index, entry in enumerate(prepared.config.model.connections):
        ends, _, _ = elements(Ends.of(index, entry), descriptions, prepared.config.places)
        links = [
            link
            for one in islice(made, len(ends))
            if (link := _judged(index, one, descriptions, lost)) is not None
        ]
        found.append(links)
    return found, lost


def _judged(
    index: int, connection: Connection, descriptions: Mapping[str, ModelDescription], lost: list[str]
) -> Link | None:
    """A connection as SSP has it; what it cannot say is reported in `lost`."""
    factor, offset, table = 1.0, 0.0, None
    wire = connection.wire
    if wire is not None and len(wire.legs) > 1:
        note = f"connections[{index}]: SSP has no sums: {connection.target} is fed by nothing in other tools"
        lost.append(note)
        return None
    if wire is not None:
        factor, offset = wire.legs[0].gain, wire.legs[0].offset
        dropped = []
        for link in wire.links:
            effect = link.effect
            if isinstance(effect, Gain):
                factor, offset = factor * effect.factor, offset * effect.factor
            elif isinstance(effect, Offset):
                offset += effect.value
            elif isinstance(effect, Map) and table is None:
                table = effect.pairs()
            else:
                dropped.append(link.name)
        if dropped:
            note = f"connections[{index}]: other tools carry the value without {', '.join(dropped)}"
            if note not in lost:
                lost.append(note)
    factor, offset = connection.gain * factor, connection.gain * offset + connection.offset
    one, other = (
        descriptions[port.instance].variables[port.variable]
        for port in (connection.source, connection.target)
    )
    suppress = False
    if one.unit is not None and other.unit is not None:
        try:
            suppress = convert(one.unit, other.unit) != (1.0, 0.0)
        except UnitError:  # effects change the dimension, or what has an origin into a difference
            suppress = True
    return Link(connection, one, other, factor, offset, suppress, table)
