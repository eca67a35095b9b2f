"""Active compliance control of a docking simulator on a line: phase lead, identification, force compensation.

Source of the equations: He, Shen, Gao, Zhang, "Active Compliance Control of a Position-Controlled
Industrial Robot for Simulating Space Operations". Signs and frames as in
modelica/DockingHIL/SignConventions.mo: forces act on the rod, positive towards the front frame; the front
frame pushes with a negative force. README.md beside this file tells which choices are ours and why.
"""

from __future__ import annotations

import math
from dataclasses import fields
from typing import Any, NamedTuple

from pythonfmu import Fmi2Causality, Fmi2Initial, Fmi2Slave, Fmi2Variability, Real
from shared.compliance import LEAD, MODES, OFF, Parameters, State
from shared.compliance_law import ContactLaw
from shared.fields import register
from shared.sage_husa import phase_lead
from shared.sampling import require_finite, sample_due


class Inputs(NamedTuple):
    """Inputs at one sample: force [N], positions [m], velocities [m/s]; desired ones are the satellite's."""

    measured_force: float
    position: float
    velocity: float
    desired_position: float
    desired_velocity: float


class ComplianceLaw(ContactLaw):
    """The law on a line: contact_state is the direction into the frame."""

    def _along(self, value: float, direction: float) -> float:
        return value * direction

    def _size(self, force: float) -> float:
        return abs(force)

    def _outward(self) -> float:
        return self.state.contact_state

    def _axis(self) -> float:
        # Increments need no direction on a line: the law holds at either frame, whatever the sign.
        return 1

    def _lead(self, u: Inputs) -> None:
        p, s = self.parameters, self.state
        s.compensated_force, s.force_rate = phase_lead(
            u.measured_force, s.previous_measured, s.force_rate, p.sample_period, p.tau_s, p.lead_filter_time
        )
        s.previous_measured = u.measured_force

    def _new_frame(self, force: float) -> bool:
        return -int(math.copysign(1.0, force)) != self.state.contact_state

    def _enter(self, u: Inputs) -> None:
        self.state.contact_state = -int(math.copysign(1.0, u.measured_force))

    def _put_out(self, u: Inputs, active: float) -> None:
        p, s = self.parameters, self.state
        if p.mode == OFF:
            s.force = u.measured_force
        else:
            s.force = s.compensated_force if p.mode == LEAD else active


class ComplianceController(Fmi2Slave):
    """FMI side of the controller: variables, sample grid, checks."""

    description = "Active compliance control: phase lead, contact identification, force compensation; sampled"
    requirements = ("filterpy>=1.4.5", "numpy>=2.2")

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.parameters = Parameters()
        self.state = State()
        self.law: ComplianceLaw | None = None
        self.enumerations = {"mode": ("ControlMode", MODES)}
        self.type_attributes: dict[str, dict[str, str]] = {}
        for name, unit, nominal, meaning in (
            ("measured_force", "N", "100", "Reading of the force sensor"),
            ("position", "m", "0.01", "Position of the rod tip"),
            ("velocity", "m/s", "0.02", "Velocity of the rod tip"),
            ("desired_position", "m", "0.01", "Position of the satellite's rod tip, which the robot follows"),
            ("desired_velocity", "m/s", "0.02", "Velocity of the satellite's rod tip"),
        ):
            setattr(self, name, 0.0)
            self.type_attributes[name] = {"unit": unit, "nominal": nominal}
            self.register_variable(Real(name, causality=Fmi2Causality.input, description=meaning))
        for entry in fields(Parameters):
            register(self, entry, self.parameters, entry.name, Fmi2Causality.parameter, Fmi2Variability.fixed)
        for entry in fields(State):
            output = entry.metadata["kind"] == "output"
            name = entry.name if output else f"state.{entry.name}"
            causality = Fmi2Causality.output if output else Fmi2Causality.local
            register(self, entry, self.state, name, causality, Fmi2Variability.discrete)
        for index, (name, unit) in enumerate((("stiffness_estimate", "N/m"), ("damping_estimate", "N.s/m"))):
            self.type_attributes[name] = {"unit": unit}
            self.register_variable(
                Real(
                    name,
                    causality=Fmi2Causality.output,
                    variability=Fmi2Variability.discrete,
                    initial=Fmi2Initial.calculated,
                    description=f"Estimated contact {name.split('_')[0]}",
                    getter=lambda index=index: self._law().estimates()[index],
                )
            )
        # Outputs change at samples, inside a step: at a communication point none follows an input at once.
        outputs = ("force", "compensated_force", "contact_state", "innovation", "energy_error")
        self.dependencies = {name: () for name in (*outputs, "stiffness_estimate", "damping_estimate")}
        self.initial_dependencies = {
            "stiffness_estimate": ("initial_stiffness",),
            "damping_estimate": ("initial_damping",),
        }

    def _law(self) -> ComplianceLaw:
        if self.law is None:
            self.law = ComplianceLaw(self.parameters, self.state)
        return self.law

    def setup_experiment(self, start_time: float, stop_time: float | None, tolerance: float | None) -> None:
        """The sample grid begins at the start time; the first sample is one period later."""
        self.state.start_time = start_time

    def exit_initialization_mode(self) -> None:
        """Check the parameters. Raises: ValueError, which the FMI layer logs and turns into a status."""
        problems = self.parameters.problems()
        if problems:
            raise ValueError(f"{self.instance_name}: {problems}")
        self.law = None

    def _set_fmu_state(self, state: dict[str, Any]) -> None:
        super()._set_fmu_state(state)
        # It keeps numbers derived from the parameters, which may have changed.
        self.law = None

    def do_step(self, current_time: float, step_size: float) -> bool:
        """Advance to the end of the step, sampling there if a sample is due.

        Raises: ValueError, which the FMI layer logs and turns into a status, if the step leaves out a sample
            or the inputs are not finite. (Returning False would ask the master to end the simulation.)
        """
        if not sample_due(self, current_time, step_size):
            return True
        u = Inputs(
            self.measured_force, self.position, self.velocity, self.desired_position, self.desired_velocity
        )
        for name, value in u._asdict().items():
            require_finite(self, name, value, current_time + step_size)
        self._law().sample(u)
        return True
