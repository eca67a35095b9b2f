"""Random systems of parts: chains, trees and loops of one domain or two."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .parts import PARTS, Part

Random = np.random.Generator
Leg = tuple[str, str, float]
_MOST, _LEAST = 8, 2


@dataclass
class Drawing:
    """A system of parts.

    Attributes:
        domain: what it is of. parts: by instance. numbers: parameters of each instance.
        wires: legs (instance, output, gain) of each input "instance.input".
        starts: of states that do not begin as their part says, by "instance.state".
        driven: external inputs with the mean and the amplitude of what drives them.
        compared: outputs that are logged. interval: of samples [s]. known: parameters that are exact.
    """

    domain: str
    parts: dict[str, Part] = field(default_factory=dict)
    numbers: dict[str, list[float]] = field(default_factory=dict)
    wires: dict[str, list[Leg]] = field(default_factory=dict)
    starts: dict[str, float] = field(default_factory=dict)
    driven: dict[str, tuple[float, float]] = field(default_factory=dict)
    compared: list[str] = field(default_factory=list)
    interval: float = 1.0
    known: set[str] = field(default_factory=set)

    def add(self, name: str, part: str, *numbers: float, **legs: Leg | list[Leg]) -> str:
        """Add an instance; rounds its numbers to four digits, as a data sheet does."""
        count = sum(one.rstrip("0123456789") == name for one in self.parts)
        label = f"{name}{count + 1}" if count else name
        self.parts[label] = PARTS[part]
        self.numbers[label] = [float(f"{one:.4g}") for one in numbers]
        for given, leg in legs.items():
            self.wire(f"{label}.{given}", *(leg if isinstance(leg, list) else [leg]))
        return label

    def wire(self, target: str, *legs: Leg) -> None:
        """Add legs to an input."""
        self.wires.setdefault(target, []).extend(legs)


def _log(random: Random, low: float, high: float) -> float:
    return float(np.exp(random.uniform(math.log(low), math.log(high))))


def _bodies(made: Drawing, random: Random, rotary: bool, room: int) -> tuple[list[str], float, float]:
    """Bodies in a chain or a tree of springs. Returns: them, their size of force, and a frequency [rad/s]."""
    body, spring = ("Rotor", "Shaft") if rotary else ("Carriage", "Strut")
    name, link = ("rotor", "shaft") if rotary else ("carriage", "strut")
    place, speed, force = ("angle", "speed", "torque") if rotary else ("position", "velocity", "force")
    travel = "twist" if rotary else "travel"
    size = _log(random, 1e-3, 0.1) if rotary else _log(random, 0.5, 50.0)
    omega = 2.0 * math.pi * _log(random, 0.7, 6.0)
    bodies: list[str] = []
    count = int(random.integers(1, max(2, (room + 1) // 2 + 1)))
    grounded = not rotary or random.random() < 0.3
    for k in range(count):
        mass = size * _log(random, 0.5, 2.0)
        friction = mass * omega * random.uniform(0.02, 0.1) * (1.0 if grounded else 3.0)
        own = made.add(name, body, mass, friction)
        if bodies:
            other = str(random.choice(bodies))
            made.add(
                link, spring, mass * omega**2 * _log(random, 0.5, 2.0),
                mass * omega * random.uniform(0.02, 0.1),
                **{travel: [(other, place, 1.0), (own, place, -1.0)],
                   "rate": [(other, speed, 1.0), (own, speed, -1.0)]},
            )  # fmt: skip
            made_link = list(made.parts)[-1]
            made.wire(f"{other}.{force}", (made_link, force, -1.0))
            made.wire(f"{own}.{force}", (made_link, force, 1.0))
        bodies.append(own)
        if grounded and k == 0:
            base = made.add(
                link, spring, mass * omega**2 * _log(random, 0.5, 2.0),
                mass * omega * random.uniform(0.03, 0.15),
                **{travel: (own, place, 1.0), "rate": (own, speed, 1.0)},
            )  # fmt: skip
            made.wire(f"{own}.{force}", (base, force, -1.0))
    motion = _log(random, 0.3, 4.0) if rotary else _log(random, 2e-3, 0.05)
    return bodies, size * omega**2 * motion * (0.5 if grounded else 1.0), omega


def _translational(made: Drawing, random: Random, room: int) -> None:
    bodies, force, omega = _bodies(made, random, False, room - 1)
    made.interval = 0.13 / omega
    if random.random() < 0.5:
        motor = made.add("motor", "LinearMotor", force / 5.0)
    else:
        motor = made.add("motor", "VoiceCoil", force / 5.0, made.interval * _log(random, 1.0, 6.0))
    made.wire(f"{bodies[0]}.force", (motor, "force", 1.0))
    made.driven[f"{motor}.voltage"] = 0.0, 5.0
    _measured(made, random, bodies, "position", "scale", "Scale", room)


def _rotational(made: Drawing, random: Random, room: int) -> None:
    bodies, torque, omega = _bodies(made, random, True, room - 1)
    made.interval = 0.13 / omega
    _motor(made, random, bodies[0], torque, made.interval)
    if random.random() < 0.5:
        _measured(made, random, bodies, "angle", "encoder", "Encoder", room)
    else:
        _measured(made, random, bodies, "speed", "tacho", "Tachometer", room)
    _closed(made, random, room, 0.4)


def _motor(made: Drawing, random: Random, rotor: str, torque: float, interval: float) -> None:
    if random.random() < 0.5:
        motor = made.add("motor", "TorqueMotor", torque / 10.0)
    else:
        constant, resistance = _log(random, 0.02, 0.2), 0.0
        resistance = 10.0 * constant / torque
        motor = made.add(
            "motor", "Winding", resistance, resistance * interval * _log(random, 2.0, 8.0), constant,
            speed=(rotor, "speed", 1.0),
        )  # fmt: skip
    made.wire(f"{rotor}.torque", (motor, "torque", 1.0))
    made.driven[f"{motor}.voltage"] = 0.0, 10.0


def _measured(
    made: Drawing, random: Random, bodies: list[str], port: str, name: str, part: str, room: int,
    *numbers: float,
) -> None:  # fmt: skip
    """Log one or two stores, through a sensor where there is room for it."""
    most = min(len(bodies), 2)
    chosen = [str(one) for one in random.permutation(bodies)[: int(random.integers(1, most + 1))]]
    for one in sorted(chosen):
        if len(made.parts) < room and (random.random() < 0.6 or numbers):
            (given,) = PARTS[part].inputs
            made.compared.append(made.add(name, part, *numbers, **{given: (one, port, 1.0)}) + ".reading")
        else:
            made.compared.append(f"{one}.{port}")


def _closed(made: Drawing, random: Random, room: int, chance: float) -> None:
    """Close a loop by a controller from a logged signal to the external input."""
    if len(made.parts) >= room or random.random() > chance:
        return
    (command, (mean, size)), = made.driven.items()  # fmt: skip
    instance, port = made.compared[0].split(".")
    unit = made.parts[instance].outputs[port]
    spread = {"K": 20.0, "m": 0.4, "V": 3.0, "rad": 1.0, "rad/s": 4.0}[unit]
    gain = 0.7 * size / spread
    label = made.add("controller", "Controller" + "".join(c for c in unit if c.isalnum()), gain,
                     made.interval * _log(random, 60.0, 200.0), measured=(instance, port, 1.0))  # fmt: skip
    made.wires[command] = [(label, "command", 1.0)]
    centre = {"K": 315.0, "m": 1.0}.get(unit, 0.0)
    made.driven = {f"{label}.reference": (centre, 0.6 * spread)}
    if mean:
        made.starts[f"{label}.integral"] = mean


def _tanks(made: Drawing, random: Random, room: int, pump: bool = True) -> tuple[str, float]:
    """Tanks with pipes in a chain or a tree. Returns: the first one, and the flow at rest."""
    area, tau = _log(random, 0.05, 1.0), _log(random, 20.0, 200.0)
    made.interval = tau / 15.0
    tanks: list[str] = []
    count = int(random.integers(1, max(2, (room - 1) // 2 + 1)))
    for _ in range(count):
        own = made.add("tank", "Tank", area * _log(random, 0.6, 1.6))
        if tanks:
            other = str(random.choice(tanks))
            pipe = made.add("pipe", "Pipe", area / tau * _log(random, 2.0, 6.0),
                            head=[(other, "level", 1.0), (own, "level", -1.0)])  # fmt: skip
            made.wire(f"{other}.inflow", (pipe, "through", -1.0))
            made.wire(f"{own}.inflow", (pipe, "through", 1.0))
        tanks.append(own)
    flow = area / tau
    outlet = made.add("outlet", "Outlet", flow, 1.0, level=(tanks[-1], "level", 1.0))
    made.known.add(f"{outlet}.height")
    made.wire(f"{tanks[-1]}.inflow", (outlet, "through", -1.0))
    for one in tanks:
        made.starts[f"{one}.level"] = 1.0
    if pump:
        if random.random() < 0.5:
            source = made.add("pump", "Pump", flow / 5.0, made.interval * _log(random, 1.0, 5.0))
            made.starts[f"{source}.through"] = made.numbers[source][0] * 5.0
        else:
            source = made.add("valve", "Valve", flow / 5.0)
        made.wire(f"{tanks[0]}.inflow", (source, "through", 1.0))
        made.driven[f"{source}.command"] = 5.0, 3.5
    _measured(made, random, tanks, "level", "gauge", "Gauge", room)
    return tanks[0], flow


def _hydraulic(made: Drawing, random: Random, room: int) -> None:
    _tanks(made, random, room)
    _closed(made, random, room, 0.3)


def _solids(made: Drawing, random: Random, room: int) -> tuple[str, float]:
    """Solids with links in a chain or a tree. Returns: the heated one, and the heat that warms it by 30 K."""
    capacity, tau = _log(random, 100.0, 2e4), _log(random, 50.0, 1000.0)
    made.interval = tau / 15.0
    solids: list[str] = []
    count = int(random.integers(1, max(2, (room - 1) // 2 + 1)))
    for _ in range(count):
        own = made.add("solid", "Solid", capacity * _log(random, 0.5, 2.0))
        if solids:
            other = str(random.choice(solids))
            link = made.add("link", "Link", capacity / tau * _log(random, 1.5, 5.0),
                            difference=[(other, "temperature", 1.0), (own, "temperature", -1.0)])  # fmt: skip
            made.wire(f"{other}.heat", (link, "heat", -1.0))
            made.wire(f"{own}.heat", (link, "heat", 1.0))
        solids.append(own)
        made.starts[f"{own}.temperature"] = 315.0
    surface = made.add(
        "surface", "Surface", capacity / tau, 293.0, temperature=(solids[-1], "temperature", 1.0)
    )
    made.known.add(f"{surface}.ambient")
    made.wire(f"{solids[-1]}.heat", (surface, "heat", -1.0))
    _measured(made, random, solids, "temperature", "probe", "Thermometer", room,
              1.0, made.interval * _log(random, 1.0, 4.0))  # fmt: skip
    for one in made.parts:
        if one.startswith("probe"):
            made.starts[f"{one}.reading"] = 315.0
            made.known.add(f"{one}.gain")
    return solids[0], capacity / tau * 22.0


def _thermal(made: Drawing, random: Random, room: int) -> None:
    first, heat = _solids(made, random, room - 1)
    heater = made.add("heater", "Heater", heat / 5.0)
    made.wire(f"{first}.heat", (heater, "heat", 1.0))
    made.driven[f"{heater}.command"] = 5.0, 3.5
    _closed(made, random, room, 0.4)


def _ladder(made: Drawing, random: Random, room: int) -> None:
    """Capacitors with resistors or chokes."""
    capacitance, tau = _log(random, 1e-5, 1e-3), _log(random, 5e-3, 0.2)
    made.interval = tau / 15.0
    supply = made.add("supply", "Supply", 1.0)
    made.known.add(f"{supply}.gain")
    made.driven[f"{supply}.command"] = 0.0, 10.0
    nodes: list[str] = []
    for k in range(int(random.integers(1, max(2, (room - 1) // 2 + 1)))):
        own = made.add("node", "Node", capacitance * _log(random, 0.5, 2.0))
        other = (supply if k == 0 else str(random.choice(nodes)), "voltage", 1.0)
        resistance = tau / capacitance * _log(random, 0.2, 0.7)
        if random.random() < 0.65:
            link = made.add("resistor", "Resistor", resistance, drop=[other, (own, "voltage", -1.0)])
        else:
            inductance = resistance * made.interval * _log(random, 2.0, 10.0)
            link = made.add("choke", "Choke", resistance, inductance, drop=[other, (own, "voltage", -1.0)])
        if k:
            made.wire(f"{other[0]}.current", (link, "current", -1.0))
        made.wire(f"{own}.current", (link, "current", 1.0))
        nodes.append(own)
    if len(made.parts) < room:
        load = made.add(
            "load", "Resistor", tau / capacitance * _log(random, 2.0, 8.0), drop=(nodes[-1], "voltage", 1.0)
        )
        made.wire(f"{nodes[-1]}.current", (load, "current", -1.0))
    _measured(made, random, nodes, "voltage", "voltmeter", "Voltmeter", room)


def _screw_drive(made: Drawing, random: Random, room: int) -> None:
    """A motor that moves a carriage by a screw."""
    bodies, force, omega = _bodies(made, random, False, min(room - 3, 3))
    made.interval = 0.13 / omega
    first, lead = bodies[0], _log(random, 2e-3, 2e-2)
    mass = made.numbers[first][0]
    inertia = mass * lead**2 * _log(random, 0.5, 3.0)
    rotor = made.add("rotor", "Rotor", inertia, inertia * omega * random.uniform(0.2, 0.6))
    screw = made.add(
        "screw", "Screw", mass * omega**2 * _log(random, 2.0, 8.0),
        mass * omega * random.uniform(0.1, 0.3), lead,
        angle=(rotor, "angle", 1.0), speed=(rotor, "speed", 1.0),
        position=(first, "position", 1.0), velocity=(first, "velocity", 1.0),
    )  # fmt: skip
    made.known.add(f"{screw}.lead")
    made.wire(f"{first}.force", (screw, "force", 1.0))
    made.wire(f"{rotor}.torque", (screw, "torque", -1.0))
    _motor(made, random, rotor, 1.5 * force * lead, made.interval)
    if len(made.parts) < room and random.random() < 0.5:
        encoder = made.add("encoder", "Encoder", angle=(rotor, "angle", 1.0))
        made.compared.append(f"{encoder}.reading")
    else:
        made.compared.append(f"{rotor}.angle")
    if random.random() < 0.6:
        made.compared.append(f"{first}.position")


def _pump_drive(made: Drawing, random: Random, room: int) -> None:
    """A motor that fills tanks by a gear pump."""
    first, flow = _tanks(made, random, room - 3, pump=False)
    speed = _log(random, 50.0, 200.0)
    inertia = _log(random, 1e-3, 1e-2)
    friction = inertia / (made.interval * _log(random, 2.0, 8.0))
    rotor = made.add("rotor", "Rotor", inertia, friction)
    pump = made.add("pump", "GearPump", flow / speed, speed=(rotor, "speed", 1.0))
    made.wire(f"{first}.inflow", (pump, "through", 1.0))
    motor = made.add("motor", "TorqueMotor", friction * speed / 5.0)
    made.wire(f"{rotor}.torque", (motor, "torque", 1.0))
    made.driven[f"{motor}.voltage"] = 5.0, 3.5
    made.starts[f"{rotor}.speed"] = speed
    if random.random() < 0.5:
        made.compared.append(f"{rotor}.speed")


def _wire_heater(made: Drawing, random: Random, room: int) -> None:
    """A heating wire on a circuit that warms solids."""
    first, heat = _solids(made, random, room - 2)
    wire = made.add("wire", "Wire", 36.0 / heat)
    supply = made.add("supply", "Supply", 1.0)
    made.known.add(f"{supply}.gain")
    made.wire(f"{wire}.drop", (supply, "voltage", 1.0))
    made.wire(f"{first}.heat", (wire, "heat", 1.0))
    made.driven[f"{supply}.command"] = 5.5, 3.0
    if random.random() < 0.3:
        made.compared.append(f"{wire}.current")


_DOMAINS: dict[str, Callable[[Drawing, Random, int], Any]] = {
    "translational": _translational, "rotational": _rotational, "hydraulic": _hydraulic,
    "thermal": _thermal, "electrical": _ladder, "screw drive": _screw_drive, "pump drive": _pump_drive,
    "heating wire": _wire_heater,
}  # fmt: skip


def draw(random: Random) -> Drawing:
    """A system of 2 to 8 parts."""
    while True:
        domain = str(random.choice(list(_DOMAINS)))
        made = Drawing(domain)
        _DOMAINS[domain](made, random, int(random.integers(4, _MOST + 1)))
        if _LEAST <= len(made.parts) <= _MOST:
            made.interval = float(f"{made.interval:.2g}")
            return made
