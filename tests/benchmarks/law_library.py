"""Whether the search by unknown inputs finds each law of the library in small systems.

    python tests/benchmarks/law_library.py [NAME...]

A system's truth has a law hidden in it. It is solved here by fixed steps, twenty a sample, with laws that are
written anew: play and slip as conditions, friction with its sign. NAME picks cases.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import copysign, cos, exp, floor, sin, tanh
from pathlib import Path
from typing import Any

import numpy as np

from orchestrator.diagnosis.study.reader import load_port_study
from orchestrator.diagnosis.unknown_input.answer import Answer
from orchestrator.diagnosis.unknown_input.inquiry import answer

__all__ = ["CASES", "Case", "built", "logged", "right"]

_FINE = 20


class Hidden:
    """What is hidden: `at` a point of a system, the value there becomes `value(t, value, signals)`.

    Args:
        rates: derivatives of `z`, with the same arguments. after: changes `z` after each small step.
    """

    def __init__(
        self, at: str, value: Callable[..., float], z: Sequence[float] = (),
        rates: Callable[..., Sequence[float]] | None = None, after: Callable[..., None] | None = None,
    ) -> None:  # fmt: skip
        self.at, self.value, self.first, self.rates, self.after = at, value, list(z), rates, after
        self.z = list(z)


@dataclass(frozen=True)
class System:
    """A small system: Modelica models, its config and study, and its truth.

    Attributes:
        truth: (t, x, u, put) -> derivatives and logged outputs; put(point, value, **signals) passes a point.
        driven: makes the input of a run from a random generator and times.
    """

    models: dict[str, str]
    config: str
    study: str
    start: tuple[float, ...]
    truth: Callable[..., tuple[list[float], list[float]]]
    driven: Callable[..., np.ndarray]
    header: str
    noise: tuple[float, ...]
    interval: float = 0.01
    count: int = 400


def _tones(size: float, slow: float = 0.5, fast: float = 8.0) -> Callable[..., np.ndarray]:
    def made(random: Any, time: np.ndarray) -> np.ndarray:
        tones, phases = random.uniform(slow, fast, 6), random.uniform(0.0, 6.3, 6)
        # From rest, so that lags and plays begin where the search lets them begin.
        return size * (1.0 - np.exp(-5.0 * time)) * np.sin(np.outer(time, tones) + phases).sum(axis=1) / 3.0

    return made


def _levels(low: float, high: float, each: int) -> Callable[..., np.ndarray]:
    def made(random: Any, time: np.ndarray) -> np.ndarray:
        return np.repeat(random.uniform(low, high, len(time) // each + 1), each)[: len(time)]

    return made


def _oscillator(t, x, u, put):
    position, speed = x
    signals = {"x": position, "v": speed}
    spring = put("spring", -80.0 * position - 2.0 * speed, **signals)
    force = put("force", u, **signals)
    return [speed, put("total", force + spring, **signals) / 2.0], [put("sensor", position, **signals)]


OSCILLATOR = System(
    {
        "Mass": """model Mass "Mass on a spring"
  parameter Real mass(unit="kg", min=0) = 2 "Mass";
  input Real force(unit="N", start=0) "Of the actuator";
  input Real spring(unit="N", start=0) "Of the spring";
  output Real position(unit="m", start=0, fixed=true) "Position";
  output Real velocity(unit="m/s", start=0, fixed=true) "Velocity";
equation
  der(position) = velocity;
  mass*der(velocity) = force + spring;
end Mass;
""",
        "Spring": """model Spring "Spring and damper"
  parameter Real stiffness(unit="N/m", min=0) = 80 "Stiffness";
  parameter Real damping(unit="N.s/m", min=0) = 2 "Damping";
  input Real travel(unit="m", start=0) "Travel";
  input Real rate(unit="m/s", start=0) "Its rate";
  output Real force(unit="N") "Against the travel";
equation
  force = -stiffness*travel - damping*rate;
end Spring;
""",
    },
    """title: Oscillator
run: {master: gauss-seidel, step_size: 5 ms, stop_time: 2 s}
instances:
  mass: {fmu: Mass.fmu}
  spring: {fmu: Spring.fmu}
connections:
  - mass.position -> spring.travel
  - mass.velocity -> spring.rate
  - spring.force -> mass.spring
""",
    """format: port-study/1
system: system.yaml
interval: 10 ms
columns:
  time: {column: time, unit: s}
  mass.force: {column: f, unit: N}
  mass.position: {column: x, unit: m, noise: 0.1 mm}
calibrated:
  spring.stiffness: {tolerance: 1 N/m}
  spring.damping: {tolerance: 0.05 N.s/m}
""",
    (0.0, 0.0),
    _oscillator,
    _tones(6.0),
    "time [s],f [N],x [m]",
    (1e-4,),
)


def _servo(t, x, u, put):
    current, angle, speed = x
    s = {"angle": angle, "speed": speed, "current": current}
    voltage = put("voltage", 4.0 * put("command", u, **s), **s)
    torque = put("torque", 0.05 * put("current", current, **s), **s)
    rates = [(put("drop", voltage - 0.05 * speed, **s) - 1.0 * current) / 0.02, speed,
             (torque - 2e-3 * speed) / 1e-3]  # fmt: skip
    return rates, [put("encoder", angle, **s), put("meter", current, **s)]


SERVO = System(
    {
        "Amplifier": """model Amplifier "Of the motor"
  parameter Real gain(unit="1", min=0) = 4 "Gain";
  input Real command(unit="V", start=0) "Command";
  output Real voltage(unit="V") "Voltage";
equation
  voltage = gain*command;
end Amplifier;
""",
        "Winding": """model Winding "Of the motor"
  parameter Real resistance(unit="Ohm", min=0) = 1 "Resistance";
  parameter Real inductance(unit="H", min=0) = 0.02 "Inductance";
  parameter Real constant_(unit="N.m/A", min=0) = 0.05 "Of the motor";
  parameter Real induced(unit="V.s/rad", min=0) = 0.05 "Of the motor";
  input Real voltage(unit="V", start=0) "Voltage";
  input Real speed(unit="rad/s", start=0) "Speed";
  output Real current(unit="A", start=0, fixed=true) "Current";
  output Real torque(unit="N.m") "Torque";
equation
  inductance*der(current) = voltage - induced*speed - resistance*current;
  torque = constant_*current;
end Winding;
""",
        "Rotor": """model Rotor "With a load"
  parameter Real inertia(unit="kg.m2", min=0) = 1e-3 "Inertia";
  parameter Real friction(unit="N.m.s/rad", min=0) = 2e-3 "Friction";
  input Real torque(unit="N.m", start=0) "Torque";
  output Real angle(unit="rad", start=0, fixed=true) "Angle";
  output Real speed(unit="rad/s", start=0, fixed=true) "Speed";
equation
  der(angle) = speed;
  inertia*der(speed) = torque - friction*speed;
end Rotor;
""",
        "Encoder": """model Encoder "Of the angle"
  parameter Real gain(unit="1", min=0) = 1 "Gain";
  input Real angle(unit="rad", start=0) "Angle";
  output Real shown(unit="rad") "What it shows";
equation
  shown = gain*angle;
end Encoder;
""",
    },
    """title: Servo
run: {master: gauss-seidel, step_size: 5 ms, stop_time: 2 s}
instances:
  amplifier: {fmu: Amplifier.fmu}
  winding: {fmu: Winding.fmu}
  rotor: {fmu: Rotor.fmu}
  encoder: {fmu: Encoder.fmu}
connections:
  - amplifier.voltage -> winding.voltage
  - rotor.speed -> winding.speed
  - winding.torque -> rotor.torque
  - rotor.angle -> encoder.angle
""",
    """format: port-study/1
system: system.yaml
interval: 10 ms
columns:
  time: {column: time, unit: s}
  amplifier.command: {column: u, unit: V}
  encoder.shown: {column: a, unit: rad, noise: 1 mrad}
  winding.current: {column: i, unit: A, noise: 5 mA, feed: false}
calibrated:
  rotor.inertia: {tolerance: 2e-5 kg.m2}
  rotor.friction: {tolerance: 1e-4 N.m.s/rad}
""",
    (0.0, 0.0, 0.0),
    _servo,
    _tones(1.5, 0.5, 12.0),
    "time [s],u [V],a [rad],i [A]",
    (1e-3, 5e-3),
)


def _vessel(t, x, u, put):
    (temperature,) = x
    s = {"temperature": temperature}
    power = put("power", 1000.0 * put("command", u, **s), **s)
    heat = put("heat", power - 8.0 * (temperature - 293.15), **s)
    return [heat / 2000.0], [put("sensor", temperature, **s)]


VESSEL = System(
    {
        "Element": """model Element "Heating element"
  parameter Real gain(unit="W", min=0) = 1000 "Largest power";
  input Real command(unit="1", start=0) "Share";
  input Real temperature(unit="K", start=293.15) "Around it";
  output Real power(unit="W") "Power";
equation
  power = gain*command;
end Element;
""",
        "Vessel": """model Vessel "Heated vessel"
  parameter Real capacity(unit="J/K", min=0) = 2000 "Heat capacity";
  parameter Real loss(unit="W/K", min=0) = 8 "To the surroundings";
  input Real power(unit="W", start=0) "Heat";
  output Real temperature(unit="K", start=293.15, fixed=true) "Temperature";
equation
  capacity*der(temperature) = power - loss*(temperature - 293.15);
end Vessel;
""",
    },
    """title: Vessel
run: {master: gauss-seidel, step_size: 1 s, stop_time: 100 s}
instances:
  element: {fmu: Element.fmu}
  vessel: {fmu: Vessel.fmu}
connections:
  - element.power -> vessel.power
  - vessel.temperature -> element.temperature
""",
    """format: port-study/1
system: system.yaml
interval: 2 s
columns:
  time: {column: time, unit: s}
  element.command: {column: u, unit: "1", hold: true}
  vessel.temperature: {column: y, unit: K, noise: 0.05 K, feed: false}
calibrated:
  vessel.loss: {tolerance: 0.1 W/K}
""",
    (293.15,),
    _vessel,
    _levels(0.0, 0.9, 60),
    "time [s],u [1],y [K]",
    (0.05,),
    2.0,
)


def _tank(t, x, u, put):
    level, lower = x
    s = {"level": level, "lower": lower}
    inflow = put("inflow", put("command", u, **s), **s)
    between = put("between", 0.02 * level, **s)
    out = put("out", 0.02 * lower, **s)
    return [(inflow - between) / 0.5, (between - out) / 0.5], [level, lower]


TANKS = System(
    {
        "Tank": """model Tank "With an outlet"
  parameter Real area(unit="m2", min=0) = 0.5 "Area";
  parameter Real outlet(unit="m2/s", min=0) = 0.02 "Outlet";
  input Real inflow(unit="m3/s", start=0) "Inflow";
  output Real level(unit="m", start=1, fixed=true) "Level";
  output Real outflow(unit="m3/s") "Outflow";
equation
  area*der(level) = inflow - outflow;
  outflow = outlet*level;
end Tank;
""",
    },
    """title: Two tanks
run: {master: gauss-seidel, step_size: 1 s, stop_time: 100 s}
instances:
  upper: {fmu: Tank.fmu}
  lower: {fmu: Tank.fmu}
connections:
  - upper.outflow -> lower.inflow
""",
    """format: port-study/1
system: system.yaml
interval: 2 s
columns:
  time: {column: time, unit: s}
  upper.inflow: {column: u, unit: m3/s, hold: true}
  upper.level: {column: y, unit: m, noise: 3 mm, feed: false}
  lower.level: {column: z, unit: m, noise: 3 mm, feed: false}
calibrated:
  upper.outlet: {tolerance: 0.0002 m2/s}
  lower.outlet: {tolerance: 0.0002 m2/s}
""",
    (1.0, 1.0),
    _tank,
    _levels(-0.03, 0.06, 20),
    "time [s],u [m3/s],y [m],z [m]",
    (3e-3, 3e-3),
    2.0,
)


@dataclass(frozen=True)
class Case:
    """A hidden law: its family must be found, and its numbers, if given, within 15 %."""

    name: str
    system: System
    hidden: Callable[[], Hidden]
    families: tuple[str, ...]
    laws: tuple[str, ...] = ()
    quick: bool = False
    numbers: tuple[float, ...] = ()


def _play(width: float) -> Callable[..., None]:
    def after(z: list[float], dt: float, value: float, **_: float) -> None:
        z[0] = min(max(z[0], value - width), value + width)

    return after


def _slipping(key: str, width: float) -> Callable[..., None]:
    def after(z: list[float], dt: float, value: float, **s: float) -> None:
        z[0] = min(max(z[0], s[key] - width), s[key] + width)

    return after


def _limited(rate: float) -> Callable[..., None]:
    def after(z: list[float], dt: float, value: float, **_: float) -> None:
        z[0] += min(max(value - z[0], -rate * dt), rate * dt)

    return after


def _sign(value: float) -> float:
    return copysign(1.0, value)


CASES = [
    # Mechanics.
    Case("preload", OSCILLATOR, lambda: Hidden("spring", lambda t, f, z, x, v: f - 1.0 * tanh(x / 1e-3)),
         ("play",), ("preload",)),
    Case("asymmetric stiffness", OSCILLATOR, lambda: Hidden("spring", lambda t, f, z, x, v: f - 80.0 * x * x),
         ("stiffness",), ("asymmetric stiffness",), False, (80.0,)),
    Case("friction with position", OSCILLATOR,
         lambda: Hidden("spring", lambda t, f, z, x, v: f - 12.0 * v * x),
         ("viscous friction",), ("friction with position",)),
    Case("stribeck", OSCILLATOR,
         lambda: Hidden("force", lambda t, f, z, x, v:
                        f - 0.8 * tanh(v / 0.02) * (1.0 + 1.2 * exp(-((v / 0.1) ** 2)))),
         ("dry friction",), ("stribeck",), True, (0.8, 1.2, 0.1, 0.02)),
    Case("Dahl friction", OSCILLATOR,
         lambda: Hidden("force", lambda t, f, z, x, v: f - 1.2 * z[0], [0.0],
                        lambda t, f, z, x, v: [v / 0.02 * (1.0 - _sign(v) * z[0])]),
         ("dry friction", "hysteresis"), ("Dahl friction",)),
    Case("LuGre friction", OSCILLATOR,
         lambda: Hidden("force", lambda t, f, z, x, v: f - 1.2 * z[0], [0.0],
                        lambda t, f, z, x, v: [v / 0.01 - abs(v) / 0.01 * z[0]
                                               / (1.0 + 0.6 * exp(-(v / 0.05) ** 2))]),
         ("dry friction", "hysteresis")),
    Case("Bouc-Wen hysteresis", OSCILLATOR,
         lambda: Hidden("force", lambda t, f, z, x, v: f - 1.5 * z[0], [0.0],
                        lambda t, f, z, x, v: [v / 0.06 * (1.0 - 0.5 * (1.0 + _sign(v * z[0])) * abs(z[0]))]),
         ("hysteresis", "dry friction")),
    Case("slip of a spring", OSCILLATOR,
         lambda: Hidden("force", lambda t, f, z, x, v: f - 30.0 * (x - z[0]), [0.0],
                        after=_slipping("x", 0.04)),
         ("hysteresis", "dry friction"), ("slip of a spring",), True, (1.2, 0.04)),
    Case("backlash", SERVO, lambda: Hidden("encoder", lambda t, a, z, **s: z[0], [0.0], after=_play(0.05)),
         ("play",), ("backlash",), True, (0.05,)),
    Case("relaxation", OSCILLATOR,
         lambda: Hidden("spring", lambda t, f, z, x, v: f - 30.0 * (x - z[0]), [0.0],
                        lambda t, f, z, x, v: [(x - z[0]) / 0.3]),
         ("relaxation",), ("relaxation",)),
    Case("flexible mode", OSCILLATOR,
         lambda: Hidden("force", lambda t, f, z, x, v: f + 30.0 * z[0] + 0.2 * z[1], [0.0, 0.0],
                        lambda t, f, z, x, v: [z[1], -(30.0 * z[0] + 0.2 * z[1]) / 0.3
                                               - (f - 80.0 * x - 2.0 * v + 30.0 * z[0] + 0.2 * z[1]) / 2.0]),
         ("resonance",), ("flexible mode",)),
    Case("added mass", OSCILLATOR,
         lambda: Hidden("total", lambda t, f, z, x, v: f / 1.2), ("added mass", "gain")),
    # Actuators and drives.
    Case("resonance", SERVO,
         lambda: Hidden("command", lambda t, u, z, **s: z[0], [0.0, 0.0],
                        lambda t, u, z, **s: [z[1], 225.0 * (u - z[0]) - 2 * 0.25 * 15.0 * z[1]]),
         ("lag",), ("resonance",), False, (15.0, 0.25)),
    Case("rate limit", SERVO,
         lambda: Hidden("command", lambda t, u, z, **s: z[0], [0.0], after=_limited(6.0)),
         ("rate limit",), ("rate limit",), False, (6.0,)),
    Case("quantisation", replace(SERVO, study=SERVO.study.replace("unit: V}", "unit: V, hold: true}")),
         lambda: Hidden("command", lambda t, u, z, **s: 0.4 * floor(u / 0.4 + 0.5)),
         ("quantisation",), ("quantisation",), True, (0.4,)),
    Case("quantisation of a sensor", SERVO,
         lambda: Hidden("meter", lambda t, i, z, **s: 1.0 * floor(i + 0.5)),
         ("quantisation",), ("quantisation",), False, (1.0,)),
    Case("power limit", SERVO,
         lambda: Hidden("torque", lambda t, m, z, angle, speed, current:
                        m * min(1.0, 0.6 / max(abs(m * speed), 1e-9))),
         ("saturation",), ("power limit",)),
    Case("power curve", SERVO,
         lambda: Hidden("command", lambda t, u, z, **s: copysign(abs(u / 1.2) ** 1.7 * 1.2, u)),
         ("gain curve",), ("power curve",)),
    Case("ripple", SERVO,
         lambda: Hidden("torque", lambda t, m, z, angle, **s: m + 0.02 * sin(angle - 1.2)),
         ("ripple",), ("ripple",), True, (0.02, 1.2)),
    Case("cogging", SERVO,
         lambda: Hidden("torque", lambda t, m, z, angle, **s: m + 0.02 * sin(6 * angle + 0.7)),
         ("ripple",), ("cogging",), False, (0.02, 6.0, 0.7)),
    Case("imbalance", SERVO,
         lambda: Hidden("torque", lambda t, m, z, angle, speed, **s: m + 4e-5 * speed**2 * sin(angle + 1)),
         ("ripple",), ("imbalance",)),
    # Electrical.
    Case("back-EMF", SERVO,
         lambda: Hidden("drop", lambda t, v, z, angle, speed, current: v - 0.02 * speed),
         ("back-EMF",), ("back-EMF",)),
    Case("diode", SERVO, lambda: Hidden("voltage", lambda t, v, z, **s: max(v - 0.7, 0.0)),
         ("one way",), ("diode",)),
    Case("brush drop", SERVO,
         lambda: Hidden("drop", lambda t, v, z, angle, speed, current: v - 0.8 * tanh(current / 0.05)),
         ("voltage drop",), ("brush drop",)),
    Case("smooth saturation", SERVO,
         lambda: Hidden("current", lambda t, i, z, **s: 2.5 * tanh(i / 2.5)), ("saturation",)),
    Case("self-heating", SERVO,
         lambda: Hidden("drop", lambda t, v, z, angle, speed, current: v - 0.15 * z[0] * current, [0.0],
                        lambda t, v, z, angle, speed, current: [(current**2 - z[0]) / 3.0]),
         ("gain with temperature",), ("self-heating",)),
    # Flow and heat.
    Case("heat capacity of a wall", VESSEL,
         lambda: Hidden("heat", lambda t, q, z, temperature: q - 12.0 * (temperature - z[0]), [293.15],
                        lambda t, q, z, temperature: [(temperature - z[0]) / 120.0]),
         ("relaxation",), ("heat capacity of a wall",)),
    Case("boiling limit", VESSEL,
         lambda: Hidden("heat", lambda t, q, z, temperature: q - 400.0 * max(temperature - 343.0, 0.0)),
         ("overflow",), ()),
    Case("natural convection", VESSEL,
         lambda: Hidden("heat", lambda t, q, z, temperature:
                        q - 1.5 * copysign(abs(temperature - 293.15) ** 1.25, temperature - 293.15)),
         ("loss",)),
    Case("gain with temperature", VESSEL,
         lambda: Hidden("power", lambda t, q, z, temperature: q * (1.0 - 0.004 * (temperature - 293.15))),
         ("gain with temperature",), ("gain with temperature",), True, (0.004, 293.15)),
    Case("check valve", TANKS,
         lambda: Hidden("inflow", lambda t, q, z, level, lower: max(q - 0.005, 0.0)),
         ("one way",), ("check valve",), True, (0.005,)),
    Case("root with a laminar part", TANKS,
         lambda: Hidden("out", lambda t, q, z, level, lower:
                        q + 0.02 * lower / (lower**2 + 0.4**2) ** 0.25),
         ("root",)),
    # Sensors.
    Case("cross-talk", SERVO,
         lambda: Hidden("meter", lambda t, i, z, angle, speed, current: i + 0.01 * speed),
         ("cross-talk",)),
    Case("curved scale", SERVO, lambda: Hidden("meter", lambda t, i, z, **s: i + 0.04 * i * i),
         ("gain curve",), ("curved scale",)),
    Case("eccentric scale", SERVO,
         lambda: Hidden("encoder", lambda t, a, z, **s: a + 0.03 * sin(a) + 0.02 * cos(a)),
         ("ripple",), ("eccentric scale",), False, (0.03, 0.02)),
    # Any.
    Case("step at a time", OSCILLATOR,
         lambda: Hidden("force", lambda t, f, z, x, v: f + (1.5 if t > 3.1 else 0.0)),
         ("step",), ("step at a time",)),
    Case("gain that jumps", SERVO,
         lambda: Hidden("voltage", lambda t, v, z, **s: v * (0.7 if t > 4.6 else 1.0)),
         ("step",), ("gain that jumps",)),
]  # fmt: skip


def built(system: System, folder: Path) -> None:
    """Build a system's models into a folder."""
    for name, text in system.models.items():
        (folder / f"{name}.mo").write_text(text, encoding="utf-8")
        subprocess.run(
            [sys.executable, "-m", "orchestrator", "build", f"{name}.mo", "-o", f"{name}.fmu"],
            cwd=folder, check=True, capture_output=True,
        )  # fmt: skip
    (folder / "system.yaml").write_text(system.config, encoding="utf-8")
    runs = ["a.csv, role: train", "b.csv, role: validation", "c.csv, role: held-out"]
    study = system.study + "runs:\n" + "".join(f"  - {{file: {one}}}\n" for one in runs)
    (folder / "study.yaml").write_text(study, encoding="utf-8")


def logged(case: Case, folder: Path) -> Path:
    """Write the logs of three runs with the law hidden; the study's path."""
    system, random = case.system, np.random.default_rng(4)
    for name in "abc":
        time = system.interval * np.arange(system.count)
        driven = system.driven(random, time)
        held = "hold: true" in system.study
        outputs = _solved(system, case.hidden(), driven, held)
        noisy = outputs + np.array(system.noise) * random.standard_normal(outputs.shape)
        table = np.column_stack([time, driven, noisy])
        np.savetxt(
            folder / f"{name}.csv", table, delimiter=",", header=system.header, comments="", fmt="%.9g"
        )
    return folder / "study.yaml"


def _solved(system: System, law: Hidden, driven: np.ndarray, held: bool) -> np.ndarray:
    """Outputs at each sample, by Runge-Kutta's fixed steps."""
    x, dt, seen = list(system.start), system.interval / _FINE, dict[str, Any]()
    law.z = list(law.first)
    nx = len(x)

    def rates(t: float, state: list[float], u: float) -> tuple[list[float], list[float]]:
        more: list[float] = [0.0] * len(law.z)
        z = state[nx:]

        def put(point: str, value: float, **signals: float) -> float:
            if point != law.at:
                return value
            seen.clear()
            seen.update(value=value, **signals)
            if law.rates is not None:
                more[:] = law.rates(t, value, z, **signals)
            return law.value(t, value, z, **signals)

        made, out = system.truth(t, state[:nx], u, put)
        return [*made, *more], out

    def moved(state: list[float], by: list[float], step: float) -> list[float]:
        return [a + step * b for a, b in zip(state, by, strict=True)]

    state, found = [*x, *law.z], []
    for k in range(len(driven)):
        found.append(rates(k * system.interval, state, driven[k])[1])
        if k + 1 == len(driven):
            break
        after = driven[k] if held else driven[k + 1]
        for part in range(_FINE):
            t = (k + part / _FINE) * system.interval
            u = [driven[k] + (after - driven[k]) * (part + f) / _FINE for f in (0.0, 0.5, 1.0)]
            a = rates(t, state, u[0])[0]
            b = rates(t + 0.5 * dt, moved(state, a, 0.5 * dt), u[1])[0]
            c = rates(t + 0.5 * dt, moved(state, b, 0.5 * dt), u[1])[0]
            d = rates(t + dt, moved(state, c, dt), u[2])[0]
            slope = [(p + 2.0 * q + 2.0 * r + s) / 6.0 for p, q, r, s in zip(a, b, c, d, strict=True)]
            state = moved(state, slope, dt)
            if law.after is not None:
                rates(t + dt, state, u[2])
                z = state[nx:]
                law.after(z, dt, **seen)
                state = [*state[:nx], *z]
    return np.array(found)


def right(case: Case, found: Answer) -> str:
    """How right an answer is: "law", "family", or "" if it is wrong."""
    if found.verdict != "law" or found.fitted is None or len(found.fitted.laws) != 1:
        return ""
    one = found.fitted.laws[0]
    names = [one.law.name, *(two.law.name for two in found.twins)]
    families = [one.law.family, *(two.law.family for two in found.twins)]
    if case.laws and set(names) & set(case.laws):
        return "law"
    return "family" if set(families) & set(case.families) else ""


def main(names: list[str]) -> None:
    """Print a table."""
    print("| hidden | verdict | laws | numbers | probability | remains | closed | time | right |")
    print("|" + "---|" * 9)
    with tempfile.TemporaryDirectory() as scratch:
        made: dict[int, Path] = {}
        for case in CASES:
            if names and not any(one in case.name for one in names):
                continue
            folder = made.get(id(case.system))
            if folder is None:
                folder = made[id(case.system)] = Path(scratch) / str(len(made))
                folder.mkdir()
                built(case.system, folder)
            found = answer(load_port_study(logged(case, folder)))
            laws = [one.name for one in found.fitted.laws] if found.fitted else []
            numbers = " ".join(f"{one:.4g}" for one in found.fitted.numbers) if found.fitted else ""
            cells = [
                case.name, found.verdict, " + ".join(laws), numbers, f"{100 * found.probability:.0f} %",
                f"{found.calibrated:.1f} -> {found.remains:.2f}", f"{100 * found.closed:.0f} %",
                f"{found.seconds:.0f} s", right(case, found) or "wrong",
            ]  # fmt: skip
            print("| " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
