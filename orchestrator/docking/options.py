"""Options of the docking measures: which instances they read."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

# Components of a recorded pose and twist, and how many numbers each has.
POSE = {"position": 3, "orientation": 4, "velocity": 3, "angular_velocity": 3}
_SATELLITES = ("kinetic_energy", "linear_momentum", "angular_momentum")


class SpaceOptions(BaseModel):
    """Names of the instances that the measure of contacts in space reads."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    satellites: str = Field(description="Name of the instance that simulates both satellites.")
    robot: str = Field(description="Name of the instance that simulates the robot.")
    contact: str = Field(description="Name of the instance that simulates the contact.")
    controller: str | None = Field(
        None, description="Name of the controller's instance; none in an uncompensated loop."
    )

    def signals(self) -> tuple[str, ...]:
        """Names of the recorded signals that the measure reads."""
        names = [f"{self.satellites}.kinetic_energy", f"{self.contact}.stored_energy"]
        arrays = [(f"{self.satellites}.{name}", 3) for name in _SATELLITES[1:]]
        arrays += [(f"{self.contact}.force", 3)]
        for suffix in ("", "_a", "_b"):
            arrays += [(f"{self.satellites}.{name}{suffix}", size) for name, size in POSE.items()]
        arrays += [(f"{self.robot}.{name}", size) for name, size in POSE.items()]
        names += [f"{name}[{index}]" for name, size in arrays for index in range(1, size + 1)]
        if self.controller is not None:
            names += [f"{self.controller}.stiffness_estimate", f"{self.controller}.damping_estimate"]
        return tuple(names)


class DockingOptions(BaseModel):
    """Names of the instances that the measure of contacts along a line reads."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    satellite: str = Field(description="Name of the instance that simulates the relative motion.")
    robot: str = Field(description="Name of the instance that simulates the robot.")
    contact: str = Field(description="Name of the instance that simulates the contact.")
    controller: str | None = Field(
        None, description="Name of the controller's instance; none in an uncompensated loop."
    )

    def signals(self) -> tuple[str, ...]:
        """Names of the recorded signals that the measure reads."""
        names = [f"{self.satellite}.velocity", f"{self.satellite}.position", f"{self.robot}.position"]
        names += [f"{self.contact}.force"]
        if self.controller is not None:
            names += [f"{self.controller}.stiffness_estimate", f"{self.controller}.damping_estimate"]
        return tuple(names)
