"""Satellite software of the docking lab: relative motion of two satellites, computed once per tick.

Signs and frames as in modelica/DockingHIL/SignConventions.mo: the force acts on the rod, so on the relative
motion, positive towards the front frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any

from pythonfmu import Fmi2Causality, Fmi2Initial, Fmi2Slave, Fmi2Variability, Real
from shared.fields import quantity, register
from shared.sampling import require_finite, sample_due

SUBSTEPS = 4


@dataclass
class Parameters:
    """What is set before initialisation; SI units."""

    mass: float = quantity(300.0 * 4000.0 / 4300.0, "kg", "Effective mass m_s m_t/(m_s + m_t)", min="0")
    sample_period: float = quantity(1e-3, "s", "Tick of the software", min="0")
    drag: float = quantity(0.0, "N.s/m", "Force against the velocity, over the velocity")
    cable_stiffness: float = quantity(0.0, "N/m", "Force towards the position 0, over the position")
    hanging_share: float = quantity(0.0, "1", "Share of the mass that hangs on a spring", min="0")
    hanging_frequency: float = quantity(25.0, "rad/s", "Natural frequency of that spring, body held", min="0")
    hanging_damping: float = quantity(0.01, "1", "Its damping ratio", min="0")


@dataclass
class State:
    """Everything that changes from tick to tick."""

    position: float = quantity(0.0, "m", "Relative position of the rod tip at the latest tick", "output")
    velocity: float = quantity(0.0, "m/s", "Relative velocity of the rod tip at the latest tick", "output")
    next_position: float = quantity(0.0, "m", "Relative position at the end of this tick")
    next_velocity: float = quantity(0.0, "m/s", "Relative velocity at the end of this tick")
    hanging_position: float = quantity(0.0, "m", "Position of the mass on the spring, of the same rest")
    hanging_velocity: float = quantity(0.0, "m/s", "Its velocity")
    start_time: float = quantity(0.0, "s", "Start time, at which the first tick begins")
    begun: int = quantity(0, "", "Ticks that have begun")
    samples: int = quantity(
        0, "", "Ticks that have ended; the next: start_time + (samples + 1)*sample_period"
    )


def body_force(p: Parameters, s: State, position: float, velocity: float, force: float) -> float:
    """Force that moves the whole mass as the body moves, with all that acts on it [N]."""
    acting = force - p.drag * velocity - p.cable_stiffness * position
    step, w = p.sample_period / SUBSTEPS, p.hanging_frequency
    # Semi-implicit, as the motion is. What the spring does to the mass it does to the body, the other way.
    stretch, rate = s.hanging_position - position, s.hanging_velocity - velocity
    pull = -(w * w * stretch + 2.0 * p.hanging_damping * w * rate)
    s.hanging_velocity += step * pull
    s.hanging_position += step * s.hanging_velocity
    return (acting - p.hanging_share * p.mass * pull) / (1.0 - p.hanging_share)


def advance(p: Parameters, s: State, force: float) -> None:
    """Motion over a tick under a held force [N]: semi-implicit Euler in four sub-steps, velocity first."""
    step = p.sample_period / SUBSTEPS
    position, velocity = s.position, s.velocity
    if s.begun == 0:
        s.hanging_position, s.hanging_velocity = position, velocity
    for _ in range(SUBSTEPS):
        velocity = velocity + step * body_force(p, s, position, velocity, force) / p.mass
        position = position + step * velocity
    s.next_position, s.next_velocity = position, velocity


def command(s: State) -> float:
    """What is sent to the robot: where the tick that has begun will end [m]."""
    return s.next_position if s.begun > 0 else s.position


class LabSatellite(Fmi2Slave):
    """FMI side: variables, ticks, checks."""

    description = (
        "Satellite software of the docking lab: m x'' = force, semi-implicit Euler at a tick of its own"
    )
    requirements = ()

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.parameters, self.state = Parameters(), State()
        self.force = 0.0
        self.type_attributes: dict[str, dict[str, str]] = {
            "force": {"quantity": "Force", "unit": "N", "nominal": "100"},
            "command": {"quantity": "Length", "unit": "m"},
        }
        self.register_variable(
            Real("force", causality=Fmi2Causality.input, description="Force on the relative motion")
        )
        for entry in fields(Parameters):
            register(self, entry, self.parameters, entry.name, Fmi2Causality.parameter, Fmi2Variability.fixed)
        for entry in fields(State):
            output = entry.metadata["kind"] == "output"
            name = entry.name if output else f"state.{entry.name}"
            causality = Fmi2Causality.output if output else Fmi2Causality.local
            register(self, entry, self.state, name, causality, Fmi2Variability.discrete)
        self.register_variable(
            Real(
                "command",
                causality=Fmi2Causality.output,
                variability=Fmi2Variability.discrete,
                initial=Fmi2Initial.calculated,
                description="Position that is sent to the robot: that of the end of the tick under way",
                getter=lambda: command(self.state),
            )
        )
        # Outputs change within steps only: none feeds through.
        self.dependencies: dict[str, tuple[str, ...]] = {"position": (), "velocity": (), "command": ()}
        self.initial_dependencies: dict[str, tuple[str, ...]] = {"command": ("position",)}

    def setup_experiment(self, start_time: float, stop_time: float | None, tolerance: float | None) -> None:
        """The ticks begin at the start time."""
        self.state.start_time = start_time

    def exit_initialization_mode(self) -> None:
        """Check the parameters. Raises: ValueError, which the FMI layer logs and turns into a status."""
        for name, unit in (("mass", "kg"), ("sample_period", "s")):
            value = getattr(self.parameters, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(
                    f"{self.instance_name}: {name} is {value!r} {unit}; a finite number above 0 is needed"
                )
        share = self.parameters.hanging_share
        if not 0.0 <= share < 1.0:
            raise ValueError(f"{self.instance_name}: hanging_share is {share!r}; from 0 to below 1 is needed")

    def do_step(self, current_time: float, step_size: float) -> bool:
        """Begin a tick with its first step, and show its end with its last.

        Raises: ValueError, which the FMI layer logs and turns into a status, if the step leaves out the end
            of a tick or the force is not finite.
        """
        ends = sample_due(self, current_time, step_size)
        s = self.state
        if s.begun == s.samples:
            require_finite(self, "force", self.force, current_time)
            advance(self.parameters, s, self.force)
            s.begun += 1
        if ends:
            s.samples += 1
            s.position, s.velocity = s.next_position, s.next_velocity
        return True
