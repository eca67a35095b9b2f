"""Changes of the config docking-lab that represent an effect.

An effect defines them beside its law, as a function of the effect's parameters and of the rig's
numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

# Connections of the bundled system, and those that it may be given.
COMMAND = "satellite.command -> robot.command"
PLACE = "robot.position -> contact.position"
RATE = "robot.velocity -> contact.velocity"
FORCE = "contact.force -> sensor.force"
READING = "sensor.measured_force -> controller.measured_force"
BODY = "controller.force -> satellite.force"
LOAD = "contact.force -> robot.force"
TOOL = "robot.velocity -> sensor.velocity"

# Of effects that draw: any number does.
SEED = 1


@dataclass(frozen=True)
class ConfigChanges:
    """Changes of the config by an effect.

    Attributes:
        start: start values by instance.
        through: effects on connections, in their order.
        adds: connections that the system lacks.
        scaled: factors of the rig's numbers; mass is the only one.
    """

    start: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    through: Mapping[str, tuple[Mapping[str, Any], ...]] = field(default_factory=dict)
    adds: tuple[str, ...] = ()
    scaled: Mapping[str, float] = field(default_factory=dict)


# Parameters of the effect by name, and of the rig: mass [kg], tick and communication step [s].
Writes = Callable[[Mapping[str, float], Mapping[str, float]], ConfigChanges]


def with_unit(value: float, unit: str) -> str | float:
    """A quantity as configs have it: all digits, and the unit where there is one."""
    return f"{float(value)!r} {unit}" if unit != "1" else float(value)


def start(instance: str, **values: tuple[float, str]) -> ConfigChanges:
    """Start values of an instance: value and unit by name."""
    return ConfigChanges(start={instance: {name: with_unit(*one) for name, one in values.items()}})


def through(connection: str, **effect: Any) -> ConfigChanges:
    """An effect on a connection, by the keys of its entry; underscores stand for hyphens in the first."""
    (first, main), *others = effect.items()
    return ConfigChanges(through={connection: ({first.replace("_", "-"): main, **dict(others)},)})


def held(effect: str, size: float | str, rig: Mapping[str, float]) -> ConfigChanges:
    """An effect on commands that counts ticks and draws.

    A command is there from the end of its tick's first step on.
    """
    timing = {"period": with_unit(rig["tick"], "s"), "phase": with_unit(rig["step"], "s")}
    return ConfigChanges(through={COMMAND: ({effect: size, **timing, "seed": SEED},)})


def scaled(**factors: float) -> ConfigChanges:
    """Factors of the rig's numbers."""
    return ConfigChanges(scaled=factors)


def merged(parts: Sequence[ConfigChanges]) -> ConfigChanges:
    """What several effects change together; of start values that two give the later one holds."""
    start: dict[str, dict[str, Any]] = {}
    through: dict[str, tuple[Mapping[str, Any], ...]] = {}
    factors: dict[str, float] = {}
    for one in parts:
        for instance, values in one.start.items():
            start.setdefault(instance, {}).update(values)
        for connection, effects in one.through.items():
            through[connection] = through.get(connection, ()) + effects
        for name, factor in one.scaled.items():
            factors[name] = factors.get(name, 1.0) * factor
    adds = tuple(dict.fromkeys(name for one in parts for name in one.adds))
    return ConfigChanges(start, through, adds, factors)
