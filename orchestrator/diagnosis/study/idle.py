"""Instances whose signals nobody looks at in a replay: logs take the place of all that they give."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import replace
from fractions import Fraction

from ...master import MasterAlgorithm
from ...system.connection import Connection, Port
from ...system.system import System

# Communication steps that an idle instance's own step would take: more than any run has.
_NEVER = Fraction(1 << 40)


def without_idle(
    system: System,
    master: MasterAlgorithm,
    seen: Iterable[Port],
    replaced: Collection[Port],
    unread: Collection[Port],
) -> System:
    """The system whose idle instances do not step.

    They stay where they are in the order of steps, which decides what others are fed: all else is the same to
    the bit. A path whose positions are fed from a log costs as much as what it drives.

    Args:
        seen: outputs, and inputs, whose own signals are given, or read by effects that are inserted.
        replaced: outputs for which all connections take a log, and inputs that do.
        unread: of these outputs, those for which effects that read them see the log, too.
    """
    feeds: dict[str, list[Connection]] = {}
    for one in system.connections:
        if one.target not in replaced:
            feeds.setdefault(one.target.instance, []).append(one)
    by_target = {one.target: one for one in system.connections}
    asked: list[str] = []
    for port in seen:
        # What is made of an input's sources is seen there, be it fed itself or not.
        asked += [one.instance for one in by_target[port].sources] if port in by_target else [port.instance]
    needed: set[str] = set()
    while asked:
        name = asked.pop()
        if name in needed:
            continue
        needed.add(name)
        for one in feeds.get(name, ()):
            asked += [port.instance for port in _looked_at(one, replaced, unread)]
    slowed = replace(
        system,
        instances=tuple(
            one if one.name in needed or one.ratio > 1 else replace(one, ratio=_NEVER)
            for one in system.instances
        ),
    )
    # Masters that know no instances with longer steps of their own step all of them.
    return system if master.check(slowed) else slowed


def _looked_at(one: Connection, replaced: Collection[Port], unread: Collection[Port]) -> list[Port]:
    """Outputs whose own signals a connection passes on, or its effects read."""
    if one.wire is None:
        return [port for port in (one.source,) if port not in replaced]
    legs = [leg.port for leg in one.wire.legs if leg.port not in replaced]
    reads = [port for link in one.wire.every_link for port in link.reads if port not in unread]
    return [*legs, *reads]
