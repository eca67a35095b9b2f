"""A port, a connection, and the effects that stand on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from ..effects import Effect


class Port(NamedTuple):
    """A variable of an instance."""

    instance: str
    variable: str

    @staticmethod
    def of(text: str) -> Port:
        """The port that a text names, as `str` writes it; without a dot, one of no variable."""
        instance, _, variable = text.partition(".")
        return Port(instance, variable)

    def __str__(self) -> str:
        return f"{self.instance}.{self.variable}"


class Leg(NamedTuple):
    """One of the sources of a connection that sums several: it gives gain * value + offset.

    Attributes:
        links: effects that the value goes through before.
    """

    port: Port
    gain: float = 1.0
    offset: float = 0.0
    links: tuple[Link, ...] = ()


class Link(NamedTuple):
    """An effect on a connection.

    Attributes:
        effect: with its options.
        name: as the config has it.
        reads: the outputs that it reads beside the connection's own.
        at_once: whether its value at a communication point depends on the signal's at the same point.
    """

    effect: Effect
    name: str
    reads: tuple[Port, ...] = ()
    at_once: bool = True


class Wire(NamedTuple):
    """What makes one signal of a connection's sources: their sum, through its effects in turn."""

    legs: tuple[Leg, ...]
    links: tuple[Link, ...] = ()

    @property
    def every_link(self) -> tuple[Link, ...]:
        """Effects of the legs, then of their sum."""
        return (*(link for leg in self.legs for link in leg.links), *self.links)


@dataclass(frozen=True)
class Connection:
    """A checked connection: value at the target = gain * signal + offset (unit conversion).

    Attributes:
        source: where the signal comes from; of several sources the first.
        target: the input.
        wire: what makes the signal; None where it is the value at the source.
    """

    source: Port
    target: Port
    gain: float = 1.0
    offset: float = 0.0
    wire: Wire | None = None

    @cached_property
    def sources(self) -> tuple[Port, ...]:
        """All outputs that the signal is made from."""
        if self.wire is None:
            return (self.source,)
        ports = [leg.port for leg in self.wire.legs]
        return tuple(dict.fromkeys([*ports, *(port for link in self.wire.every_link for port in link.reads)]))

    @cached_property
    def passed_at_once(self) -> tuple[Port, ...]:
        """Sources with direct feedthrough: the signal at a point depends on their value at the same point."""
        if self.wire is None:
            return (self.source,)
        ports, whole = _read_at_once(self.wire.links)
        if whole:
            for leg in self.wire.legs:
                reads, passes = _read_at_once(leg.links)
                ports += [*reads, leg.port] if passes else reads
        return tuple(dict.fromkeys(ports))

    def __str__(self) -> str:
        if self.wire is None:
            return f"{self.source} -> {self.target}"
        through = "".join(f" -> {link.name}" for link in self.wire.links)
        return f"{' + '.join(str(leg.port) for leg in self.wire.legs)}{through} -> {self.target}"


def _read_at_once(links: Sequence[Link]) -> tuple[list[Port], bool]:
    """What effects read whose value depends on it at the same point, and whether it does on their signal."""
    ports: list[Port] = []
    for link in reversed(links):
        if not link.at_once:
            return ports, False
        ports += link.reads
    return ports, True
