"""Config of the rig with the effects found.

It extends the bundled system docking-lab: calibrated numbers and effects that change parameters become start
values; effects that act on a signal stand on its connection; robot, contact and sensor are the FMUs LabRobot,
LabContact and LabSensor where they need more than those of the nominal rig. Each effect's file says how it
stands here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from typing import Any

import yaml

from ...fmi.bundled import find_system
from .catalogue import catalogue
from .config_changes import LOAD, READING, ConfigChanges, merged, through, with_unit
from .effect import Effect, by_effect
from .finding import Finding
from .model import apply_changes, begin_state, nominal_parameters
from .rig import Calibrated, State
from .study import UNITS, Array, Role, Run, Study

SYSTEM = "docking-lab"
# Communication steps per tick, as in the bundled system: 0.2 ms at a tick of 1 ms.
STEP = 5

# Units of what the rig's software goes by.
_SOFTWARE = {"mass": "kg", "lead": "s", "tick": "s", "nominal_stiffness": "N/m", "nominal_damping": "N.s/m"}
# What an instance is where effects ask for more than it has, and start values under other names there.
_MORE: Mapping[str, tuple[str, Mapping[str, str]]] = {
    "robot": ("LabRobot", {"position": "start_position", "velocity": "start_velocity"}),
    "contact": ("LabContact", {}),
    "sensor": ("LabSensor", {}),
}


@dataclass(frozen=True)
class AugmentedConfig:
    """A config that extends docking-lab.

    Attributes:
        text: YAML.
        run: name of the run that mass, approach speed and duration are those of.
        changed: what stands in it for effects and calibrated numbers that moved, in words.
        left_out: effects that it does not hold, and why.
    """

    text: str
    run: str
    changed: tuple[str, ...]
    left_out: Mapping[str, str]


def augmented_config(study: Study, finding: Finding, steps: int = STEP) -> AugmentedConfig:
    """Write the model of the chosen answer as a config.

    Args:
        study: of the docking lab's rig; the first held-out run, or else the first of all, gives mass,
            approach speed and duration.
        finding: its answer is written; without effects, the recalibrated rig.
        steps: communication steps per tick.
    """
    run = next(iter(study.of(Role.HELDOUT)), study.runs[0])
    answer = finding.answer
    nominal = nominal_parameters(study, run)
    p = nominal.copy()
    # The controller goes by what its lab believes, whatever the rig's numbers are.
    for name, value in answer.calibrated.items():
        p[Calibrated[name.upper()]] = value
    apply_changes(p, answer.effects, answer.theta)
    added = _parameters(answer.effects, answer.theta)
    added |= {name: theta for name, theta in _known_otherwise(finding).items() if name not in added}
    # Decimal: 700 times 0.001 is 0.7000000000000001 in binary, which is no whole number of steps.
    tick = Decimal(repr(study.tick))
    rig = {"mass": run.mass, "tick": study.tick, "step": float(tick / steps)}
    parts, left_out = _written(finding, added, rig)
    if p[Calibrated.FORCE_BIAS]:
        parts.insert(0, through(READING, offset=with_unit(p[Calibrated.FORCE_BIAS], "N")))
    written = merged(parts)
    for name, factor in written.scaled.items():
        p[Calibrated[name.upper()]] *= factor
    for one in (Calibrated.CONTACT_DAMPING, Calibrated.RESPONSE_DELAY, Calibrated.SENSOR_DELAY):
        if p[one] < 0.0:
            left_out[one.name.lower()] = (
                f"{p[one]:.3g} was found, and the FMUs take none below 0; 0 is written"
            )
            p[one] = 0.0
    data: dict[str, Any] = {
        "extends": SYSTEM,
        "title": f"{study.name}: {run.name} with {', '.join(finding.effects) or 'other calibrated numbers'}",
        "run": {"step_size": f"{tick / steps} s", "stop_time": f"{len(run) * tick} s"},
        "instances": _instances(study, run, p, written, steps),
    }
    if written.through or written.adds:
        data["connections"] = _connections(written)
    text = yaml.safe_dump(data, sort_keys=False, allow_unicode=True, width=110)
    return AugmentedConfig(
        _heading(study, run, left_out) + text, run.name, _changes(nominal, p, written), left_out
    )


def _written(
    finding: Finding, added: Mapping[str, Mapping[str, float]], rig: Mapping[str, float]
) -> tuple[list[ConfigChanges], dict[str, str]]:
    """Changes of the config by each effect of the answer; and effects that are not in it, with the reason."""
    parts: list[ConfigChanges] = []
    left_out: dict[str, str] = {}
    for name, theta in added.items():
        effect = catalogue()[name]
        if effect.written is not None:
            parts.append(effect.written(theta, rig))
    for name in finding.effects:
        if name == "outside":
            left_out[name] = "the catalogue has no law for it"
        elif name not in added:
            left_out[name] = "no parameters of it were fitted"
    return parts, left_out


def _changes(nominal: Array, p: Array, written: ConfigChanges) -> tuple[str, ...]:
    """Differences from the calibrated rig, in words."""
    changes = []
    for one in Calibrated:
        if p[one] != nominal[one] and one is not Calibrated.FORCE_BIAS:
            name = one.name.lower()
            unit = (UNITS | _SOFTWARE).get(name, "1").removeprefix("1")
            text = f"{name.replace('_', ' ')}: {p[one]:.6g} instead of {nominal[one]:.6g} {unit}"
            changes.append(text.rstrip())
    for instance, values in written.start.items():
        listed = ", ".join(f"{name} {_short(value)}" for name, value in values.items())
        changes.append(f"{instance}: {listed or f'{_MORE[instance][0]}, which gives what the effects read'}")
    changes += [f"{connection}: connected" for connection in written.adds]
    for connection, effects in written.through.items():
        listed = ", then ".join(
            ", ".join(f"{name} {_short(value)}" for name, value in one.items()) for one in effects
        )
        changes.append(f"{connection}: through {listed}")
    return tuple(changes)


def _short(value: Any) -> str:
    """A quantity with as many digits as one reads."""
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_short(one)}" for name, one in value.items())
    number, _, unit = str(value).partition(" ")
    return f"{float(number):.6g} {unit}".rstrip()


def _parameters(effects: Sequence[Effect], theta: Array) -> dict[str, dict[str, float]]:
    """Parameters by effect and name, of all parameters one after the other."""
    return {
        effect.id: {one.name: value for one, value in zip(effect.parameters, own.tolist(), strict=True)}
        for effect, own in by_effect(effects, theta)
    }


def _known_otherwise(finding: Finding) -> dict[str, dict[str, float]]:
    """Effects of the answer whose parameters are known from statistics, without a fit."""
    found = {}
    for one in finding.candidates:
        if set(one.effects) != set(finding.effects):
            continue
        for effect in (catalogue()[name] for name in one.effects if name in catalogue()):
            keys = {each.name: f"{effect.id}.{each.name}" for each in effect.parameters}
            if all(key in one.parameters for key in keys.values()):
                found[effect.id] = {name: float(one.parameters[key]) for name, key in keys.items()}
    return found


def _instances(study: Study, run: Run, p: Array, written: ConfigChanges, steps: int) -> dict[str, Any]:
    """Start values of all instances, and other FMUs where effects ask for more."""
    begin = begin_state(study, run)
    value = {one.name: float(p[one]) for one in Calibrated}
    at_start = {
        "position": with_unit(begin[State.POSITION], "m"),
        "velocity": with_unit(run.approach_speed, "m/s"),
    }
    start = {
        "satellite": {
            "mass": with_unit(value["MASS"], "kg"),
            "velocity": with_unit(run.approach_speed, "m/s"),
            "sample_period": with_unit(study.tick, "s"),
        },
        "robot": {
            "omega_n": with_unit(value["NATURAL_FREQUENCY"], "rad/s"),
            "xi_n": value["DAMPING_RATIO"],
            "tau_m": with_unit(value["RESPONSE_DELAY"], "s"),
            **at_start,
        },
        "contact": {
            "stiffness": with_unit(value["CONTACT_STIFFNESS"], "N/m"),
            "damping": with_unit(value["CONTACT_DAMPING"], "N.s/m"),
            "front": with_unit(value["FRONT_WALL"], "m"),
            "rear": with_unit(value["REAR_WALL"], "m"),
        },
        # The sensor holds the force of a step's end from the step's start, half a step too early.
        "sensor": {
            "tau_s": with_unit(value["SENSOR_DELAY"] + 0.5 * study.tick / steps, "s"),
            "cutoff": with_unit(value["SENSOR_CUTOFF"] / (2.0 * math.pi), "Hz"),
        },
        "controller": {
            "sample_period": with_unit(study.tick, "s"),
            "lead_time": with_unit(value["LEAD"], "s"),
            "stiffness": with_unit(value["NOMINAL_STIFFNESS"], "N/m"),
            "damping": with_unit(value["NOMINAL_DAMPING"], "N.s/m"),
            "stiffness_gain": value["STIFFNESS_GAIN"],
            **{f"start_{name}": quantity for name, quantity in at_start.items()},
        },
    }
    if value["FORCE_BIAS"]:
        # The controller takes its first sample a tick after the start; till then it has put this out.
        start["controller"]["force"] = with_unit(value["FORCE_BIAS"], "N")
    found: dict[str, Any] = {name: {"start": values} for name, values in start.items()}
    for name, (fmu, renamed) in _MORE.items():
        if name in written.start:
            values = {renamed.get(key, key): value for key, value in start[name].items()}
            # Null takes away what the system extended has.
            found[name] = {"fmu": fmu, "start": {**dict.fromkeys(renamed), **values}}
    if "robot" in written.start:
        found["robot"]["start"]["approach_period"] = with_unit(study.tick, "s")
        if LOAD not in written.adds:
            found["robot"]["start"]["force"] = with_unit(0.0, "N")
    if "sensor" in written.start:
        found["sensor"]["start"]["start_velocity"] = at_start["velocity"]
    for name, values in written.start.items():
        found[name]["start"].update(values)
    return found


def _connections(written: ConfigChanges) -> list[Any]:
    """All connections of the system, since a list replaces the one that it extends."""
    path = find_system(SYSTEM)
    assert path is not None
    connections = yaml.safe_load(path.read_text(encoding="utf-8"))["connections"]
    made: list[Any] = []
    for connection in (*connections, *written.adds):
        source, _, target = connection.partition(" -> ")
        effects = list(map(dict, written.through.get(connection, ())))
        made.append({"from": source, "to": target, "through": effects} if effects else connection)
    return made


def _heading(study: Study, run: Run, left_out: Mapping[str, str]) -> str:
    lines = [
        f"# The rig of {study.name} with the effects found; mass, speed and duration as in {run.name}.",
        "# Noise and rounding of sensor and encoder are left out.",
    ]
    lines += [f"# Not in it: {name}: {why}." for name, why in left_out.items()]
    return "\n".join(lines) + "\n"
