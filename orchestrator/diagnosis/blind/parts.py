"""Parts of random systems: Modelica text for the product, and their equations again for another solver."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

Values = Sequence[float]
Function = Callable[[Values, Values, Values], tuple[float, ...]]


@dataclass(frozen=True)
class Part:
    """A component.

    Attributes:
        name: of the model. states, inputs, outputs, parameters: names with units, in the order of vectors.
        equations: in Modelica. rate, output: derivatives and outputs of (x, u, p).
        through: whether outputs depend on inputs; if not, `output` reads states and parameters alone.
        sources, sensors: whether actuator laws or sensor laws are physical there.
    """

    name: str
    states: dict[str, str]
    inputs: dict[str, str]
    outputs: dict[str, str]
    parameters: dict[str, str]
    equations: tuple[str, ...]
    rate: Function
    output: Function
    through: bool = False
    source: bool = False
    sensor: bool = False
    starts: dict[str, float] = field(default_factory=dict)

    def modelica(self) -> str:
        """The model's text."""
        lines = [f'model {self.name} "Part of a random system"']
        lines += [
            f'  parameter Real {one}(unit="{unit}") = 1 "Number";' for one, unit in self.parameters.items()
        ]
        lines += [f'  input Real {one}(unit="{unit}", start=0) "Input";' for one, unit in self.inputs.items()]
        for one, unit in (self.outputs | self.states).items():
            kind = "output Real" if one in self.outputs else "Real"
            start = f", start={self.starts.get(one, 0.0)!r}, fixed=true" if one in self.states else ""
            lines.append(f'  {kind} {one}(unit="{unit}"{start}) "Signal";')
        return "\n".join(
            [*lines, "equation", *(f"  {one};" for one in self.equations), f"end {self.name};", ""]
        )


def _none(x: Values, u: Values, p: Values) -> tuple[float, ...]:
    return ()


def _first(x: Values, u: Values, p: Values) -> tuple[float, ...]:
    return (x[0],)


def _body(
    name: str, travel: str, rate: str, force: str, inertia: str, friction: str, words: Sequence[str]
) -> Part:
    place, speed, drive, mass = words
    return Part(
        name, {place: travel, speed: rate}, {drive: force}, {place: travel, speed: rate},
        {mass: inertia, "friction": friction},
        (f"der({place}) = {speed}", f"{mass}*der({speed}) = {drive} - friction*{speed}"),
        lambda x, u, p: (x[1], (u[0] - p[1] * x[1]) / p[0]),
        lambda x, u, p: (x[0], x[1]),
    )  # fmt: skip


def _spring(name: str, units: Sequence[str], words: Sequence[str]) -> Part:
    travel, rate, force, stiff, damp = units
    first, second, made = words
    return Part(
        name, {}, {first: travel, second: rate}, {made: force}, {"stiffness": stiff, "damping": damp},
        (f"{made} = stiffness*{first} + damping*{second}",),
        _none, lambda x, u, p: (p[0] * u[0] + p[1] * u[1],), through=True,
    )  # fmt: skip


def _gain(
    name: str, given: tuple[str, str], made: tuple[str, str], factor: tuple[str, str], **kind: bool
) -> Part:
    return Part(
        name, {}, dict([given]), dict([made]), dict([factor]), (f"{made[0]} = {factor[0]}*{given[0]}",),
        _none, lambda x, u, p: (p[0] * u[0],), through=True, **kind,
    )  # fmt: skip


def _lag(
    name: str, given: tuple[str, str], made: tuple[str, str], factor: tuple[str, str], start: float = 0.0,
    **kind: bool,
) -> Part:  # fmt: skip
    return Part(
        name, dict([made]), dict([given]), dict([made]), {factor[0]: factor[1], "time_constant": "s"},
        (f"time_constant*der({made[0]}) = {factor[0]}*{given[0]} - {made[0]}",),
        lambda x, u, p: ((p[0] * u[0] - x[0]) / p[1],), _first, starts={made[0]: start}, **kind,
    )  # fmt: skip


def _reading(name: str, signal: str, unit: str) -> Part:
    return Part(name, {}, {signal: unit}, {"reading": unit}, {}, (f"reading = {signal}",),
                _none, lambda x, u, p: (u[0],), through=True, sensor=True)  # fmt: skip


def _store(
    name: str, given: tuple[str, str], made: tuple[str, str], size: tuple[str, str], start: float
) -> Part:
    return Part(
        name, dict([made]), dict([given]), dict([made]), dict([size]),
        (f"{size[0]}*der({made[0]}) = {given[0]}",),
        lambda x, u, p: (u[0] / p[0],), _first, starts={made[0]: start},
    )  # fmt: skip


def controller(signal: str) -> Part:
    """A controller of proportional and integral action on a signal of this unit."""
    per = f"V/({signal})" if "/" in signal else f"V/{signal}"
    name = "Controller" + "".join(c for c in signal if c.isalnum())
    return Part(
        name, {"integral": "V"}, {"reference": signal, "measured": signal}, {"command": "V"},
        {"gain": per, "reset_time": "s"},
        ("reset_time*der(integral) = gain*(reference - measured)",
         "command = gain*(reference - measured) + integral"),
        lambda x, u, p: (p[0] * (u[0] - u[1]) / p[1],),
        lambda x, u, p: (p[0] * (u[0] - u[1]) + x[0],), through=True,
    )  # fmt: skip


_MADE = [
    _body("Carriage", "m", "m/s", "N", "kg", "N.s/m", ("position", "velocity", "force", "mass")),
    _body("Rotor", "rad", "rad/s", "N.m", "kg.m2", "N.m.s/rad", ("angle", "speed", "torque", "inertia")),
    _spring("Strut", ("m", "m/s", "N", "N/m", "N.s/m"), ("travel", "rate", "force")),
    _spring("Shaft", ("rad", "rad/s", "N.m", "N.m/rad", "N.m.s/rad"), ("twist", "rate", "torque")),
    _gain("LinearMotor", ("voltage", "V"), ("force", "N"), ("force_per_voltage", "N/V"), source=True),
    _lag("VoiceCoil", ("voltage", "V"), ("force", "N"), ("force_per_voltage", "N/V"), source=True),
    _gain("TorqueMotor", ("voltage", "V"), ("torque", "N.m"), ("torque_per_voltage", "N.m/V"), source=True),
    Part(
        "Winding", {"current": "A"}, {"voltage": "V", "speed": "rad/s"}, {"torque": "N.m"},
        {"resistance": "Ohm", "inductance": "H", "constant_": "N.m/A"},
        ("inductance*der(current) = voltage - resistance*current - constant_*speed",
         "torque = constant_*current"),
        lambda x, u, p: ((u[0] - p[0] * x[0] - p[2] * u[1]) / p[1],),
        lambda x, u, p: (p[2] * x[0],), source=True,
    ),
    Part(
        "Screw", {}, {"angle": "rad", "speed": "rad/s", "position": "m", "velocity": "m/s"},
        {"force": "N", "torque": "N.m"},
        {"stiffness": "N/m", "damping": "N.s/m", "lead": "m/rad"},
        ("force = stiffness*(lead*angle - position) + damping*(lead*speed - velocity)",
         "torque = lead*force"),
        _none,
        lambda x, u, p: (
            p[0] * (p[2] * u[0] - u[2]) + p[1] * (p[2] * u[1] - u[3]),
            p[2] * (p[0] * (p[2] * u[0] - u[2]) + p[1] * (p[2] * u[1] - u[3])),
        ),
        through=True,
    ),
    _reading("Scale", "position", "m"),
    _reading("Encoder", "angle", "rad"),
    _reading("Tachometer", "speed", "rad/s"),
    _reading("Gauge", "level", "m"),
    _reading("Voltmeter", "voltage", "V"),
    _lag("Thermometer", ("temperature", "K"), ("reading", "K"), ("gain", "1"), 293.0, sensor=True),
    _store("Tank", ("inflow", "m3/s"), ("level", "m"), ("area", "m2"), 1.0),
    _gain("Pipe", ("head", "m"), ("through", "m3/s"), ("conductance", "m2/s")),
    Part(
        "Outlet", {}, {"level": "m"}, {"through": "m3/s"}, {"rated": "m3/s", "height": "m"},
        ("through = rated*level/height/sqrt(abs(level)/height + 0.01)",),
        _none, lambda x, u, p: (p[0] * u[0] / p[1] / math.sqrt(abs(u[0]) / p[1] + 0.01),), through=True,
    ),
    _lag("Pump", ("command", "V"), ("through", "m3/s"), ("flow_per_voltage", "m3/(s.V)"), source=True),
    _gain("Valve", ("command", "V"), ("through", "m3/s"), ("flow_per_voltage", "m3/(s.V)"), source=True),
    _gain("GearPump", ("speed", "rad/s"), ("through", "m3/s"), ("displacement", "m3/rad")),
    _store("Solid", ("heat", "W"), ("temperature", "K"), ("capacity", "J/K"), 293.0),
    _gain("Link", ("difference", "K"), ("heat", "W"), ("conductance", "W/K")),
    Part(
        "Surface", {}, {"temperature": "K"}, {"heat": "W"}, {"conductance": "W/K", "ambient": "K"},
        ("heat = conductance*(temperature - ambient)",),
        _none, lambda x, u, p: (p[0] * (u[0] - p[1]),), through=True,
    ),
    _gain("Heater", ("command", "V"), ("heat", "W"), ("power_per_voltage", "W/V"), source=True),
    Part(
        "Wire", {}, {"drop": "V"}, {"current": "A", "heat": "W"}, {"resistance": "Ohm"},
        ("current = drop/resistance", "heat = drop*drop/resistance"),
        _none, lambda x, u, p: (u[0] / p[0], u[0] * u[0] / p[0]), through=True,
    ),
    _store("Node", ("current", "A"), ("voltage", "V"), ("capacitance", "F"), 0.0),
    Part(
        "Resistor", {}, {"drop": "V"}, {"current": "A"}, {"resistance": "Ohm"},
        ("current = drop/resistance",), _none, lambda x, u, p: (u[0] / p[0],), through=True,
    ),
    Part(
        "Choke", {"current": "A"}, {"drop": "V"}, {"current": "A"}, {"resistance": "Ohm", "inductance": "H"},
        ("inductance*der(current) = drop - resistance*current",),
        lambda x, u, p: ((u[0] - p[0] * x[0]) / p[1],), _first,
    ),
    _gain("Supply", ("command", "V"), ("voltage", "V"), ("gain", "1"), source=True),
]  # fmt: skip
PARTS = {one.name: one for one in [*_MADE, *(controller(unit) for unit in ("m", "rad", "rad/s", "K", "V"))]}
"""All parts, by name."""
