"""First-order force compensation of a known delay, designed for an undamped elastic contact.

After Osaki, Konno, Uchiyama, "Delay time compensation based on coefficient of restitution for collision
hybrid motion simulator": uniform motion while the force is delayed, a spring from then on, and a gain such
that the rebound has the restitution asked for. Signs and frames as in
modelica/DockingHIL/SignConventions.mo. README.md beside this file tells what of the law is ours.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from pythonfmu import Fmi2Slave
from shared.fields import problem
from shared.line import (
    POSITIVE,
    Inputs,
    LineParameters,
    LineState,
    inputs_due,
    limits_kept,
    only_push,
    parameter,
    refuse,
    remembered,
    sampled,
    set_up,
)

# The frequency's correction is of the order of (omega delay)^2: each round shrinks its error by that.
ROUNDS = 30


@dataclass
class Parameters(LineParameters):
    """What is set before initialisation; SI units."""

    mass: float = parameter(279.06976744186045, "kg", "Effective mass of the satellites", POSITIVE)
    stiffness: float = parameter(176e3, "N/m", "Stiffness that the gain is designed for", POSITIVE)
    delay: float = parameter(5.4e-3, "s", "Delay from desired motion to measured force")
    restitution: float = parameter(1.0, "1", "Coefficient of restitution asked for", POSITIVE)


@dataclass
class State(LineState):
    """Everything that changes from sample to sample."""

    previous_force: float = remembered(0.0, "N", "Measured force one sample ago")
    lead_time: float = remembered(0.0, "s", "Lead time that the design gives")


def design(p: Parameters) -> tuple[bool, float]:
    """The lead time of 1 + T_c s that gives the restitution asked for.

    In contact m s^2 + k (1 + T_c s) exp(-s T) = 0, T the delay and half a sample period of hold. A contact is
    half a cycle, so s = omega (j - d) with d = -ln(e')/pi gives a rebound of e' times the speed. While the
    force is delayed, the rod moves on by v T for nothing: the energy k (v T)^2/2 is not taken out, and e' is
    the restitution over sqrt(1 + k T^2/m).

    Returns: whether there is one, and T_c [s].
    """
    delay = p.delay + 0.5 * p.sample_period
    natural = math.sqrt(p.stiffness / p.mass)
    goal = p.restitution / math.sqrt(1.0 + (natural * delay) ** 2)
    d = -math.log(goal) / math.pi
    omega, right = natural, True
    for _ in range(ROUNDS):
        real, imaginary = _quotient(omega * delay, d)
        excess = real + d * imaginary
        right = right & (excess > 0.0)
        omega = natural / math.sqrt(max(excess, 1e-3))
    _, imaginary = _quotient(omega * delay, d)
    return right, imaginary * omega / (natural * natural)


def _quotient(angle: float, d: float) -> tuple[float, float]:
    """-(s/omega)^2 exp(s T) for s = omega (j - d), omega T = angle: real and imaginary part."""
    size = math.exp(-d * angle)
    a, b = 1.0 - d * d, 2.0 * d
    return (
        size * (a * math.cos(angle) - b * math.sin(angle)),
        size * (a * math.sin(angle) + b * math.cos(angle)),
    )


def checked(p: Parameters) -> tuple[bool, str]:
    """Whether something is wrong with the parameters, and what, as sentences."""
    wrong, text = limits_kept(p)
    if wrong:
        return wrong, text
    right, _ = design(p)
    return problem(
        right,
        f"no lead time compensates a delay of {p.delay!r} s at {p.stiffness!r} N/m and {p.mass!r} kg for a "
        f"restitution of {p.restitution!r}; allowed: a delay well below a quarter of the cycle of contact",
    )


def sample(p: Parameters, s: State, u: Inputs) -> None:
    """Take one sample: force = F + T_c dF/dt by a backward difference, and never a pull."""
    if s.samples == 1:
        s.lead_time = design(p)[1]
        s.previous_force = u.measured_force
    rate = (u.measured_force - s.previous_force) / p.sample_period
    s.previous_force = u.measured_force
    s.force = only_push(u.measured_force + s.lead_time * rate, u.measured_force)


class OsakiCompensation(Fmi2Slave):
    """FMI side of the controller."""

    description = (
        "First-order force compensation designed for the restitution of an undamped contact; sampled"
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
        refuse(self, *checked(self.parameters))

    def do_step(self, current_time: float, step_size: float) -> bool:
        """Advance to the end of the step, sampling there if a sample is due. Raises: as `inputs_due`."""
        if inputs_due(self, current_time, step_size):
            sample(self.parameters, self.state, sampled(self))
        return True
