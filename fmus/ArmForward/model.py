"""Pose and twist of the docking rod from the positions and velocities of the arm's joints, Eqs. (14), (15).

Kinematics and frames: shared/arm.py. Poses and twists are those of O_u relative to, and resolved in, O_t.
"""

from __future__ import annotations

import operator

from pythonfmu import Fmi2Causality, Fmi2Slave
from shared.arm import JOINT_UNITS, RATE_UNITS, Joints, in_target, tool, twist
from shared.arm_ports import (
    PARAMETERS,
    POSE,
    START,
    elements,
    frames_of,
    geometry_of,
    not_finite,
    of_causality,
    refuse,
    register_array,
    register_computed,
    register_frames,
    wrong_frames,
)
from shared.space import Quaternion, Vector


class ArmForward(Fmi2Slave):
    """Forward kinematics; every output depends on the inputs of the same instant."""

    description = "Pose and twist of O_u in O_t from the joints of the arm and its rail"
    requirements = ()

    def __init__(self, **kwargs: object) -> None:
        super().__init__(**kwargs)
        self.type_attributes: dict[str, dict[str, str]] = {}
        self.joint_position: Joints = START
        given = {"causality": Fmi2Causality.input}
        register_array(self, "joint_position", START, JOINT_UNITS, "Rail, then A1 to A6: position", **given)
        register_array(
            self, "joint_velocity", (0.0,) * 7, RATE_UNITS, "Rail, then A1 to A6: velocity", **given
        )
        register_frames(self)
        register_computed(
            self,
            {
                name: ((unit,) * len(start), text, operator.itemgetter(place))
                for place, (name, (start, unit, text)) in enumerate(POSE.items())
            },
            ("joint_position", "joint_velocity", *PARAMETERS),
            self.pose_and_twist,
        )
        positions, velocities = elements("joint_position"), elements("joint_velocity")
        self.dependencies = {
            name: positions + velocities if "velocity" in name else positions
            for name in of_causality(self, Fmi2Causality.output)
        }
        parameters = of_causality(self, Fmi2Causality.parameter)
        self.initial_dependencies = {name: known + parameters for name, known in self.dependencies.items()}

    def pose_and_twist(self) -> tuple[Vector, Quaternion, Vector, Vector]:
        """Position [m], orientation, velocity [m/s] and angular velocity [rad/s] of O_u in O_t."""
        geometry, frames = geometry_of(self), frames_of(self)
        position, orientation = tool(geometry, frames, self.joint_position)
        velocity, angular = twist(geometry, self.joint_position, self.joint_velocity, position)
        return in_target(frames, position, orientation, velocity, angular)

    def exit_initialization_mode(self) -> None:
        """Check the parameters. Raises: ValueError, which the FMI layer logs and turns into an error."""
        refuse(self, "parameters", wrong_frames(self))

    def do_step(self, current_time: float, step_size: float) -> bool:
        """Nothing moves by itself. Raises: ValueError for a joint that is not a finite number."""
        wrong = not_finite("joint_position", self.joint_position, "m or rad")
        wrong = wrong + not_finite("joint_velocity", self.joint_velocity, "m/s or rad/s")
        refuse(self, f"inputs of the step from {current_time:.9g} s", wrong)
        return True
