"""The rig with the effects that were found, as a config that runs.

It extends the bundled system docking-lab: calibrated numbers and effects that change parameters become start
values; effects that act on a signal stand on its connection where the co-simulation has the like.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from typing import Any

import yaml

from ..bundled import find_system
from .catalogue import catalogue
from .effect import Effect
from .finding import Finding
from .model import apply_changes, begin_state, nominal_parameters
from .rig import Calibrated, State
from .study import Array, Role, Run, Study

__all__ = ["NAME", "STEP", "SYSTEM", "AugmentedConfig", "augmented_config", "is_docking_lab"]

NAME = "augmented.yaml"
SYSTEM = "docking-lab"
# Communication steps per tick, as in the bundled system: 0.2 ms at a tick of 1 ms.
STEP = 5

_COMMAND = "satellite.command -> robot.command"
_PLACE = "robot.position -> contact.position"
_RATE = "robot.velocity -> contact.velocity"
_FORCE = "contact.force -> sensor.force"
_READING = "sensor.measured_force -> controller.measured_force"
_DRIVE = "controller.force -> satellite.force"
# Parameters of an effect by name, and of the rig by Calibrated -> entries of `through`, by connection.
Insert = Callable[[Mapping[str, float], Array], dict[str, dict[str, Any]]]


@dataclass(frozen=True)
class AugmentedConfig:
    """A config that extends docking-lab.

    Attributes:
        text: YAML.
        run: name of the run that mass, approach speed and duration are those of.
        left_out: effects that it does not hold, and why.
    """

    text: str
    run: str
    left_out: Mapping[str, str]


def _hold(theta: Mapping[str, float], p: Array) -> dict[str, dict[str, Any]]:
    every, tick = round(theta["every"]), float(p[Calibrated.TICK])
    # A tick's command is there at the end of its first step.
    phase = (every - 1) * tick + tick / STEP
    return {_COMMAND: {"sample-and-hold": _with(every * tick, "s"), "phase": _with(phase, "s")}}


_INSERTS: dict[str, Insert] = {
    "link.sample-and-hold": _hold,
    "robot.command-quantisation": lambda t, p: {_COMMAND: {"quantise": _with(t["step"], "m")}},
    "structure.kinematic-scale": lambda t, p: {
        connection: {"gain": 1.0 + t["scale"]} for connection in (_PLACE, _RATE)
    },
    "structure.offset": lambda t, p: {_PLACE: {"offset": _with(-t["offset"], "m")}},
    "sensor.low-pass": lambda t, p: {_FORCE: {"low-pass": {"time_constant": _with(t["time_constant"], "s")}}},
    "sensor.gain": lambda t, p: {_READING: {"gain": 1.0 + t["gain"]}},
    "sensor.quantisation": lambda t, p: {_READING: {"quantise": _with(t["step"], "N")}},
    "dynamics.residual-gravity": lambda t, p: {
        _DRIVE: {"offset": _with(t["acceleration"] * p[Calibrated.MASS], "N")}
    },
}
# Laws on the satellite that are those of another mass: relative parameters -> its factor.
_MASSES: dict[str, Callable[[Mapping[str, float]], float]] = {
    "dynamics.mass": lambda t: 1.0 + t["relative"],
    "dynamics.mass-offset": lambda t: 1.0 / (1.0 + t["offset"] ** 2),
}


def is_docking_lab(study: Study) -> bool:
    """Whether a study is of the rig that docking-lab is of."""
    needed = {one.name.lower() for one in list(Calibrated)[: Calibrated.LEAD]}
    return needed <= set(study.nominal) and find_system(SYSTEM) is not None


def augmented_config(study: Study, finding: Finding) -> AugmentedConfig:
    """Write the model of the answer given as a config.

    Args:
        study: of the docking lab's rig; the first held-out run, or else the first of all, gives mass,
            approach speed and duration.
        finding: its answer is written; without effects, the recalibrated rig.
    """
    run = next(iter(study.of(Role.HELDOUT)), study.runs[0])
    answer = finding.answer
    p = nominal_parameters(study, run)
    # The controller goes by what its lab believes, whatever the rig's numbers are.
    for name, value in answer.calibrated.items():
        p[Calibrated[name.upper()]] = value
    apply_changes(p, answer.effects, answer.theta)
    through: dict[str, list[dict[str, Any]]] = {}
    left_out: dict[str, str] = {}
    if p[Calibrated.FORCE_BIAS]:
        through[_READING] = [{"offset": _with(p[Calibrated.FORCE_BIAS], "N")}]
    added = _parameters(answer.effects, answer.theta)
    added |= {name: theta for name, theta in _known_otherwise(finding).items() if name not in added}
    for name, theta in added.items():
        if name in _MASSES:
            p[Calibrated.MASS] *= _MASSES[name](theta)
        elif name in _INSERTS:
            for connection, entry in _INSERTS[name](theta, p).items():
                through.setdefault(connection, []).append(entry)
        elif not catalogue()[name].changes:
            left_out[name] = _why(catalogue()[name])
    for name in finding.effects:
        if name == "outside":
            left_out[name] = "the catalogue has no law for it"
        elif name not in added:
            left_out[name] = "no parameters of it were fitted"
    for one in (Calibrated.CONTACT_DAMPING, Calibrated.RESPONSE_DELAY, Calibrated.SENSOR_DELAY):
        if p[one] < 0.0:
            left_out[one.name.lower()] = (
                f"{p[one]:.3g} was found, and the FMUs take none below 0; 0 is written"
            )
            p[one] = 0.0
    # Decimal: 700 times 0.001 is 0.7000000000000001 in binary, which is no whole number of steps.
    tick = Decimal(repr(study.tick))
    steps = {"step_size": f"{tick / STEP} s", "stop_time": f"{len(run) * tick} s"}
    data: dict[str, Any] = {
        "extends": SYSTEM,
        "title": f"{study.name}: {run.name} with {', '.join(finding.effects) or 'other calibrated numbers'}",
        "run": steps,
        "instances": _start_values(study, run, p),
    }
    if through:
        data["connections"] = _connections(through)
    text = yaml.safe_dump(data, sort_keys=False, allow_unicode=True, width=110)
    return AugmentedConfig(_heading(study, run, left_out) + text, run.name, left_out)


def _parameters(effects: Sequence[Effect], theta: Array) -> dict[str, dict[str, float]]:
    """Parameters by effect and name, of all parameters one after the other."""
    found, first = {}, 0
    for effect in effects:
        names = [one.name for one in effect.parameters]
        values = theta[first : first + len(names)]
        found[effect.id] = {name: float(value) for name, value in zip(names, values, strict=True)}
        first += len(names)
    return found


def _known_otherwise(finding: Finding) -> dict[str, dict[str, float]]:
    """Effects of the answer whose parameters are known without a fit: statistics tell them."""
    found = {}
    for one in finding.candidates:
        if set(one.effects) != set(finding.effects):
            continue
        for effect in (catalogue()[name] for name in one.effects if name in catalogue()):
            keys = {each.name: f"{effect.id}.{each.name}" for each in effect.parameters}
            if all(key in one.parameters for key in keys.values()):
                found[effect.id] = {name: float(one.parameters[key]) for name, key in keys.items()}
    return found


def _why(effect: Effect) -> str:
    if effect.statistic:
        return "it is known by statistics alone, not by a law"
    return f"no effect on a connection is the like of its law, {effect.equation}"


def _start_values(study: Study, run: Run, p: Array) -> dict[str, Any]:
    """Start values of all instances."""
    begin = begin_state(study, run)
    value = {one.name: float(p[one]) for one in Calibrated}
    at_start = {"position": _with(begin[State.POSITION], "m"), "velocity": _with(run.approach_speed, "m/s")}
    start = {
        "satellite": {
            "mass": _with(value["MASS"], "kg"),
            "velocity": _with(run.approach_speed, "m/s"),
            "sample_period": _with(study.tick, "s"),
        },
        "robot": {
            "omega_n": _with(value["NATURAL_FREQUENCY"], "rad/s"),
            "xi_n": value["DAMPING_RATIO"],
            "tau_m": _with(value["RESPONSE_DELAY"], "s"),
            **at_start,
        },
        "contact": {
            "stiffness": _with(value["CONTACT_STIFFNESS"], "N/m"),
            "damping": _with(value["CONTACT_DAMPING"], "N.s/m"),
            "front": _with(value["FRONT_WALL"], "m"),
            "rear": _with(value["REAR_WALL"], "m"),
        },
        # The sensor holds the force of a step's end from its begin on, half a step too early.
        "sensor": {
            "tau_s": _with(value["SENSOR_DELAY"] + 0.5 * study.tick / STEP, "s"),
            "cutoff": _with(value["SENSOR_CUTOFF"] / (2.0 * math.pi), "Hz"),
        },
        "controller": {
            "sample_period": _with(study.tick, "s"),
            "lead_time": _with(value["LEAD"], "s"),
            "stiffness": _with(value["NOMINAL_STIFFNESS"], "N/m"),
            "damping": _with(value["NOMINAL_DAMPING"], "N.s/m"),
            "stiffness_gain": value["STIFFNESS_GAIN"],
            **{f"start_{name}": quantity for name, quantity in at_start.items()},
        },
    }
    return {name: {"start": values} for name, values in start.items()}


def _connections(through: Mapping[str, list[dict[str, Any]]]) -> list[Any]:
    """All connections of the system, since a list replaces the one that it extends."""
    path = find_system(SYSTEM)
    assert path is not None
    written = yaml.safe_load(path.read_text(encoding="utf-8"))["connections"]
    made = []
    for connection in written:
        source, _, target = connection.partition(" -> ")
        effects = through.get(connection)
        made.append({"from": source, "to": target, "through": effects} if effects else connection)
    return made


def _heading(study: Study, run: Run, left_out: Mapping[str, str]) -> str:
    lines = [
        f"# The rig of {study.name} with the effects found; mass, speed and duration as in {run.name}.",
        "# Noise and rounding of sensor and encoder are left out.",
    ]
    lines += [f"# Not in it: {name}: {why}." for name, why in left_out.items()]
    return "\n".join(lines) + "\n"


def _with(value: float, unit: str) -> str:
    return f"{float(value)!r} {unit}"
