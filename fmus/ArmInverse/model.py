"""Joint commands for a commanded pose and twist of the docking rod, Eqs. (14) and (16).

Kinematics and frames: shared/arm.py, shared/arm_inverse.py. Of the eight branches the one is taken that is
nearest to the joints of the step before; a pose without joints, a singularity or a limit ends the step.
"""

from __future__ import annotations

import operator

from pythonfmu import Fmi2Causality, Fmi2Initial, Fmi2Slave, Fmi2Variability
from shared.arm import (
    JOINT_UNITS,
    RATE_UNITS,
    Joints,
    arm,
    in_base,
)
from shared.arm_inverse import Solution, inverse, joint_rates, wrist_velocity
from shared.arm_limits import LIMITS, MARGINS, jumps, singularities, stops, wrong_limits
from shared.arm_ports import (
    PARAMETERS,
    POSE,
    START,
    elements,
    frames_of,
    geometry_of,
    no_turn,
    not_finite,
    of_causality,
    refuse,
    register,
    register_array,
    register_computed,
    register_frames,
    wrong_frames,
)
from shared.space import conjugate, product, subtract, turned, unit


class ArmInverse(Fmi2Slave):
    """Inverse kinematics; every output depends on the inputs of the same instant."""

    description = "Joint commands of the arm and its rail for a commanded pose and twist of O_u in O_t"
    requirements = ()

    def __init__(self, **kwargs: object) -> None:
        super().__init__(**kwargs)
        self.type_attributes: dict[str, dict[str, str]] = {}
        for name, (start, one, text) in POSE.items():
            register_array(self, name, start, one, text, causality=Fmi2Causality.input)
        fixed = {"causality": Fmi2Causality.parameter, "variability": Fmi2Variability.fixed}
        register_frames(self)
        self.rail_position, self.rail_share = 0.0, 0.0
        register(self, "rail_position", "m", "Position of the rail when O_u is level with O_t", **fixed)
        register(self, "rail_share", "1", "Share of the motion along the rail that the rail carries", **fixed)
        for name, (start, units, text) in LIMITS.items():
            register_array(self, name, start, units, text, **fixed)
        for name, (start, one, text) in MARGINS.items():
            setattr(self, name, start)
            register(self, name, one, text, **fixed)
        register_array(
            self,
            "present",
            START,
            JOINT_UNITS,
            "Joints to go on from; at the start, the branch to take",
            initial=Fmi2Initial.exact,
        )
        for name, (start, _, _) in POSE.items():
            for index, _ in enumerate(start):
                # The size of a command's change, not of the command: what differences are judged by.
                self.type_attributes[f"{name}[{index + 1}]"]["nominal"] = "1e-4"
        self.current = register_computed(
            self,
            {
                "joint_command": (JOINT_UNITS, "Rail, then A1 to A6: position", _joints),
                "joint_rate_command": (RATE_UNITS, "Rail, then A1 to A6: velocity", operator.itemgetter(1)),
            },
            (*POSE, "present", *PARAMETERS, "rail_position", "rail_share"),
            self.solve,
        )
        pose = elements("position", size=3) + elements("orientation", size=4)
        rates = elements("velocity", "angular_velocity", size=3)
        self.dependencies = {
            name: pose + rates if "rate" in name else pose
            for name in of_causality(self, Fmi2Causality.output)
        }
        used = of_causality(self, Fmi2Causality.parameter) + elements("present")
        self.initial_dependencies = {name: known + used for name, known in self.dependencies.items()}

    def solve(self) -> tuple[Solution, Joints]:
        """Joints for the commanded pose, and their rates."""
        geometry, frames = geometry_of(self), frames_of(self)
        place, orientation, velocity, angular = in_base(
            frames, self.position, self.orientation, self.velocity, self.angular_velocity
        )
        flange_turn = product(orientation, conjugate(unit(frames.tool_orientation)))
        flange = subtract(place, turned(flange_turn, frames.tool_position))
        rail = self.rail_position + self.rail_share * (place[0] - frames.target_position[0])
        found = inverse(geometry, flange, flange_turn, rail, self.present)
        parts = arm(geometry, found.joints)
        at_wrist = wrist_velocity(parts, place, velocity, angular)
        rail_rate = self.rail_share * velocity[0]
        return found, joint_rates(parts, found.joints, rail_rate, at_wrist, angular)

    def exit_initialization_mode(self) -> None:
        """Check parameters and the first command. Raises: ValueError with all that is wrong."""
        wrong = wrong_frames(self) + wrong_limits(self)
        refuse(self, "parameters", wrong + not_finite("present", self.present, "m or rad"))
        self.accept("the first command", 0.0)

    def do_step(self, current_time: float, step_size: float) -> bool:
        """Take the command as the new place to go on from. Raises: ValueError with all that is wrong."""
        self.accept(f"command of the step from {current_time:.9g} s", step_size)
        return True

    def accept(self, what: str, step_size: float) -> None:
        """Check the command; go on from its joints. A step size of 0 s: there was none before."""
        wrong = ""
        for name, (_, one, _) in POSE.items():
            wrong = wrong + not_finite(name, getattr(self, name), one)
        wrong = wrong + no_turn("orientation", self.orientation)
        refuse(self, what, wrong)
        found, rates = self.current()
        # Out of reach or at a singularity joints and rates mean nothing: what is wrong with them follows.
        refuse(self, what, singularities(self, geometry_of(self), found))
        wrong = stops(self, found.joints, rates)
        refuse(self, what, wrong + jumps(self, self.present, found.joints, step_size))
        self.present = found.joints


def _joints(result: tuple[Solution, Joints]) -> Joints:
    return result[0].joints
