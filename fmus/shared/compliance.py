"""What the compliance controllers are set to and what they remember."""

from __future__ import annotations

import math
from dataclasses import Field, dataclass, fields

from shared.fields import problem, quantity
from shared.sampling import GRID_TOLERANCE

OFF, LEAD, ACTIVE = 1, 2, 3
MODES = {"off": OFF, "lead": LEAD, "active": ACTIVE}


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
        wrong, text = problem(known, f"mode is {self.mode!r}; allowed: {names}")
        for entry in fields(Parameters):
            wrong, more = self._limits(entry, wrong)
            text += more
        if not wrong:
            text = self._relations()
        return text

    def _limits(self, entry: Field, wrong: bool) -> tuple[bool, str]:
        """What is wrong with one value on its own."""
        value, unit = getattr(self, entry.name), entry.metadata["attributes"].get("unit")
        if unit and not (math.isfinite(value) and value >= 0.0):
            return problem(
                False, f"{entry.name} is {value!r} {unit}; allowed: finite and not negative", wrong
            )
        positive = entry.name not in _POSITIVE or value != 0.0
        return problem(positive, f"{entry.name} is {value!r} {unit}; allowed: above 0 {unit}", wrong)

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
            wrong, more = problem(right, sentence, wrong)
            text += more
        return text


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
