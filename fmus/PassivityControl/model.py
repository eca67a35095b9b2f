"""Time-domain passivity control: an observer of the energy that the delays make, a damper that takes it.

After Hannaford and Ryu, "Time-domain passivity control of haptic interfaces", and De Stefano, Balachandran,
Secchi, "A passivity-based approach for simulating satellite dynamics with robots". Signs and frames as in
modelica/DockingHIL/SignConventions.mo. README.md beside this file tells what of the law is ours.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pythonfmu import Fmi2Slave
from shared.line import (
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


@dataclass
class Parameters(LineParameters):
    """What is set before initialisation; SI units."""

    maximum_damping: float = parameter(10e3, "N.s/m", "Largest damping of the controller")
    contact_threshold: float = parameter(5.0, "N", "Measured force above which it may damp", POSITIVE)


@dataclass
class State(LineState):
    """Everything that changes from sample to sample."""

    energy: float = remembered(0.0, "J", "Passivity observer: energy taken up less energy given", "output")
    damping: float = remembered(0.0, "N.s/m", "Passivity controller: damping at work", "output")
    previous_force: float = remembered(0.0, "N", "Measured force one sample ago")
    previous_position: float = remembered(0.0, "m", "Position of the rod one sample ago")
    previous_desired: float = remembered(0.0, "m", "Desired position one sample ago")


def needed_damping(p: Parameters, s: State, u: Inputs) -> float:
    """Damping that takes the energy back over one sample period at the present speed [N.s/m]."""
    if s.energy >= 0.0:
        return 0.0
    if abs(u.measured_force) <= p.contact_threshold:
        return 0.0
    taken = u.desired_velocity * u.desired_velocity * p.sample_period
    return p.maximum_damping if -s.energy >= p.maximum_damping * taken else -s.energy / taken


def sample(p: Parameters, s: State, u: Inputs) -> None:
    """Take one sample: book the work at both ports over the period that ends now, then damp what is missing.

    What goes into the two-port of robot and sensor is the contact's work on the rod; what comes out is the
    work of the output, which was held and so is booked exactly, on the satellite.
    """
    if s.samples == 1:
        s.previous_force = u.measured_force
        s.previous_position, s.previous_desired = u.position, u.desired_position
    taken_up = 0.5 * (u.measured_force + s.previous_force) * (u.position - s.previous_position)
    given = s.force * (u.desired_position - s.previous_desired)
    s.energy += taken_up - given
    s.previous_force = u.measured_force
    s.previous_position, s.previous_desired = u.position, u.desired_position
    s.damping = needed_damping(p, s, u)
    s.force = u.measured_force - s.damping * u.desired_velocity


class PassivityControl(Fmi2Slave):
    """FMI side of the controller."""

    description = "Time-domain passivity observer and controller between contact and satellite; sampled"
    requirements = ()

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        set_up(self, Parameters(), State())

    def setup_experiment(self, start_time: float, stop_time: float | None, tolerance: float | None) -> None:
        """The sample grid begins at the start time; the first sample is one period later."""
        self.state.start_time = start_time

    def exit_initialization_mode(self) -> None:
        """Check the parameters. Raises: ValueError, which the FMI layer logs and turns into a status."""
        refuse(self, *limits_kept(self.parameters))

    def do_step(self, current_time: float, step_size: float) -> bool:
        """Advance to the end of the step, sampling there if a sample is due. Raises: as `inputs_due`."""
        if inputs_due(self, current_time, step_size):
            sample(self.parameters, self.state, sampled(self))
        return True
