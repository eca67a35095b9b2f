"""Plain admittance control: the measured force drives the satellite, low-passed, scaled and damped at will.

Signs and frames as in modelica/DockingHIL/SignConventions.mo. README.md beside this file gives the law.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from pythonfmu import Fmi2Slave
from shared.line import (
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

    force_gain: float = parameter(1.0, "1", "Factor of the measured force")
    filter_time: float = parameter(0.0, "s", "Time constant of a first-order low-pass; 0: none")
    virtual_damping: float = parameter(0.0, "N.s/m", "Damping of the satellite's motion in contact")
    contact_threshold: float = parameter(5.0, "N", "Measured force above which there is contact")


@dataclass
class State(LineState):
    """Everything that changes from sample to sample."""

    filtered_force: float = remembered(0.0, "N", "Measured force after the low-pass")


def sample(p: Parameters, s: State, u: Inputs) -> None:
    """Take one sample: force = gain lowpass(measured) - damping v_des, the damping in contact only."""
    keep = math.exp(-p.sample_period / p.filter_time) if p.filter_time > 0.0 else 0.0
    s.filtered_force = keep * s.filtered_force + (1.0 - keep) * u.measured_force
    damping = p.virtual_damping if abs(u.measured_force) > p.contact_threshold else 0.0
    s.force = p.force_gain * s.filtered_force - damping * u.desired_velocity


class AdmittanceControl(Fmi2Slave):
    """FMI side of the controller."""

    description = (
        "Plain admittance control: measured force, low-pass, gain, virtual damping in contact; sampled"
    )
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
