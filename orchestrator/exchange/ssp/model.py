"""What system structure descriptions, parameter sets and mappings hold, as plain objects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ...base.units import Unit


@dataclass(frozen=True)
class Reference:
    """Where something else is found: source as written, base ("SSD" or "component"), MIME type."""

    source: str
    base: str = "SSD"
    type: str = ""


@dataclass(frozen=True)
class Transformation:
    """Of values: linear by factor and offset, or by a table of texts."""

    kind: str
    factor: float = 1.0
    offset: float = 0.0
    entries: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Connector:
    """Of an element. `dimensions`: whether it is an array."""

    name: str
    kind: str
    type: str
    unit_name: str
    unit: Unit | None
    dimensions: bool
    place: str


@dataclass(frozen=True)
class End:
    """One end of a connection; element None: of the system itself; indices such as "[1,2]"."""

    element: str | None
    connector: str
    indices: str = ""

    def __str__(self) -> str:
        return f"{self.element}.{self.connector}{self.indices}" if self.element else self.connector


@dataclass(frozen=True)
class Connection:
    """Between two connectors; which of them is the source follows from their kinds."""

    start: End
    end: End
    suppress: bool
    transformation: Transformation | None
    place: str


@dataclass(frozen=True)
class Parameter:
    """A value for a variable: texts of its elements, one if it is a scalar."""

    name: str
    type: str
    values: tuple[str, ...]
    unit_name: str
    unit: Unit | None
    place: str


@dataclass(frozen=True)
class MappingEntry:
    """From a parameter's name in its source to that in the system."""

    source: str
    target: str
    suppress: bool
    transformation: Transformation | None


@dataclass(frozen=True)
class Binding:
    """Parameters for an element: inline, or by reference; mapped, or by their own names (None)."""

    values: tuple[Parameter, ...] | Reference
    mapping: tuple[MappingEntry, ...] | Reference | None
    prefix: str
    place: str


@dataclass(frozen=True)
class Dictionary:
    """A signal dictionary: type and unit of each entry, by name."""

    name: str
    entries: Mapping[str, Connector] | Reference
    place: str


@dataclass(frozen=True)
class Element:
    """A component, a system, or a reference to a signal dictionary.

    Attributes:
        what: "component", "system" or "dictionary".
        reference, implementation: of a component; reference None: it has no source.
        dictionary: name of the dictionary referred to.
    """

    what: str
    name: str
    identity: str
    description: str
    connectors: Mapping[str, Connector]
    bindings: tuple[Binding, ...]
    place: str
    elements: tuple[Element, ...] = ()
    connections: tuple[Connection, ...] = ()
    dictionaries: tuple[Dictionary, ...] = ()
    reference: Reference | None = None
    implementation: str = "any"
    dictionary: str = ""


@dataclass(frozen=True)
class Document:
    """A system structure description.

    Attributes:
        units, enumerations: by name; what an enumeration's items stand for, by item.
        start, stop: of the default experiment [s], as written; None where not given.
        annotations: at the top and at the default experiment, type and element (lxml).
    """

    name: str
    version: str
    system: Element
    units: Mapping[str, Unit]
    enumerations: Mapping[str, Mapping[str, int]]
    start: str | None
    stop: str | None
    annotations: tuple[tuple[str, Any], ...]
