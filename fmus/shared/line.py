"""Sampled controllers on a line: the sockets that all of them have, the sample grid, refusals.

Signs and frames as in modelica/DockingHIL/SignConventions.mo: forces act on the rod, positive towards the
front frame; the front frame pushes with a negative force.
"""

from __future__ import annotations

import math
from dataclasses import Field, dataclass, field, fields
from typing import Any, NamedTuple

from pythonfmu import Fmi2Causality, Fmi2Initial, Fmi2Variability, Integer, Real

# Of a sample period: far above the rounding of a communication point's time, far below any step.
GRID_TOLERANCE = 1e-6
# What a parameter may be, besides finite.
ANY, NOT_NEGATIVE, POSITIVE = "", "not negative", "above 0"


class Inputs(NamedTuple):
    """Inputs at one sample: force [N], positions [m], velocities [m/s]; desired ones are the satellite's."""

    measured_force: float
    position: float
    velocity: float
    desired_position: float
    desired_velocity: float


INPUTS = Inputs(*range(5))._asdict()
UNITS = Inputs("N", "m", "m/s", "m", "m/s")
NOMINAL = Inputs("100", "0.01", "0.02", "0.01", "0.02")
MEANING = Inputs(
    "Reading of the force sensor",
    "Position of the rod tip",
    "Velocity of the rod tip",
    "Position of the satellite's rod tip, which the robot follows",
    "Velocity of the satellite's rod tip",
)


def parameter(
    default: float, unit: str, description: str, allowed: str = NOT_NEGATIVE, **attributes: str
) -> Any:
    """A dataclass field that is set before initialisation."""
    attributes = {"unit": unit, **attributes, **({} if allowed == ANY else {"min": "0"})}
    metadata = {"attributes": attributes, "description": description, "allowed": allowed}
    return field(default=default, metadata=metadata)


def remembered(default: Any, unit: str, description: str, kind: str = "local") -> Any:
    """A dataclass field that changes from sample to sample: FMU state is made of these."""
    attributes = {"unit": unit} if unit else {}
    return field(
        default=default, metadata={"attributes": attributes, "description": description, "kind": kind}
    )


@dataclass
class LineParameters:
    """What every sampled controller is told."""

    sample_period: float = parameter(5e-4, "s", "Sample period of the controller", POSITIVE)


@dataclass
class LineState:
    """What every sampled controller remembers."""

    force: float = remembered(0.0, "N", "Force on the satellite, held between samples", "output")
    start_time: float = remembered(0.0, "s", "Start time, where the sample grid begins")
    samples: int = remembered(0, "", "Samples taken; the next: start_time + (samples + 1)*sample_period")


def set_up(slave: Any, parameters: Any, state: Any) -> None:
    """Give a slave its variables: inputs, the fields of `parameters`, the fields of `state`."""
    slave.parameters, slave.state = parameters, state
    slave.type_attributes = {}
    for name, place in INPUTS.items():
        setattr(slave, name, 0.0)
        slave.type_attributes[name] = {"unit": UNITS[place], "nominal": NOMINAL[place]}
        slave.register_variable(Real(name, causality=Fmi2Causality.input, description=MEANING[place]))
    for entry in fields(parameters):
        _register(slave, entry, parameters, entry.name, Fmi2Causality.parameter, Fmi2Variability.fixed)
    outputs = []
    for entry in fields(state):
        output = entry.metadata["kind"] == "output"
        name = entry.name if output else f"state.{entry.name}"
        causality = Fmi2Causality.output if output else Fmi2Causality.local
        _register(slave, entry, state, name, causality, Fmi2Variability.discrete)
        outputs += [name] if output else []
    # Outputs change at samples, inside a step: at a communication point none follows an input at once.
    slave.dependencies = {name: () for name in outputs}


def _register(
    slave: Any, entry: Field, owner: Any, name: str, causality: Fmi2Causality, variability: Fmi2Variability
) -> None:
    """Register a field; a tuple of numbers as one variable each."""
    value = getattr(owner, entry.name)
    places = range(len(value)) if isinstance(value, tuple) else (None,)
    for place in places:
        label = name if place is None else f"{name}[{place + 1}]"
        slave.type_attributes[label] = dict(entry.metadata["attributes"])
        slave.register_variable(
            (Integer if entry.type == "int" else Real)(
                label,
                causality=causality,
                variability=variability,
                initial=None if causality is Fmi2Causality.parameter else Fmi2Initial.exact,
                description=entry.metadata["description"],
                getter=_getter(owner, entry.name, place),
                setter=_setter(owner, entry.name, place),
            )
        )


def _getter(owner: Any, name: str, place: int | None) -> Any:
    return lambda: getattr(owner, name) if place is None else getattr(owner, name)[place]


def _setter(owner: Any, name: str, place: int | None) -> Any:
    def store(value: Any) -> None:
        if place is not None:
            numbers = getattr(owner, name)
            value = (*numbers[:place], value, *numbers[place + 1 :])
        setattr(owner, name, value)

    return store


def problem(right: bool, sentence: str, wrong: bool = False) -> tuple[bool, str]:
    """Whether something is wrong by now, and the sentence if it is this; the native form asks at run time."""
    if right:
        return wrong, ""
    return True, f"; {sentence}" if wrong else sentence


def limits_kept(parameters: Any) -> tuple[bool, str]:
    """Whether a parameter is out of its limits, and all that are, as a sentence each."""
    wrong, text = False, ""
    for entry in fields(parameters):
        wrong, more = _limit(entry, getattr(parameters, entry.name), wrong)
        text += more
    return wrong, text


def _limit(entry: Field, value: float, wrong: bool) -> tuple[bool, str]:
    allowed, unit = entry.metadata["allowed"], entry.metadata["attributes"]["unit"]
    right = math.isfinite(value)
    if allowed == NOT_NEGATIVE:
        right = right & (value >= 0.0)
    if allowed == POSITIVE:
        right = right & (value > 0.0)
    demanded = f"finite and {allowed}" if allowed else "finite"
    return problem(right, f"{entry.name} is {value!r} {unit}; allowed: {demanded}", wrong)


def refuse(slave: Any, wrong: bool, text: str) -> None:
    """Raises: ValueError, which the FMI layer logs and turns into a status, if something is wrong."""
    if wrong:
        raise ValueError(f"{slave.instance_name}: {text}")


def sample_due(slave: Any, current_time: float, step_size: float) -> bool:
    """Whether a sample is due at the end of the step.

    Raises: ValueError, which the FMI layer logs and turns into a status, if the step leaves out a sample or
        an input is not finite when it is sampled.
    """
    p, s = slave.parameters, slave.state
    end = current_time + step_size
    elapsed = end - s.start_time
    index = round(elapsed / p.sample_period)
    on_grid = abs(elapsed - index * p.sample_period) <= GRID_TOLERANCE * p.sample_period
    reached = index if on_grid else math.floor(elapsed / p.sample_period)
    if reached <= s.samples:
        return False
    if not on_grid or reached > s.samples + 1:
        due = s.start_time + (s.samples + 1) * p.sample_period
        raise ValueError(
            f"{slave.instance_name}: the step from {current_time:.9g} s to {end:.9g} s passes over the "
            f"sample at {due:.9g} s; steps have to end at every multiple of sample_period, "
            f"{p.sample_period:.9g} s: take a step size that divides it, or set sample_period to the "
            "step size"
        )
    for name, place in INPUTS.items():
        _require_finite(slave, name, UNITS[place], end)
    return True


def _require_finite(slave: Any, name: str, unit: str, time: float) -> None:
    value = getattr(slave, name)
    if not math.isfinite(value):
        raise ValueError(
            f"{slave.instance_name}: input {name} is {value!r} {unit} at {time:.9g} s; a finite number is "
            "needed. Look at what is connected to it"
        )


def sampled(slave: Any) -> Inputs:
    """The inputs; counts the sample."""
    slave.state.samples += 1
    return Inputs(
        slave.measured_force, slave.position, slave.velocity, slave.desired_position, slave.desired_velocity
    )


def only_push(force: float, measured_force: float) -> float:
    """The force where it has the measured one's direction, else none: a frame only pushes."""
    return force if force * measured_force > 0.0 else 0.0
