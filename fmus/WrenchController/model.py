"""Active compliance control in space: the whole of the source's Fig. 5.

Source of the equations: He, Shen, Gao, Zhang, "Active Compliance Control of a Position-Controlled
Industrial Robot for Simulating Space Operations". Poses are those of O_u in O_t, wrenches act on the rod;
README.md beside this file tells the frames, which choices are ours, and why.
"""

from __future__ import annotations

import math
from dataclasses import Field, dataclass, field, fields
from typing import Any, NamedTuple

from pythonfmu import Fmi2Causality, Fmi2Initial, Fmi2Slave, Fmi2Variability, Real
from shared.compliance import LEAD, MODES, OFF, Parameters, State
from shared.compliance_law import ContactLaw
from shared.fields import problem, quantity, register
from shared.sage_husa import phase_lead
from shared.sampling import sample_due
from shared.vectors import UPRIGHT, ZERO, Quaternion, Vector, cross, dot, norm_squared, turned, turned_back

# A quaternion shorter than this is not one: it says nothing about an orientation.
SHORTEST_QUATERNION = 1e-3


def spatial(name: str) -> Any:
    """The field of State of this name, as a vector."""
    (entry,) = (entry for entry in fields(State) if entry.name == name)
    return field(default=ZERO, metadata=entry.metadata)


@dataclass
class WrenchParameters(Parameters):
    """Those of the law on a line, and where things are."""

    normal_time: float = quantity(5e-3, "s", "Time constant of the contact normal's average", min="0")
    tip: Vector = quantity(ZERO, "m", "Rod tip in O_u")
    sensor_position: Vector = quantity(ZERO, "m", "Origin of O_sg in O_t")
    sensor_orientation: Quaternion = quantity(UPRIGHT, "1", "Orientation of O_sg in O_t")

    def all_problems(self) -> str:
        """As `problems`, with the parameters of this class."""
        text = self.problems()
        wrong = len(text) > 0
        for name, unit in (("tip", "m"), ("sensor_position", "m")):
            value = getattr(self, name)
            wrong, more = problem(
                math.isfinite(dot(value, value)),
                f"{name} is ({value.x!r}, {value.y!r}, {value.z!r}) {unit}; allowed: finite",
                wrong,
            )
            text += more
        wrong, more = problem(
            math.isfinite(self.normal_time) & (self.normal_time >= 0.0),
            f"normal_time is {self.normal_time!r} s; allowed: finite and not negative",
            wrong,
        )
        text += more
        square = norm_squared(self.sensor_orientation)
        wrong, more = problem(
            abs(square - 1.0) <= 1e-9,
            f"sensor_orientation has the squared length {square!r}; allowed: 1, a unit quaternion w, x, y, z",
            wrong,
        )
        return text + more


@dataclass
class WrenchState(State):
    """That of the law on a line, vectors in the place of numbers; all resolved in O_sg, about its origin."""

    force: Vector = spatial("force")
    compensated_force: Vector = spatial("compensated_force")
    previous_measured: Vector = spatial("previous_measured")
    force_rate: Vector = spatial("force_rate")
    block_force: Vector = spatial("block_force")
    block_position: Vector = spatial("block_position")
    block_velocity: Vector = spatial("block_velocity")
    previous_force: Vector = spatial("previous_force")
    previous_position: Vector = spatial("previous_position")
    previous_velocity: Vector = spatial("previous_velocity")
    anchor_force: Vector = spatial("anchor_force")
    anchor_position: Vector = spatial("anchor_position")
    anchor_velocity: Vector = spatial("anchor_velocity")
    onset_position: Vector = spatial("onset_position")
    onset_velocity: Vector = spatial("onset_velocity")
    settled_position: Vector = spatial("settled_position")
    held_position: Vector = spatial("held_position")
    held_velocity: Vector = spatial("held_velocity")
    held_sensed: Vector = spatial("held_sensed")
    held_stretch: Vector = spatial("held_stretch")
    held_stretch_rate: Vector = spatial("held_stretch_rate")

    torque: Vector = quantity(ZERO, "N.m", "Torque on the satellite, held between samples", "output")
    compensated_torque: Vector = quantity(ZERO, "N.m", "Measured torque after the phase lead, M_S", "output")
    normal: Vector = quantity(ZERO, "1", "Contact normal e, towards the rod; zero without contact", "output")
    previous_torque: Vector = quantity(ZERO, "N.m", "Measured torque one sample ago")
    torque_rate: Vector = quantity(ZERO, "N.m/s", "Filtered difference of the measured torque")
    mean_force: Vector = quantity(ZERO, "N", "Measured force, averaged; the normal is its direction")


class WrenchInputs(NamedTuple):
    """Inputs at one sample, in O_sg: wrench [N], [N.m], rod tip [m], [m/s], and the satellite's rod tip."""

    measured_force: Vector
    measured_torque: Vector
    position: Vector
    velocity: Vector
    desired_position: Vector
    desired_velocity: Vector


class WrenchLaw(ContactLaw):
    """The law along the contact normal in space, and the torque."""

    nothing: Any = ZERO

    def _along(self, value: Vector, direction: Vector) -> float:
        return dot(value, direction)

    def _size(self, force: Vector) -> float:
        return math.sqrt(dot(force, force))

    def _outward(self) -> Vector:
        return self.state.normal * -1.0

    def _axis(self) -> Vector:
        return self._outward()

    def _lead(self, u: WrenchInputs) -> None:
        """Eq. (25) for each component."""
        p, s = self.parameters, self.state
        if s.samples == 1:
            s.previous_torque = u.measured_torque
        s.compensated_force, s.force_rate = phase_lead(
            u.measured_force, s.previous_measured, s.force_rate, p.sample_period, p.tau_s, p.lead_filter_time
        )
        s.compensated_torque, s.torque_rate = phase_lead(
            u.measured_torque, s.previous_torque, s.torque_rate, p.sample_period, p.tau_s, p.lead_filter_time
        )
        s.previous_measured, s.previous_torque = u.measured_force, u.measured_torque

    def _new_frame(self, force: Vector) -> bool:
        return (self.state.contact_state == 0) | (dot(force, self.state.normal) < 0.0)

    def _enter(self, u: WrenchInputs) -> None:
        self.state.contact_state = 1
        self.state.mean_force = u.measured_force

    def _track_contact(self, u: WrenchInputs) -> None:
        """As on a line; and the normal, the direction of the measured force, averaged against noise."""
        p, s = self.parameters, self.state
        ContactLaw._track_contact(self, u)
        if s.contact_state == 0:
            s.normal = ZERO
            return
        if self._size(u.measured_force) > p.contact_threshold:
            keep = math.exp(-p.sample_period / p.normal_time) if p.normal_time > 0.0 else 0.0
            s.mean_force = keep * s.mean_force + (1.0 - keep) * u.measured_force
        s.normal = s.mean_force / self._size(s.mean_force)

    def _put_out(self, u: WrenchInputs, active: Vector) -> None:
        p, s = self.parameters, self.state
        if p.mode == OFF:
            s.force, s.torque = u.measured_force, u.measured_torque
        elif p.mode == LEAD:
            s.force, s.torque = s.compensated_force, s.compensated_torque
        else:
            s.force, s.torque = active, self._torque(u, active)

    def _torque(self, u: WrenchInputs, force: Vector) -> Vector:
        """Eq. (30): the moment that the compensated force has at the desired contact point [N.m].

        With the origin at O_S, (r_des - r) x F_comp + r x (F_comp - F_S) is what has to be added to
        r x F_S to get r_des x F_comp; the source prints a minus before the second term.
        """
        s = self.state
        if dot(force, force) == 0.0:
            return ZERO
        change = cross(self._ahead(u) - u.position, force) + cross(u.position, force - s.compensated_force)
        return s.compensated_torque + change


INPUTS = (
    ("measured_force", ZERO, "N", "100", "Reading of the sensor: force on the rod, in O_sg"),
    ("measured_torque", ZERO, "N.m", "10", "Reading of the sensor: moment about O_sg's origin, in O_sg"),
    ("position", ZERO, "m", "0.01", "Position of O_u in O_t"),
    ("orientation", UPRIGHT, "1", "0.1", "Orientation of O_u in O_t"),
    ("velocity", ZERO, "m/s", "0.02", "Velocity of O_u in O_t"),
    ("angular_velocity", ZERO, "rad/s", "0.01", "Angular velocity of O_u in O_t"),
    ("desired_position", ZERO, "m", "0.01", "Position of O_Ai in O_Bi, which the robot follows"),
    ("desired_orientation", UPRIGHT, "1", "0.1", "Orientation of O_Ai in O_Bi"),
    ("desired_velocity", ZERO, "m/s", "0.02", "Velocity of O_Ai in O_Bi"),
    ("desired_angular_velocity", ZERO, "rad/s", "0.01", "Angular velocity of O_Ai in O_Bi"),
)


class WrenchController(Fmi2Slave):
    """FMI side of the controller: variables, frames, sample grid, checks."""

    description = "Active compliance control in space: force and torque compensation along the contact normal"
    requirements = ("filterpy>=1.4.5", "numpy>=2.2")

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.parameters = WrenchParameters()
        self.state = WrenchState()
        self.law: WrenchLaw | None = None
        self.enumerations = {"mode": ("ControlMode", MODES)}
        self.type_attributes: dict[str, dict[str, str]] = {}
        for name, start, unit, nominal, meaning in INPUTS:
            setattr(self, name, start)
            register(
                self, _input(name, start, unit, nominal, meaning), self, name, Fmi2Causality.input,
                Fmi2Variability.continuous,
            )  # fmt: skip
        for entry in fields(WrenchParameters):
            register(self, entry, self.parameters, entry.name, Fmi2Causality.parameter, Fmi2Variability.fixed)
        outputs = []
        for entry in fields(WrenchState):
            output = entry.metadata["kind"] == "output"
            name = entry.name if output else f"state.{entry.name}"
            causality = Fmi2Causality.output if output else Fmi2Causality.local
            register(self, entry, self.state, name, causality, Fmi2Variability.discrete)
            if output:
                outputs += [name] if entry.type != "Vector" else [f"{name}[{i}]" for i in (1, 2, 3)]
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
        self.dependencies = {name: () for name in (*outputs, "stiffness_estimate", "damping_estimate")}
        self.initial_dependencies = {
            "stiffness_estimate": ("initial_stiffness",),
            "damping_estimate": ("initial_damping",),
        }

    def _law(self) -> WrenchLaw:
        if self.law is None:
            self.law = WrenchLaw(self.parameters, self.state)
        return self.law

    def setup_experiment(self, start_time: float, stop_time: float | None, tolerance: float | None) -> None:
        """The sample grid begins at the start time; the first sample is one period later."""
        self.state.start_time = start_time

    def exit_initialization_mode(self) -> None:
        """Check the parameters. Raises: ValueError, which the FMI layer logs and turns into a status."""
        problems = self.parameters.all_problems()
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
        end = current_time + step_size
        wrong, text = self._input_problems()
        if wrong:
            raise ValueError(f"{self.instance_name}: at {end:.9g} s {text}. Look at what is connected to it")
        place, speed = self._tip(self.position, self.orientation, self.velocity, self.angular_velocity)
        desired_place, desired_speed = self._tip(
            self.desired_position, self.desired_orientation, self.desired_velocity,
            self.desired_angular_velocity,
        )  # fmt: skip
        self._law().sample(
            WrenchInputs(
                self.measured_force, self.measured_torque, place, speed, desired_place, desired_speed
            )
        )
        return True

    def _input_problems(self) -> tuple[bool, str]:
        """Whether something is wrong with the inputs, and what."""
        wrong, text = False, ""
        for name, start, unit, *_ in INPUTS:
            value = getattr(self, name)
            for place, number in enumerate(value):
                sentence = f"input {name}[{place + 1}] is {number!r} {unit}; allowed: finite"
                wrong, more = problem(math.isfinite(number), sentence, wrong)
                text += more
            if len(start) == 4:
                square = norm_squared(value)
                long_enough = square >= SHORTEST_QUATERNION * SHORTEST_QUATERNION
                sentence = f"input {name} has the squared length {square!r}; allowed: 1, a unit quaternion"
                wrong, more = problem(long_enough, sentence, wrong)
                text += more
        return wrong, text

    def _tip(self, position: Vector, orientation: Quaternion, velocity: Vector, spin: Vector) -> Any:
        """Place and velocity of the rod tip, from O_sg and resolved in it."""
        p = self.parameters
        arm = turned(orientation, p.tip)
        place = turned_back(p.sensor_orientation, position + arm - p.sensor_position)
        return place, turned_back(p.sensor_orientation, velocity + cross(spin, arm))


def _input(name: str, start: Any, unit: str, nominal: str, meaning: str) -> Field:
    """An input as a field, so that it is registered like the others."""
    made = quantity(start, unit, meaning, nominal=nominal)
    made.name, made.type = name, type(start).__name__
    return made
