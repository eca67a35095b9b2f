"""The arm on its rail as rigid bodies with gravity and joint drives, simulated by Pinocchio.

Frames and axes: shared/arm.py. The equations of motion are the library's; README.md beside this file tells
the drives, the masses, and which of the numbers are ours.
"""

from __future__ import annotations

import math
from typing import Any

from pythonfmu import Fmi2Causality, Fmi2Initial, Fmi2Slave, Fmi2Variability
from shared.arm import AXES, JOINT_UNITS, RATE_UNITS, Joints, in_base
from shared.arm_ports import (
    START,
    frames_of,
    geometry_of,
    not_finite,
    problem,
    refuse,
    register,
    register_array,
    register_frames,
    wrong_frames,
)

NONE: Joints = (0.0,) * 7
EFFORT_UNITS = ("N", *("N.m",) * 6)
ROTOR_UNITS = ("kg", *("kg.m2",) * 6)
# Internal steps are at most this long times the fastest drive: fourth order then errs by 1e-7 of a swing.
LARGEST_ANGLE = 0.12
# One array a parameter: start, units, text.
PARAMETERS = {
    "omega_n": ((2.0 * math.pi * 75.0,) * 7, ("rad/s",) * 7, "Natural frequencies of the drives"),
    "xi_n": ((0.8,) * 7, ("1",) * 7, "Damping ratios of the drives"),
    "link_mass": ((400.0, 380.0, 230.0, 210.0, 60.0, 40.0, 20.0), ("kg",) * 7, "Mass of carriage and links"),
    "rotor_inertia": (
        (1000.0, 400.0, 400.0, 300.0, 20.0, 15.0, 8.0),
        ROTOR_UNITS,
        "Inertia of the motors, as seen at the joint",
    ),
}


class ArmMultibody(Fmi2Slave):
    """Joints driven, pulled by gravity and pushed by the contact; no output follows an input at once."""

    description = "Rigid-body dynamics of the arm on its rail with gravity and joint drives, by Pinocchio"
    requirements = ("numpy>=2.2", "pin>=4.1")

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.type_attributes: dict[str, dict[str, str]] = {}
        given = {"causality": Fmi2Causality.input}
        register_array(self, "joint_command", START, JOINT_UNITS, "Rail, then A1 to A6: position", **given)
        register_array(self, "force", NONE[:3], "N", "Contact force on the rod, in O_t", **given)
        register_array(self, "point", NONE[:3], "m", "Where it acts, in O_t", **given)
        register_frames(self)
        fixed = {"causality": Fmi2Causality.parameter, "variability": Fmi2Variability.fixed}
        for name, (start, units, text) in PARAMETERS.items():
            register_array(self, name, start, units, f"{text}: rail, then A1 to A6", **fixed)
        register_array(self, "gravity", (0.0, 0.0, -9.80665), "m/s2", "In the base frame", **fixed)
        self.tool_mass, self.gravity_compensation = 30.0, 1.0
        register(self, "tool_mass", "kg", "Mass at the origin of O_u: space robot and rod", **fixed)
        register(self, "gravity_compensation", "1", "Share of gravity that the drives know of", **fixed)
        out = {"causality": Fmi2Causality.output}
        moving = {**out, "initial": Fmi2Initial.exact}
        register_array(self, "joint_position", START, JOINT_UNITS, "Rail, then A1 to A6: position", **moving)
        register_array(self, "joint_velocity", NONE, RATE_UNITS, "Rail, then A1 to A6: velocity", **moving)
        register_array(self, "joint_effort", NONE, EFFORT_UNITS, "Of the drives, at the step's end", **moving)
        outputs = [one.name for one in self.vars.values() if one.causality is Fmi2Causality.output]
        self.dependencies: dict[str, tuple[str, ...]] = dict.fromkeys(outputs, ())
        self.initial_dependencies: dict[str, tuple[str, ...]] = {}
        self.body: Any = None

    def exit_initialization_mode(self) -> None:
        """Check the parameters and build the model. Raises: ValueError with all that is wrong."""
        wrong = wrong_frames(self)
        for name, (_, units, _) in PARAMETERS.items():
            value = getattr(self, name)
            wrong += not_finite(name, value, units[-1])
            for index, axis in enumerate(AXES):
                low = name in ("rotor_inertia", "xi_n")
                right = value[index] >= 0.0 if low else value[index] > 0.0
                allowed = "not negative" if low else f"above 0 {units[index]}"
                got = f"{name}[{index + 1}], of {axis}, is {value[index]!r} {units[index]}"
                wrong += problem(right, f"{got}; allowed: {allowed}")
        wrong += not_finite("joint_position", self.joint_position, "m or rad")
        wrong += problem(self.tool_mass >= 0.0, f"tool_mass is {self.tool_mass!r} kg; allowed: not negative")
        refuse(self, "parameters", wrong)
        self.body = None
        self._effort(self._built(), *self._now())

    def _set_fmu_state(self, state: dict[str, Any]) -> None:
        super()._set_fmu_state(state)
        # It is made of the parameters, which may have changed.
        self.body = None

    def do_step(self, current_time: float, step_size: float) -> bool:
        """Classical Runge-Kutta steps of fourth order, command and contact force held.

        Raises: ValueError for inputs that are not finite, or where the motion leaves all bounds.
        """
        wrong = not_finite("joint_command", self.joint_command, "m or rad")
        wrong += not_finite("force", self.force, "N") + not_finite("point", self.point, "m")
        refuse(self, f"inputs of the step from {current_time:.9g} s", wrong)
        body = self._built()
        number = max(1, math.ceil(step_size * max(self.omega_n) / LARGEST_ANGLE))
        h = step_size / number
        q, v = self._now()
        for _ in range(number):
            a_1 = self._acceleration(body, q, v)
            v_2 = v + 0.5 * h * a_1
            a_2 = self._acceleration(body, q + 0.5 * h * v, v_2)
            v_3 = v + 0.5 * h * a_2
            a_3 = self._acceleration(body, q + 0.5 * h * v_2, v_3)
            v_4 = v + h * a_3
            a_4 = self._acceleration(body, q + h * v_3, v_4)
            q = q + h / 6.0 * (v + 2.0 * v_2 + 2.0 * v_3 + v_4)
            v = v + h / 6.0 * (a_1 + 2.0 * a_2 + 2.0 * a_3 + a_4)
        refuse(
            self,
            f"step from {current_time:.9g} s",
            not_finite("joint_position", tuple(q), "m or rad")
            + not_finite("joint_velocity", tuple(v), "rad/s"),
        )
        self.joint_position, self.joint_velocity = tuple(map(float, q)), tuple(map(float, v))
        self._effort(body, q, v)
        return True

    def _now(self) -> tuple[Any, Any]:
        np = self._built().numpy
        return np.array(self.joint_position), np.array(self.joint_velocity)

    def _effort(self, body: Any, q: Any, v: Any) -> Any:
        """Efforts of the drives [N, N.m]: Eq. (17) at a constant inertia, and the weight they know of."""
        np = body.numpy
        command, omega_n, xi_n = (np.array(getattr(self, n)) for n in ("joint_command", "omega_n", "xi_n"))
        wanted = omega_n**2 * (command - q) - 2.0 * xi_n * omega_n * v
        effort = body.inertia * wanted + self.gravity_compensation * body.weight(q)
        self.joint_effort = tuple(map(float, effort))
        return effort

    def _acceleration(self, body: Any, q: Any, v: Any) -> Any:
        effort = self._effort(body, q, v)
        if any(self.force):
            place, _, force, _ = in_base(
                frames_of(self), self.point, (1.0, 0.0, 0.0, 0.0), self.force, NONE[:3]
            )
            effort = effort + body.pushed(q, place, force)
        return body.engine.aba(body.model, body.data, q, v, effort)

    def _built(self) -> Any:
        if self.body is None:
            self.body = Body(self)
        return self.body


class Body:
    """The library's model of an arm, and what the drives take from it."""

    def __init__(self, slave: Any) -> None:
        try:
            import numpy
            import pinocchio
        except ImportError as error:
            raise ValueError(
                f"{slave.instance_name}: the rigid-body engine Pinocchio cannot be loaded ({error}); install "
                "the package pin, such as by pip install 'orchestrator[multibody]'"
            ) from error
        self.engine, self.numpy = pinocchio, numpy
        g = geometry_of(slave)
        self.model = model = pinocchio.Model()
        model.gravity.linear = numpy.array(slave.gravity)
        axes = ((0, 0, -1), (0, 1, 0), (0, 1, 0), (-1, 0, 0), (0, 1, 0), (-1, 0, 0))
        places = ((0, 0, g.d_1), (g.a_1, 0, 0), (g.a_2, 0, 0), (0, 0, g.a_3), (g.d_4, 0, 0), (g.d_6, 0, 0))
        # Links reach from joint to joint: uniform rods with a square section of 0.3 m, A1's lever and all.
        reaches = ((0.0, 0.0, 0.0), *places[1:], (0.0, 0.0, 0.0))
        parent = model.addJoint(0, pinocchio.JointModelPX(), pinocchio.SE3.Identity(), AXES[0])
        for index, reach in enumerate(reaches):
            if index:
                joint = pinocchio.JointModelRevoluteUnaligned(numpy.array(axes[index - 1], dtype=float))
                there = pinocchio.SE3(numpy.eye(3), numpy.array(places[index - 1], dtype=float))
                parent = model.addJoint(parent, joint, there, AXES[index])
            size = numpy.abs(numpy.array(reach, dtype=float)) + 0.3
            box = pinocchio.Inertia.FromBox(slave.link_mass[index], *size)
            middle = pinocchio.SE3(numpy.eye(3), 0.5 * numpy.array(reach, dtype=float))
            model.appendBodyToJoint(parent, box, middle)
        # The flange's z lies along x of A6 when all joints are at zero, its x along -z.
        x, y, z = slave.tool_position
        tool = pinocchio.Inertia(slave.tool_mass, numpy.array([z, y, -x]), numpy.zeros((3, 3)))
        model.appendBodyToJoint(parent, tool, pinocchio.SE3.Identity())
        model.armature = numpy.array(slave.rotor_inertia)
        self.data, self.last = model.createData(), parent
        # What the drives take each joint's inertia to be, for good: that at the arm's start position.
        self.inertia = numpy.diag(pinocchio.crba(model, self.data, numpy.array(START))).copy()

    def weight(self, q: Any) -> Any:
        """Efforts that hold the arm, at rest, against gravity."""
        return self.engine.computeGeneralizedGravity(self.model, self.data, q)

    def pushed(self, q: Any, place: Any, force: Any) -> Any:
        """Efforts that a force [N] at a place [m] of the flange has in the joints, both in the base frame."""
        engine, np = self.engine, self.numpy
        engine.forwardKinematics(self.model, self.data, q)
        columns = engine.computeJointJacobian(self.model, self.data, q, self.last)
        at = self.data.oMi[self.last]
        turn = at.rotation
        arm = np.array(place) - at.translation
        linear, angular = turn @ columns[:3], turn @ columns[3:]
        return np.array(force) @ (linear + np.cross(angular.T, arm).T)
