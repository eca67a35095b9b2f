"""Which forces of a component may do work along which of its velocities."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

from ...fmi import Causality, Kind
from ...system.connection import Port
from ...system.system import Instance

__all__ = ["FORCES", "Conjugate", "conjugates", "pairs"]

# Units of velocities, and of the forces that do work along them.
FORCES = {"m/s": "N", "rad/s": "N.m"}


class Conjugate(NamedTuple):
    """A velocity and a force of one component, one of them fed to it and the other given by it.

    Attributes:
        fed: whether the force is fed.
        alone: whether neither goes with another one, too, so that what they do together is work.
    """

    velocity: Port
    force: Port
    fed: bool
    alone: bool


def conjugates(instance: Instance) -> list[Conjugate]:
    """Velocities of a component with forces that may act along them, first those of forces that it is fed.

    What is fed forces and gives some is a sensor or a controller: along what it is fed these do nothing.
    """
    variables = [one for one in instance.fmu.description.variables.values() if one.kind is Kind.REAL]
    inputs, outputs = (
        [(one.name, one.unit_name) for one in variables if one.causality is causality and not one.shape]
        for causality in (Causality.INPUT, Causality.OUTPUT)
    )
    ways = [(pairs(outputs, inputs), True)]
    if not any(unit in FORCES.values() for _, unit in inputs):
        ways.append((pairs(inputs, outputs), False))
    found = []
    for among, fed in ways:
        velocities, forces = ([pair[number] for pair in among] for number in (0, 1))
        for velocity, force in among:
            alone = velocities.count(velocity) == forces.count(force) == 1
            found.append(Conjugate(Port(instance.name, velocity), Port(instance.name, force), fed, alone))
    return found


def pairs(velocities: Sequence[tuple[str, str]], forces: Sequence[tuple[str, str]]) -> list[tuple[str, str]]:
    """Velocities and the forces that may act along them, names of each.

    Elements of vectors go with those of the same index. As many forces as velocities go with them in their
    order, as a component's axes do; else each may go with each.

    Args:
        velocities, forces: names and units.
    """
    found: list[tuple[str, str]] = []
    for unit, own in FORCES.items():
        moving, pushing = _by_index(velocities, unit), _by_index(forces, own)
        for index, names in moving.items():
            others = pushing.get(index, [])
            found += zip(names, others, strict=True) if len(names) == len(others) else product(names, others)
    return found


def _by_index(variables: Sequence[tuple[str, str]], unit: str) -> dict[str, list[str]]:
    """Names of variables of a unit by what stands in their brackets; scalars by ""."""
    found: dict[str, list[str]] = {}
    for name, own in variables:
        if own == unit:
            found.setdefault(name.partition("[")[2], []).append(name)
    return found
