"""Compliance controller of the docking lab: phase lead, two-parameter Kalman filter, force compensation.

Equations after He, Shen, Gao, Zhang, "Active Compliance Control of a Position-Controlled Industrial Robot for
Simulating Space Operations", in the form that the lab's software has them. Signs and frames as in
modelica/DockingHIL/SignConventions.mo. README.md beside this file gives the law.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pythonfmu import Fmi2Causality, Fmi2Initial, Fmi2Slave, Fmi2Variability, Real
from shared.line import (
    ANY,
    POSITIVE,
    Inputs,
    LineState,
    inputs_due,
    limits_kept,
    parameter,
    refuse,
    remembered,
    sampled,
    set_up,
)

FORCE_FILTER, POSITION_FILTER = 0.35, 0.25
CONTACT_THRESHOLD, UPDATE_THRESHOLD = 4.0, 15.0  # N
SOFTEST = 1000.0  # N/m, of the stiffness that locates the contact point
# Covariances of the filter: its start, what each update adds, the reading's [N^2].
START_SPREAD, START_DAMPING_SIGMA = 0.15, 60.0
STIFFNESS_DRIFT, DAMPING_DRIFT, FORCE_VARIANCE = 1e4, 1.0, 4.0
LOWEST, HIGHEST, MOST_DAMPING = 0.4, 2.0, 600.0


@dataclass
class Parameters:
    """What is set before initialisation; SI units."""

    sample_period: float = parameter(1e-3, "s", "Tick of the software", POSITIVE)
    lead_time: float = parameter(0.0, "s", "Delay of the reading that the lead makes up for")
    stiffness: float = parameter(176e3, "N/m", "Contact stiffness that the estimate starts from", POSITIVE)
    damping: float = parameter(100.0, "N.s/m", "Contact damping that the estimate starts from")
    stiffness_gain: float = parameter(0.0, "1", "What the compensation's stiffness is too large by", ANY)
    start_position: float = parameter(0.0, "m", "Position of the rod tip at the start", ANY)
    start_velocity: float = parameter(0.0, "m/s", "Velocity of the rod tip at the start", ANY)


@dataclass
class State(LineState):
    """Everything that changes from sample to sample."""

    force_rate: float = remembered(0.0, "N/s", "Filtered rate of the measured force")
    position_rate: float = remembered(0.0, "m/s", "Filtered rate of the rod tip")
    previous_force: float = remembered(0.0, "N", "Measured force of the previous sample")
    previous_position: float = remembered(0.0, "m", "Position of the previous sample")
    in_contact: int = remembered(0, "", "1 in contact, 0 otherwise")
    contact_point: float = remembered(0.0, "m", "Where this contact began")
    stiffness: float = remembered(0.0, "N/m", "Estimated contact stiffness, once a sample was taken")
    damping: float = remembered(0.0, "N.s/m", "Estimated contact damping, once a sample was taken")
    covariance_kk: float = remembered(0.0, "N2/m2", "Variance of the stiffness")
    covariance_kc: float = remembered(0.0, "N2.s/m2", "Covariance of stiffness and damping")
    covariance_cc: float = remembered(0.0, "N2.s2/m2", "Variance of the damping")


def begin(p: Parameters, s: State) -> None:
    """What the sample at the start leaves: no force, and the rod where it was."""
    s.previous_position = p.start_position
    s.position_rate = (1.0 - POSITION_FILTER) * p.start_velocity
    s.stiffness, s.damping = p.stiffness, p.damping
    s.covariance_kk = (START_SPREAD * p.stiffness) ** 2
    s.covariance_cc = START_DAMPING_SIGMA**2


def update(p: Parameters, s: State, depth: float, led: float) -> None:
    """Take one step of the filter: led = -k depth - c rate."""
    s.covariance_kk += STIFFNESS_DRIFT
    s.covariance_cc += DAMPING_DRIFT
    h_k, h_c = -depth, -s.position_rate
    s_k = s.covariance_kk * h_k + s.covariance_kc * h_c
    s_c = s.covariance_kc * h_k + s.covariance_cc * h_c
    variance = h_k * s_k + h_c * s_c + FORCE_VARIANCE
    gain_k, gain_c = s_k / variance, s_c / variance
    error = led - h_k * s.stiffness - h_c * s.damping
    s.covariance_kk -= gain_k * s_k
    s.covariance_kc -= gain_k * s_c
    s.covariance_cc -= gain_c * s_c
    s.stiffness = min(max(s.stiffness + gain_k * error, LOWEST * p.stiffness), HIGHEST * p.stiffness)
    s.damping = min(max(s.damping + gain_c * error, 0.0), MOST_DAMPING)


def sample(p: Parameters, s: State, u: Inputs) -> None:
    """Take one sample; the velocity of the rod tip is made from its positions."""
    if s.samples == 1:
        begin(p, s)
    force, position = u.measured_force, u.position
    s.force_rate += FORCE_FILTER * ((force - s.previous_force) / p.sample_period - s.force_rate)
    s.position_rate += POSITION_FILTER * (
        (position - s.previous_position) / p.sample_period - s.position_rate
    )
    s.previous_force, s.previous_position = force, position
    if abs(force) > CONTACT_THRESHOLD:
        compensate(p, s, u)
    else:
        s.in_contact = 0
        s.force = force


def compensate(p: Parameters, s: State, u: Inputs) -> None:
    """Give the force that the satellite would feel if the robot were where it is to be."""
    led = u.measured_force + p.lead_time * s.force_rate
    if s.in_contact == 0:
        s.in_contact = 1
        s.contact_point = u.position + u.measured_force / max(s.stiffness, SOFTEST)
    if abs(led) > UPDATE_THRESHOLD:
        update(p, s, u.position - s.contact_point, led)
    ahead, faster = u.desired_position - u.position, u.desired_velocity - s.position_rate
    s.force = led - (1.0 + p.stiffness_gain) * s.stiffness * ahead - s.damping * faster


def stiffness_estimate(p: Parameters, s: State) -> float:
    """Estimated contact stiffness [N/m]."""
    return s.stiffness if s.samples > 0 else p.stiffness


def damping_estimate(p: Parameters, s: State) -> float:
    """Estimated contact damping [N.s/m]."""
    return s.damping if s.samples > 0 else p.damping


class LabController(Fmi2Slave):
    """FMI side of the controller."""

    description = "Compliance controller of the docking lab: phase lead, Kalman filter, compensation; sampled"
    requirements = ()

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        set_up(self, Parameters(), State())
        self.initial_dependencies = {}
        for name, unit, estimate in (
            ("stiffness", "N/m", stiffness_estimate),
            ("damping", "N.s/m", damping_estimate),
        ):
            label = f"{name}_estimate"
            self.type_attributes[label] = {"unit": unit}
            self.register_variable(
                Real(
                    label,
                    causality=Fmi2Causality.output,
                    variability=Fmi2Variability.discrete,
                    initial=Fmi2Initial.calculated,
                    description=f"Estimated contact {name}",
                    getter=lambda estimate=estimate: estimate(self.parameters, self.state),
                )
            )
            self.dependencies[label] = ()
            self.initial_dependencies[label] = (name,)

    def setup_experiment(self, start_time: float, stop_time: float | None, tolerance: float | None) -> None:
        """The sample grid begins at the start time, where the contact is yet to come."""
        self.state.start_time = start_time

    def exit_initialization_mode(self) -> None:
        """Check the parameters. Raises: ValueError, which the FMI layer logs and turns into a status."""
        refuse(self, *limits_kept(self.parameters))

    def do_step(self, current_time: float, step_size: float) -> bool:
        """Advance to the end of the step, sampling there if a sample is due. Raises: as `inputs_due`."""
        if inputs_due(self, current_time, step_size):
            sample(self.parameters, self.state, sampled(self))
        return True
