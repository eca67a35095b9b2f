"""Smith predictor of the robot's delay with a phase lead for the sensor's.

After Qi, Gao, Zhao, Wang, Ren, "Smith predictor based delay compensation for a hardware-in-the-loop docking
simulator". Signs and frames as in modelica/DockingHIL/SignConventions.mo. README.md beside this file tells
what of the law is ours.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from pythonfmu import Fmi2Slave
from shared.fields import problem
from shared.line import (
    ANY,
    POSITIVE,
    Inputs,
    LineParameters,
    LineState,
    inputs_due,
    limits_kept,
    parameter,
    refuse,
    remembered,
    sampled,
    set_up,
)

# Samples of the desired position that are kept: the longest delay of the robot's model.
TAPS = 64
# Steps of the robot's model in a sample period, and the largest omega_n times such a step.
SUBSTEPS, LARGEST_ANGLE = 4, 1.0


@dataclass
class Parameters(LineParameters):
    """What is set before initialisation; SI units."""

    frequency: float = parameter(75.0, "Hz", "Model of the robot: undamped natural frequency", POSITIVE)
    xi_n: float = parameter(0.8, "1", "Model of the robot: damping ratio")
    tau_m: float = parameter(2e-3, "s", "Model of the robot: pure delay")
    stiffness: float = parameter(176e3, "N/m", "Model of the contact: stiffness")
    damping: float = parameter(0.0, "N.s/m", "Model of the contact: damping")
    front: float = parameter(5e-3, "m", "Model of the contact: position of the front frame", ANY)
    rear: float = parameter(-5e-3, "m", "Model of the contact: position of the rear frame", ANY)
    tau_s: float = parameter(0.0, "s", "Sensor delay to compensate by the phase lead")
    lead_filter_time: float = parameter(1e-3, "s", "Time constant of the lead's filtered difference")


@dataclass
class State(LineState):
    """Everything that changes from sample to sample."""

    predicted_force: float = remembered(
        0.0, "N", "Force of the contact model without the robot's delay", "output"
    )
    modelled_force: float = remembered(
        0.0, "N", "Force of the contact model at the robot model's rod", "output"
    )
    model_position: float = remembered(0.0, "m", "Rod of the robot's model: position")
    model_velocity: float = remembered(0.0, "m/s", "Rod of the robot's model: velocity")
    previous_force: float = remembered(0.0, "N", "Measured force one sample ago")
    force_rate: float = remembered(0.0, "N/s", "Filtered difference of the measured force")
    history: tuple[float, ...] = remembered(
        (0.0,) * TAPS, "m", "Desired position, this many samples ago less one"
    )


def contact_force(p: Parameters, position: float, velocity: float) -> float:
    """The contact model: a spring and a damper behind either frame that only push [N]."""
    if position > p.front:
        return min(0.0, -p.stiffness * (position - p.front) - p.damping * velocity)
    if position < p.rear:
        return max(0.0, -p.stiffness * (position - p.rear) - p.damping * velocity)
    return 0.0


def delayed(history: tuple[float, ...], samples: float) -> float:
    """The history that many samples ago, between two of them on a straight line.

    A sum of hats, not an index: an index has to be known before the model runs natively.
    """
    return sum(max(0.0, 1.0 - abs(samples - index)) * value for index, value in enumerate(history))


def follow(p: Parameters, s: State, begin: float, end: float) -> None:
    """Move the robot's model over a sample period, its delayed command going from `begin` to `end` [m].

    The classical Runge-Kutta method for x'' = omega_n^2 (command - x) - 2 xi_n omega_n x'.
    """
    step = p.sample_period / SUBSTEPS
    x, v = s.model_position, s.model_velocity
    omega_n = 2.0 * math.pi * p.frequency
    square, friction = omega_n * omega_n, 2.0 * p.xi_n * omega_n
    for number in range(SUBSTEPS):
        early = begin + (end - begin) * (number / SUBSTEPS)
        middle = begin + (end - begin) * ((number + 0.5) / SUBSTEPS)
        late = begin + (end - begin) * ((number + 1.0) / SUBSTEPS)
        v1, a1 = v, square * (early - x) - friction * v
        v2 = v + 0.5 * step * a1
        a2 = square * (middle - x - 0.5 * step * v1) - friction * v2
        v3 = v + 0.5 * step * a2
        a3 = square * (middle - x - 0.5 * step * v2) - friction * v3
        v4 = v + step * a3
        a4 = square * (late - x - step * v3) - friction * v4
        x = x + step * (v1 + 2.0 * (v2 + v3) + v4) / 6.0
        v = v + step * (a1 + 2.0 * (a2 + a3) + a4) / 6.0
    s.model_position, s.model_velocity = x, v


def checked(p: Parameters) -> tuple[bool, str]:
    """Whether something is wrong with the parameters, and what, as sentences."""
    wrong, text = limits_kept(p)
    if wrong:
        return wrong, text
    longest = (TAPS - 2) * p.sample_period
    wrong, text = problem(
        p.tau_m <= longest,
        f"tau_m is {p.tau_m!r} s; allowed: up to {longest:.9g} s, {TAPS - 2} sample periods",
    )
    highest = SUBSTEPS * LARGEST_ANGLE / (2.0 * math.pi * p.sample_period)
    wrong, more = problem(
        p.frequency * max(1.0, p.xi_n) <= highest,
        f"frequency is {p.frequency!r} Hz, xi_n {p.xi_n!r}; allowed: a product with the larger of 1 and xi_n "
        f"up to {highest:.9g} Hz, which a sample period can follow",
        wrong,
    )
    text += more
    wrong, more = problem(
        p.rear < p.front, f"rear is {p.rear!r} m, front {p.front!r} m; rear has to be below front", wrong
    )
    text += more
    return wrong, text


def sample(p: Parameters, s: State, u: Inputs) -> None:
    """Take one sample: the reading after the lead, plus what the models say that the delay has changed."""
    if s.samples == 1:
        s.history = (u.desired_position,) * TAPS
        s.model_position, s.model_velocity = u.position, u.velocity
        s.previous_force = u.measured_force
    age = p.tau_m / p.sample_period
    begin = delayed(s.history, age)
    s.history = (u.desired_position, *s.history[:-1])
    follow(p, s, begin, delayed(s.history, age))
    keep = math.exp(-p.sample_period / p.lead_filter_time) if p.lead_filter_time > 0.0 else 0.0
    difference = (u.measured_force - s.previous_force) / p.sample_period
    s.force_rate = keep * s.force_rate + (1.0 - keep) * difference
    s.previous_force = u.measured_force
    # The output is held for a period, so on average it is applied half a period late.
    ahead = u.desired_position + 0.5 * p.sample_period * u.desired_velocity
    s.predicted_force = contact_force(p, ahead, u.desired_velocity)
    s.modelled_force = contact_force(p, s.model_position, s.model_velocity)
    s.force = u.measured_force + p.tau_s * s.force_rate + s.predicted_force - s.modelled_force


class SmithPredictor(Fmi2Slave):
    """FMI side of the controller."""

    description = "Smith predictor of the robot's delay with models of robot and contact, phase lead; sampled"
    requirements = ()

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        set_up(self, Parameters(), State())

    def setup_experiment(self, start_time: float, stop_time: float | None, tolerance: float | None) -> None:
        """The sample grid begins at the start time; the first sample is one period later."""
        self.state.start_time = start_time

    def exit_initialization_mode(self) -> None:
        """Check the parameters. Raises: ValueError, which the FMI layer logs and turns into a status."""
        refuse(self, *checked(self.parameters))

    def do_step(self, current_time: float, step_size: float) -> bool:
        """Advance to the end of the step, sampling there if a sample is due. Raises: as `inputs_due`."""
        if inputs_due(self, current_time, step_size):
            sample(self.parameters, self.state, sampled(self))
        return True
