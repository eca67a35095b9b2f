"""Free-floating relative motion of two satellites along one axis, Eqs. (6) and (8) in one dimension.

Signs and frames as in modelica/DockingHIL/SignConventions.mo: the force acts on the rod, so on the relative
motion, positive towards the front frame.
"""

from __future__ import annotations

import math

from pythonfmu import Fmi2Causality, Fmi2Initial, Fmi2Slave, Fmi2Variability, Real

# m_s m_t/(m_s + m_t) of a service satellite of 300 kg and a target satellite of 4000 kg.
EFFECTIVE_MASS = 300.0 * 4000.0 / (300.0 + 4000.0)


def advance(
    position: float, velocity: float, force: float, mass: float, step_size: float
) -> tuple[float, float]:
    """Motion under a force that is constant over the step: exact, whatever the step size.

    Args:
        position: relative position at the start of the step [m].
        velocity: relative velocity at the start of the step [m/s].
        force: force on the relative motion during the step [N].
        mass: effective mass [kg].
        step_size: length of the step [s].
    Returns: position [m] and velocity [m/s] at the end of the step.
    """
    acceleration = force / mass
    return (
        position + velocity * step_size + 0.5 * acceleration * step_size * step_size,
        velocity + acceleration * step_size,
    )


class SatelliteDynamics(Fmi2Slave):
    """m_e x'' = force, integrated exactly for an input held over the communication step."""

    description = "Relative motion of two free-floating satellites along one axis, m_e x'' = force"
    requirements = ()

    def __init__(self, **kwargs: object) -> None:
        super().__init__(**kwargs)
        self.force = 0.0
        self.mass = EFFECTIVE_MASS
        self.position = 0.0
        self.velocity = 0.0
        # What the FMI type element of each variable says besides its start value.
        self.type_attributes: dict[str, dict[str, str]] = {
            "force": {"quantity": "Force", "unit": "N", "nominal": "100"},
            "mass": {"quantity": "Mass", "unit": "kg", "min": "0"},
            "position": {"quantity": "Length", "unit": "m"},
            "velocity": {"quantity": "Velocity", "unit": "m/s"},
            "kinetic_energy": {"quantity": "Energy", "unit": "J"},
        }
        # The outputs move only in a step, from the force that the step began with: none feeds through.
        self.dependencies: dict[str, tuple[str, ...]] = {"position": (), "velocity": (), "kinetic_energy": ()}
        self.initial_dependencies: dict[str, tuple[str, ...]] = {"kinetic_energy": ("mass", "velocity")}

        start = {"causality": Fmi2Causality.output, "initial": Fmi2Initial.exact}
        self.register_variable(
            Real("force", causality=Fmi2Causality.input, description="Force on the relative motion")
        )
        self.register_variable(
            Real(
                "mass",
                causality=Fmi2Causality.parameter,
                variability=Fmi2Variability.fixed,
                description="Effective mass m_s m_t/(m_s + m_t)",
            )
        )
        self.register_variable(Real("position", description="Relative position of the rod tip", **start))
        self.register_variable(Real("velocity", description="Relative velocity of the rod tip", **start))
        self.register_variable(
            Real(
                "kinetic_energy",
                causality=Fmi2Causality.output,
                initial=Fmi2Initial.calculated,
                description="Kinetic energy of the relative motion, mass velocity^2/2",
                getter=lambda: 0.5 * self.mass * self.velocity * self.velocity,
            )
        )

    def exit_initialization_mode(self) -> None:
        """Check what was set. Raises: ValueError, which the FMI layer logs and turns into an error status."""
        if not (math.isfinite(self.mass) and self.mass > 0.0):
            raise ValueError(
                f"{self.instance_name}: mass is {self.mass!r} kg; a finite mass above 0 kg is needed, "
                f"for example {EFFECTIVE_MASS!r} kg"
            )
        for name in ("position", "velocity"):
            value = getattr(self, name)
            if not math.isfinite(value):
                raise ValueError(
                    f"{self.instance_name}: start value of {name} is {value!r} "
                    f"{self.type_attributes[name]['unit']}; a finite number is needed"
                )

    def do_step(self, current_time: float, step_size: float) -> bool:
        """One communication step. Raises: ValueError as above if the force is not finite.

        Returning False instead would ask the master to end the simulation.
        """
        if not math.isfinite(self.force):
            raise ValueError(
                f"{self.instance_name}: input force is {self.force!r} N in the step from {current_time:.9g} "
                "s; a finite number is needed. Look at what is connected to it"
            )
        self.position, self.velocity = advance(self.position, self.velocity, self.force, self.mass, step_size)
        return True
