"""Active compliance control of a docking simulator: phase lead, identification, force compensation.

Source of the equations: He, Shen, Gao, Zhang, "Active Compliance Control of a Position-Controlled
Industrial Robot for Simulating Space Operations". Signs and frames as in
modelica/DockingHIL/SignConventions.mo: forces act on the rod, positive towards the front frame; the front
frame pushes with a negative force. README.md beside this file tells which choices are ours and why.
"""

from __future__ import annotations

import math
from dataclasses import Field, dataclass, field, fields
from typing import Any, NamedTuple

import numpy as np
from pythonfmu import Boolean, Fmi2Causality, Fmi2Initial, Fmi2Slave, Fmi2Variability, Integer, Real

try:
    from filterpy.kalman import KalmanFilter
except ImportError as error:
    raise ImportError(
        "ComplianceController needs the Python package filterpy where it runs: pip install filterpy"
    ) from error

OFF, LEAD, ACTIVE = 1, 2, 3
MODES = {"off": OFF, "lead": LEAD, "active": ACTIVE}

# Below a thousandth of a newton of innovation the filter would weigh rounding errors.
MINIMUM_FORCE_VARIANCE = 1e-6
# Work is force times distance: near the turning point no force could restore it.
MINIMUM_SPEED_RATIO = 0.3
# An estimate this far below the initial one is noise; contact points are found by dividing by it.
MINIMUM_STIFFNESS_RATIO = 0.01
# Of a sample period: far above the rounding of a communication point's time, far below any step.
GRID_TOLERANCE = 1e-6


def quantity(default: Any, unit: str, description: str, kind: str = "local", **limits: str) -> Any:
    """A dataclass field that is an FMI variable: start value, unit, description, causality, min and max."""
    attributes = {"unit": unit, **limits} if unit else limits
    metadata = {"attributes": attributes, "description": description, "kind": kind}
    return field(default=default, metadata=metadata)


@dataclass
class Parameters:
    """What is set before initialisation; SI units."""

    mode: int = quantity(ACTIVE, "", "off: reading as it is; lead: sensor delay compensated; active: all")
    sample_period: float = quantity(5e-4, "s", "Sample period of the controller", min="0")
    tau_s: float = quantity(0.0, "s", "Sensor delay to compensate, Eq. (25)", min="0")
    lead_filter_time: float = quantity(1e-3, "s", "Time constant of the lead's filtered difference", min="0")
    transfer_delay: float = quantity(0.0, "s", "Age of the inputs when they are sampled", min="0")
    hold_compensation: bool = quantity(True, "", "Look half a sample period ahead for the output's hold")
    switching_compensation: bool = quantity(True, "", "Restore the work missed until contact is identified")
    contact_threshold: float = quantity(5.0, "N", "Measured force above which contact begins", min="0")
    release_threshold: float = quantity(2.5, "N", "Measured force below which contact ends", min="0")
    settling_time: float = quantity(6e-3, "s", "Time from onset until force samples are trusted", min="0")
    identification_period: float = quantity(1e-2, "s", "Interval of the increments, Eqs. (22)-(24)", min="0")
    initial_stiffness: float = quantity(1e5, "N/m", "Stiffness assumed before the first contact", min="0")
    initial_damping: float = quantity(0.0, "N.s/m", "Damping assumed before the first contact", min="0")
    stiffness_sigma: float = quantity(1e5, "N/m", "Standard deviation of the initial stiffness", min="0")
    stiffness_spread: float = quantity(
        0.01, "1", "Relative change of stiffness expected per contact", min="0"
    )
    damping_sigma: float = quantity(1000.0, "N.s/m", "Standard deviation of the initial damping", min="0")
    force_sigma: float = quantity(1.0, "N", "Standard deviation of force increments, initial guess", min="0")
    forgetting_factor: float = quantity(0.98, "1", "Sage-Husa forgetting factor b", min="0", max="1")
    restoration_time: float = quantity(5e-3, "s", "Time constant of restoring missed work", min="0")

    def problems(self) -> str:
        """Everything wrong with the values, each as a sentence: what, got, allowed; "" if nothing is."""
        names = ", ".join(f"{value} ({name})" for name, value in MODES.items())
        known = (self.mode == OFF) | (self.mode == LEAD) | (self.mode == ACTIVE)
        wrong, text = _problem(known, f"mode is {self.mode!r}; allowed: {names}")
        for entry in fields(self):
            wrong, more = self._limits(entry, wrong)
            text += more
        if not wrong:
            text = self._relations()
        return text

    def _limits(self, entry: Field, wrong: bool) -> tuple[bool, str]:
        """What is wrong with one value on its own."""
        value, unit = getattr(self, entry.name), entry.metadata["attributes"].get("unit")
        if unit and not (math.isfinite(value) and value >= 0.0):
            return _problem(
                False, f"{entry.name} is {value!r} {unit}; allowed: finite and not negative", wrong
            )
        positive = entry.name not in _POSITIVE or value != 0.0
        return _problem(positive, f"{entry.name} is {value!r} {unit}; allowed: above 0 {unit}", wrong)

    def _relations(self) -> str:
        """What is wrong with values next to others, once each on its own is right."""
        period = f"sample_period, {self.sample_period!r} s"
        ratio = self.identification_period / self.sample_period
        whole = (round(ratio) >= 1) & (abs(ratio - round(ratio)) <= GRID_TOLERANCE * ratio)
        wrong, text = False, ""
        for right, sentence in (
            (
                self.forgetting_factor < 1.0,
                f"forgetting_factor is {self.forgetting_factor!r}; allowed: above 0 and below 1",
            ),
            (
                self.release_threshold <= self.contact_threshold,
                f"release_threshold is {self.release_threshold!r} N; allowed: up to contact_threshold, "
                f"{self.contact_threshold!r} N",
            ),
            (
                whole,
                f"identification_period is {self.identification_period!r} s; allowed: a multiple of {period}",
            ),
            (
                self.restoration_time >= self.sample_period,
                f"restoration_time is {self.restoration_time!r} s; allowed: {period}, or more",
            ),
        ):
            wrong, more = _problem(right, sentence, wrong)
            text += more
        return text


def _problem(right: bool, sentence: str, wrong: bool = False) -> tuple[bool, str]:
    """Whether something is wrong by now, and the sentence if it is this; the native form asks at run time."""
    if right:
        return wrong, ""
    return True, f"; {sentence}" if wrong else sentence


_POSITIVE = (
    "sample_period",
    "contact_threshold",
    "initial_stiffness",
    "force_sigma",
    "forgetting_factor",
    "restoration_time",
)


@dataclass
class State:
    """Everything that changes from sample to sample: FMU state is made of these."""

    force: float = quantity(0.0, "N", "Force on the satellite, held between samples", "output")
    compensated_force: float = quantity(0.0, "N", "Measured force after the phase lead, F_S", "output")
    contact_state: int = quantity(0, "", "Frame touched: 1 front, -1 rear, 0 none", "output")
    innovation: float = quantity(0.0, "N", "Latest innovation of the Kalman filter", "output")
    energy_error: float = quantity(0.0, "J", "Work done on the satellite beyond the contact law's", "output")

    start_time: float = quantity(0.0, "s", "Start time, where the sample grid begins")
    samples: int = quantity(0, "", "Samples taken; the next: start_time + (samples + 1)*sample_period")
    previous_measured: float = quantity(0.0, "N", "Measured force one sample ago")
    force_rate: float = quantity(0.0, "N/s", "Filtered difference of the measured force")

    stiffness: float = quantity(0.0, "N/m", "Kalman filter: stiffness")
    damping: float = quantity(0.0, "N.s/m", "Kalman filter: damping")
    p_kk: float = quantity(0.0, "N2/m2", "Kalman filter: variance of the stiffness")
    p_kc: float = quantity(0.0, "N2.s/m2", "Kalman filter: covariance of stiffness and damping")
    p_cc: float = quantity(0.0, "N2.s2/m2", "Kalman filter: variance of the damping")
    q_kk: float = quantity(0.0, "N2/m2", "Sage-Husa: process noise of the stiffness")
    q_cc: float = quantity(0.0, "N2.s2/m2", "Sage-Husa: process noise of the damping")
    r: float = quantity(0.0, "N2", "Sage-Husa: measurement noise")
    updates: int = quantity(0, "", "Updates of the Kalman filter")

    contact_samples: int = quantity(0, "", "Samples since the onset of this contact")
    block_samples: int = quantity(0, "", "Samples in the running identification interval")
    block_force: float = quantity(0.0, "N", "Sum of F_S over the running interval")
    block_position: float = quantity(0.0, "m", "Sum of the rod's position over the running interval")
    block_velocity: float = quantity(0.0, "m/s", "Sum of the rod's velocity over the running interval")
    blocks: int = quantity(0, "", "Identification intervals completed in this contact")
    previous_force: float = quantity(0.0, "N", "Mean of F_S over the previous interval")
    previous_position: float = quantity(0.0, "m", "Mean of the rod's position over the previous interval")
    previous_velocity: float = quantity(0.0, "m/s", "Mean of the rod's velocity over the previous interval")
    anchor_force: float = quantity(0.0, "N", "Mean of F_S over the first interval of this contact")
    anchor_position: float = quantity(0.0, "m", "Mean of the rod's position over the first interval")
    anchor_velocity: float = quantity(0.0, "m/s", "Mean of the rod's velocity over the first interval")

    onset_position: float = quantity(0.0, "m", "Desired position when contact was detected")
    onset_velocity: float = quantity(0.0, "m/s", "Desired velocity when contact was detected")
    onset_path: float = quantity(0.0, "m2/s", "Desired velocity integrated over distance until settled")
    settled_position: float = quantity(0.0, "m", "Desired position when the force had settled")
    applied_work: float = quantity(0.0, "J", "Work of the output force since detection")
    sensed_work: float = quantity(0.0, "J", "Work of F_S since settled, where the contact law pushes")
    stretch_work: float = quantity(0.0, "m2", "Position error integrated over distance since settled")
    stretch_rate_work: float = quantity(0.0, "m2/s", "Velocity error integrated over distance since settled")
    held_position: float = quantity(0.0, "m", "Desired position one sample ago")
    held_velocity: float = quantity(0.0, "m/s", "Desired velocity one sample ago")
    held_sensed: float = quantity(0.0, "N", "F_S one sample ago, 0 where the law would pull")
    held_stretch: float = quantity(0.0, "m", "Position error one sample ago, 0 where the law would pull")
    held_stretch_rate: float = quantity(0.0, "m/s", "Velocity error one sample ago, 0 where it would pull")


class Inputs(NamedTuple):
    """Inputs at one sample: force [N], positions [m], velocities [m/s]; desired ones are the satellite's."""

    measured_force: float
    position: float
    velocity: float
    desired_position: float
    desired_velocity: float


def phase_lead(
    force: float, previous_force: float, rate: float, sample_period: float, tau_s: float, filter_time: float
) -> tuple[float, float]:
    """Compensate the sensor delay by a phase lead, Eq. (25).

    Printed as G(s) = 1 + tau_s; implemented as 1 + tau_s*s, which is dimensionless. The derivative is a
    backward difference through a first-order low-pass: a bare difference would multiply noise by tau_s/T.

    Args:
        force: measured force now [N].
        previous_force: measured force one sample ago [N].
        rate: filtered difference one sample ago [N/s].
        sample_period: T [s].
        tau_s: sensor delay [s].
        filter_time: time constant of the low-pass [s]; 0 for the bare difference.
    Returns: compensated force F_S [N] and filtered difference [N/s].
    """
    keep = math.exp(-sample_period / filter_time) if filter_time > 0.0 else 0.0
    rate = keep * rate + (1.0 - keep) * (force - previous_force) / sample_period
    return force + tau_s * rate, rate


class SageHusaFilter:
    """Sage-Husa adaptive Kalman filter for X = [k_d, c_d], Eq. (26), with A = G = I.

    z = H X + V with z = Delta F_S [N] and H = [-Delta p, -Delta v] ([m], [m/s]): the frame pushes back.
    Noise statistics are estimated with the fading weight d = (1 - b)/(1 - b^n): R from the residual, which
    keeps it positive, Q from the correction, with negative variances cut off and without cross terms. The
    noise means of the full Sage-Husa scheme are taken as zero: in a steady compression they could not be
    told from the signal.
    """

    def __init__(self, state: State, forgetting_factor: float) -> None:
        self.state = state
        self.forgetting_factor = forgetting_factor
        self._filter = KalmanFilter(dim_x=2, dim_z=1)

    def update(self, force_step: float, position_step: float, velocity_step: float) -> None:
        """Take in one increment of force [N], position [m] and velocity [m/s], Eqs. (22) to (24).

        All that is remembered lies in `state`; filterpy's object is only the calculator.
        """
        s, kalman = self.state, self._filter
        prior = np.array([[s.p_kk, s.p_kc], [s.p_kc, s.p_cc]])
        process = np.array([s.q_kk, s.q_cc])
        kalman.x = np.array([[s.stiffness], [s.damping]])
        kalman.P = prior
        kalman.predict(Q=np.diag(process))
        observation = np.array([[-position_step, -velocity_step]])
        kalman.update(np.array([[force_step]]), R=np.array([[s.r]]), H=observation)
        posterior = 0.5 * (kalman.P + kalman.P.T)
        innovation = float(kalman.y[0, 0])
        residual = force_step - (observation @ kalman.x).item()

        b = self.forgetting_factor
        weight = (1.0 - b) / (1.0 - b ** (s.updates + 2))
        # The diagonal of K y y' K' + P - A P_previous A'.
        correction = kalman.K[:, 0] * innovation
        process = (1.0 - weight) * process + weight * (correction**2 + np.diag(posterior) - np.diag(prior))
        explained = (observation @ posterior @ observation.T).item()
        noise = (1.0 - weight) * s.r + weight * (residual**2 + explained)

        s.stiffness, s.damping = float(kalman.x[0, 0]), float(kalman.x[1, 0])
        s.p_kk, s.p_kc, s.p_cc = float(posterior[0, 0]), float(posterior[0, 1]), float(posterior[1, 1])
        s.q_kk, s.q_cc = max(0.0, float(process[0])), max(0.0, float(process[1]))
        s.r = max(MINIMUM_FORCE_VARIANCE, float(noise))
        s.innovation = innovation
        s.updates += 1


class ComplianceLaw:
    """The controller's algorithm: one call of `sample` per sample period; all memory lies in `state`."""

    def __init__(self, parameters: Parameters, state: State) -> None:
        self.parameters = parameters
        self.state = state
        self.filter = SageHusaFilter(state, parameters.forgetting_factor)
        self.block_length = round(parameters.identification_period / parameters.sample_period)
        settling = parameters.settling_time / parameters.sample_period
        self.settling_samples = math.ceil(settling - GRID_TOLERANCE)
        # The output is held for a period, so on average it is applied half a period late.
        self.look_ahead = 0.5 * parameters.sample_period if parameters.hold_compensation else 0.0

    def sample(self, u: Inputs) -> float:
        """Take one sample of the inputs; return the force on the satellite [N] until the next."""
        p, s = self.parameters, self.state
        # The satellite has moved on since the inputs left it; work is booked where it is now.
        u = u._replace(desired_position=u.desired_position + u.desired_velocity * p.transfer_delay)
        if s.samples == 0:
            self._start(u)
        s.samples += 1
        s.compensated_force, s.force_rate = phase_lead(
            u.measured_force, s.previous_measured, s.force_rate, p.sample_period, p.tau_s, p.lead_filter_time
        )
        s.previous_measured = u.measured_force
        self._track_contact(u)
        if s.contact_state:
            self._identify(u)
            active = self._compensate(u)
        else:
            active = 0.0
        if p.mode == OFF:
            s.force = u.measured_force
        else:
            s.force = s.compensated_force if p.mode == LEAD else active
        if s.contact_state:
            s.held_position, s.held_velocity = u.desired_position, u.desired_velocity
            s.contact_samples += 1
        return s.force

    def estimates(self) -> tuple[float, float]:
        """Stiffness [N/m] and damping [N.s/m]: the initial ones until the first sample."""
        if self.state.samples == 0:
            return self.parameters.initial_stiffness, self.parameters.initial_damping
        return self.state.stiffness, self.state.damping

    def _start(self, u: Inputs) -> None:
        p, s = self.parameters, self.state
        s.stiffness, s.damping = p.initial_stiffness, p.initial_damping
        s.p_kk, s.p_cc = p.stiffness_sigma**2, p.damping_sigma**2
        s.r = p.force_sigma**2
        s.previous_measured = u.measured_force

    def _track_contact(self, u: Inputs) -> None:
        """Contact begins and ends with the measured force; the lead's transients have no say in it."""
        p, s = self.parameters, self.state
        frame = -int(math.copysign(1.0, u.measured_force))
        if abs(u.measured_force) > p.contact_threshold and frame != s.contact_state:
            s.contact_state = frame
            if s.updates:
                # Another frame or another spot may be stiffer; a filter grown certain would not notice.
                s.p_kk += (p.stiffness_spread * s.stiffness) ** 2
            s.contact_samples = s.block_samples = s.blocks = 0
            s.block_force = s.block_position = s.block_velocity = 0.0
            s.onset_position, s.onset_velocity = u.desired_position, u.desired_velocity
            s.onset_path = s.energy_error = 0.0
            s.applied_work = s.sensed_work = s.stretch_work = s.stretch_rate_work = 0.0
        elif abs(u.measured_force) < p.release_threshold:
            s.contact_state = 0

    def _identify(self, u: Inputs) -> None:
        """Collect settled samples of this contact; feed the filter with increments of their means.

        Means over an interval obey the same linear law as single samples, at a fraction of the noise.
        """
        p, s = self.parameters, self.state
        pushing = -s.contact_state * s.compensated_force
        if s.contact_samples < self.settling_samples or pushing <= p.contact_threshold:
            return
        s.block_force += s.compensated_force
        s.block_position += u.position
        s.block_velocity += u.velocity
        s.block_samples += 1
        if s.block_samples < self.block_length:
            return
        force, position, velocity = (
            total / self.block_length for total in (s.block_force, s.block_position, s.block_velocity)
        )
        if s.blocks == 0:
            s.anchor_force, s.anchor_position, s.anchor_velocity = force, position, velocity
        else:
            self.filter.update(
                force - s.previous_force, position - s.previous_position, velocity - s.previous_velocity
            )
        s.previous_force, s.previous_position, s.previous_velocity = force, position, velocity
        s.blocks += 1
        s.block_samples = 0
        s.block_force = s.block_position = s.block_velocity = 0.0

    def _compensate(self, u: Inputs) -> float:
        """Eqs. (27) to (29) during contact, plus what restores the work missed at onset; never a pull."""
        p, s = self.parameters, self.state
        stiffness = max(s.stiffness, MINIMUM_STIFFNESS_RATIO * p.initial_stiffness)
        damping = max(s.damping, 0.0)
        self._book_work(u)
        stretch = u.desired_position + u.desired_velocity * self.look_ahead - u.position
        stretch_rate = u.desired_velocity - u.velocity
        force = s.compensated_force - stiffness * stretch - damping * stretch_rate
        pushing = s.contact_state * force < 0.0
        # Where the law would pull, the desired rod has left the frame, though the real one has not yet.
        s.held_sensed, s.held_stretch, s.held_stretch_rate = (
            (s.compensated_force, stretch, stretch_rate) if pushing else (0.0, 0.0, 0.0)
        )
        if not pushing:
            return 0.0
        if s.blocks == 0:
            return force
        s.energy_error = s.applied_work - self._law_work(stiffness, damping)
        fast_enough = abs(u.desired_velocity) > MINIMUM_SPEED_RATIO * abs(s.onset_velocity)
        if p.switching_compensation and fast_enough:
            restoring = -s.energy_error / (u.desired_velocity * p.restoration_time)
            # At most as much again as the contact law asks for, so that the force stays a push.
            force += min(max(restoring, -abs(force)), abs(force))
        return force

    def _book_work(self, u: Inputs) -> None:
        """Book the work over the period that ends now; the output was held, so this is exact."""
        s = self.state
        if s.contact_samples == 0:
            s.settled_position = u.desired_position
            return
        distance = u.desired_position - s.held_position
        s.applied_work += s.force * distance
        if s.contact_samples <= self.settling_samples:
            s.onset_path += 0.5 * (s.held_velocity + u.desired_velocity) * distance
            s.settled_position = u.desired_position
        else:
            s.sensed_work += s.held_sensed * distance
            s.stretch_work += s.held_stretch * distance
            s.stretch_rate_work += s.held_stretch_rate * distance

    def _law_work(self, stiffness: float, damping: float) -> float:
        """Work [J] that the contact law, with the present estimates, would have done on the satellite.

        From the contact point to where the force had settled it is the spring's and the damper's, of the
        desired motion; from there on that of Eq. (29). The contact point follows from the first interval.
        """
        s = self.state
        contact_point = s.anchor_position + (s.anchor_force + damping * s.anchor_velocity) / stiffness
        depth = max(0.0, s.contact_state * (s.settled_position - contact_point))
        undetected = max(0.0, s.contact_state * (s.onset_position - contact_point))
        loss = damping * (abs(s.onset_velocity) * undetected + s.onset_path)
        return (
            s.sensed_work
            - 0.5 * stiffness * depth**2
            - loss
            - stiffness * s.stretch_work
            - damping * s.stretch_rate_work
        )


class ComplianceController(Fmi2Slave):
    """FMI side of the controller: variables, sample grid, checks."""

    description = "Active compliance control: phase lead, contact identification, force compensation; sampled"
    requirements = ("filterpy", "numpy")

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
            self._register(entry, self.parameters, entry.name, Fmi2Causality.parameter, Fmi2Variability.fixed)
        for entry in fields(State):
            output = entry.metadata["kind"] == "output"
            name = entry.name if output else f"state.{entry.name}"
            causality = Fmi2Causality.output if output else Fmi2Causality.local
            self._register(entry, self.state, name, causality, Fmi2Variability.discrete)
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

    def _register(
        self, entry: Field, owner: Any, name: str, causality: Fmi2Causality, variability: Fmi2Variability
    ) -> None:
        kind = {"float": Real, "int": Integer, "bool": Boolean}[entry.type]
        initial = None if causality is Fmi2Causality.parameter else Fmi2Initial.exact
        self.type_attributes[name] = dict(entry.metadata["attributes"])
        self.register_variable(
            kind(
                name,
                causality=causality,
                variability=variability,
                initial=initial,
                description=entry.metadata["description"],
                getter=lambda: getattr(owner, entry.name),
                setter=lambda value: setattr(owner, entry.name, value),
            )
        )

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
        p, s = self.parameters, self.state
        end = current_time + step_size
        elapsed = end - s.start_time
        index = round(elapsed / p.sample_period)
        on_grid = abs(elapsed - index * p.sample_period) <= GRID_TOLERANCE * p.sample_period
        reached = index if on_grid else math.floor(elapsed / p.sample_period)
        if reached <= s.samples:
            return True
        if not on_grid or reached > s.samples + 1:
            due = s.start_time + (s.samples + 1) * p.sample_period
            raise ValueError(
                f"{self.instance_name}: the step from {current_time:.9g} s to {end:.9g} s passes over the "
                f"sample at {due:.9g} s; steps have to end at every multiple of sample_period, "
                f"{p.sample_period:.9g} s: take a step size that divides it, or set sample_period to the "
                "step size"
            )
        u = Inputs(
            self.measured_force, self.position, self.velocity, self.desired_position, self.desired_velocity
        )
        for name, value in u._asdict().items():
            if not math.isfinite(value):
                unit = self.type_attributes[name]["unit"]
                raise ValueError(
                    f"{self.instance_name}: input {name} is {value!r} {unit} at {end:.9g} s; a finite number "
                    "is needed. Look at what is connected to it"
                )
        self._law().sample(u)
        return True
