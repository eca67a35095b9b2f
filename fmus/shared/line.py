"""Sampled controllers on a line: the sockets that all of them have, the sample grid, refusals.

Signs and frames as in modelica/DockingHIL/SignConventions.mo: forces act on the rod, positive towards the
front frame; the front frame pushes with a negative force.
"""

from __future__ import annotations

import math
from dataclasses import Field, dataclass, field, fields
from typing import Any, NamedTuple

from pythonfmu import Fmi2Causality, Fmi2Variability, Real
from shared.fields import problem, register
from shared.sampling import require_finite, sample_due

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
        register(slave, entry, parameters, entry.name, Fmi2Causality.parameter, Fmi2Variability.fixed)
    outputs = []
    for entry in fields(state):
        output = entry.metadata["kind"] == "output"
        name = entry.name if output else f"state.{entry.name}"
        causality = Fmi2Causality.output if output else Fmi2Causality.local
        register(slave, entry, state, name, causality, Fmi2Variability.discrete)
        outputs += [name] if output else []
    # Outputs change at samples, inside a step: at a communication point none follows an input at once.
    slave.dependencies = {name: () for name in outputs}


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


def inputs_due(slave: Any, current_time: float, step_size: float) -> bool:
    """Whether a sample is due at the end of the step.

    Raises: ValueError, which the FMI layer logs and turns into a status, if the step leaves out a sample or
        an input is not finite when it is sampled.
    """
    if not sample_due(slave, current_time, step_size):
        return False
    for name in INPUTS:
        require_finite(slave, name, getattr(slave, name), current_time + step_size)
    return True


def sampled(slave: Any) -> Inputs:
    """The inputs; counts the sample."""
    slave.state.samples += 1
    return Inputs(
        slave.measured_force, slave.position, slave.velocity, slave.desired_position, slave.desired_velocity
    )


def only_push(force: float, measured_force: float) -> float:
    """The force where it has the measured one's direction, else none: a frame only pushes."""
    return force if force * measured_force > 0.0 else 0.0
