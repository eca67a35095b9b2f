"""The arm's kinematics against an independent library, against itself, and what it refuses."""

from __future__ import annotations

import math

import numpy as np
import pytest
from conftest import load_model
from hypothesis import given, settings
from hypothesis import strategies as st

ARM = load_model("ArmInverse")
GEOMETRY = ARM.Geometry()
LOW, HIGH = ARM.LIMITS["joint_lower"][0], ARM.LIMITS["joint_upper"][0]
# (theta's factor and offset, d, a, alpha) of the D-H table in the README.
DH = [
    (-1, 0.0, 0.675, 0.350, -90.0),
    (1, 0.0, 0.0, 1.150, 0.0),
    (1, -90.0, 0.0, -0.041, -90.0),
    (-1, 0.0, 1.200, 0.0, 90.0),
    (1, 0.0, 0.0, 0.0, -90.0),
    (-1, 180.0, 0.215, 0.0, 0.0),
]

joints = st.tuples(*(st.floats(low, high) for low, high in zip(LOW, HIGH, strict=True)))


def matrix(quaternion):
    """Rotation matrix, by the component's own product."""
    return np.array([ARM.turned(quaternion, tuple(axis)) for axis in np.eye(3)]).T


def pose(q):
    """Position [m] and rotation matrix of the flange."""
    return np.array(ARM.arm(GEOMETRY, q).flange), matrix(ARM.flange_orientation(q))


def solve(q, present):
    """Inverse kinematics of the pose that joints give."""
    flange, turn = ARM.arm(GEOMETRY, q).flange, ARM.flange_orientation(q)
    return ARM.inverse(GEOMETRY, flange, turn, q[0], present)


def regular(q, margin=0.02):
    """Whether joints are off every singularity."""
    parts = ARM.arm(GEOMETRY, q)
    elbow = math.sin(q[3] - math.atan2(GEOMETRY.a_3, GEOMETRY.d_4))
    radius = math.hypot(parts.wrist[0] - q[0], parts.wrist[1])
    return min(abs(elbow), abs(math.sin(q[5])), radius) > margin


def test_reach_is_the_robots():
    """The KR 210 R2700 extra reaches 2.70 m, from A1 to the wrist's centre, hence its name."""
    stretched = GEOMETRY.a_1 + GEOMETRY.a_2 + math.hypot(GEOMETRY.d_4, GEOMETRY.a_3)
    assert stretched == pytest.approx(2.70, abs=1e-3)


@given(joints)
def test_forward_kinematics_is_the_product_of_the_d_h_table(q):
    total = np.eye(4)
    total[0, 3] = q[0]
    for angle, (sign, offset, d, a, alpha) in zip(q[1:], DH, strict=True):
        c, s = math.cos(sign * angle + math.radians(offset)), math.sin(sign * angle + math.radians(offset))
        ca, sa = math.cos(math.radians(alpha)), math.sin(math.radians(alpha))
        total = total @ np.array(
            [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0.0, sa, ca, d], [0.0, 0.0, 0.0, 1.0]]
        )
    position, turn = pose(q)
    np.testing.assert_allclose(position, total[:3, 3], rtol=0, atol=1e-14)
    np.testing.assert_allclose(turn, total[:3, :3], rtol=0, atol=1e-14)


def test_forward_kinematics_and_jacobian_agree_with_pinocchio():
    pin = pytest.importorskip("pinocchio", reason="Pinocchio is not installed: pip install pin")
    model = pin.Model()
    parent = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "rail")
    axes = [(0, 0, -1), (0, 1, 0), (0, 1, 0), (-1, 0, 0), (0, 1, 0), (-1, 0, 0)]
    places = [(0, 0, 0.675), (0.35, 0, 0), (1.15, 0, 0), (0, 0, -0.041), (1.2, 0, 0), (0.215, 0, 0)]
    for number, (axis, place) in enumerate(zip(axes, places, strict=True)):
        revolute = pin.JointModelRevoluteUnaligned(np.array(axis, float))
        parent = model.addJoint(
            parent, revolute, pin.SE3(np.eye(3), np.array(place, float)), f"A{number + 1}"
        )
    data, random = model.createData(), np.random.default_rng(1)
    for _ in range(100):
        q = random.uniform(LOW, HIGH)
        pin.forwardKinematics(model, data, q)
        placed = data.oMi[7] * pin.SE3(pin.utils.rotate("y", math.pi / 2), np.zeros(3))
        position, turn = pose(tuple(q))
        np.testing.assert_allclose(position, placed.translation, rtol=0, atol=1e-13)
        np.testing.assert_allclose(turn, placed.rotation, rtol=0, atol=1e-13)
        expected = pin.computeJointJacobian(model, data, q, 7)
        to_world = np.kron(np.eye(2), data.oMi[7].rotation)
        columns = ARM.jacobian(GEOMETRY, tuple(q), tuple(position))
        np.testing.assert_allclose(
            np.array([[*linear, *angular] for linear, angular in columns]).T, to_world @ expected, atol=1e-12
        )


@given(joints)
def test_jacobian_is_the_derivative_of_the_pose(q):
    step = 1e-6
    columns = ARM.jacobian(GEOMETRY, q, ARM.arm(GEOMETRY, q).flange)
    for axis, (linear, angular) in enumerate(columns):
        ahead, behind = (
            pose(tuple(x + side * step * (k == axis) for k, x in enumerate(q))) for side in (1, -1)
        )
        moved = (ahead[0] - behind[0]) / (2 * step)
        spin = (ahead[1] - behind[1]) @ pose(q)[1].T / (2 * step)
        np.testing.assert_allclose(linear, moved, rtol=0, atol=1e-8)
        np.testing.assert_allclose(angular, (spin[2, 1], spin[0, 2], spin[1, 0]), rtol=0, atol=1e-8)


@given(joints)
def test_inverse_of_forward_is_where_it_came_from(q):
    found = solve(q, q)
    if regular(q):
        np.testing.assert_allclose(found.joints, q, rtol=0, atol=1e-9)
    # Singular or not, the pose is met.
    position, turn = pose(found.joints)
    np.testing.assert_allclose(position, pose(q)[0], rtol=0, atol=1e-6)
    np.testing.assert_allclose(turn, pose(q)[1], rtol=0, atol=1e-6)


@given(joints)
def test_every_branch_that_reaches_meets_the_pose_and_all_differ(q):
    flange, orientation = ARM.arm(GEOMETRY, q).flange, ARM.flange_orientation(q)
    found = ARM.branches(GEOMETRY, flange, orientation, q[0], q)
    assert len(found) == 8
    longest = GEOMETRY.a_2 + math.hypot(GEOMETRY.d_4, GEOMETRY.a_3)
    reaching = [one for one in found if one.reach <= longest]
    assert len(reaching) >= 4
    for one in reaching:
        position, turn = pose(one.joints)
        np.testing.assert_allclose(position, flange, rtol=0, atol=1e-6)
        np.testing.assert_allclose(turn, pose(q)[1], rtol=0, atol=1e-6)
    if regular(q, 0.2):
        angles = np.array([one.joints for one in reaching])
        turns = np.exp(1j * angles[:, 1:])
        apart = np.abs(turns[:, None] - turns[None]).max(axis=2) + 10.0 * np.eye(len(reaching))
        assert apart.min() > 1e-3


@given(joints, st.tuples(*(st.floats(-1.0, 1.0) for _ in range(7))))
def test_joint_rates_are_those_of_the_twist(q, rates):
    if not regular(q):
        return
    parts = ARM.arm(GEOMETRY, q)
    linear, angular = ARM.twist(GEOMETRY, q, rates, parts.flange)
    at_wrist = ARM.wrist_velocity(parts, parts.flange, linear, angular)
    found = ARM.joint_rates(parts, q, rates[0], at_wrist, angular)
    np.testing.assert_allclose(found, rates, rtol=0, atol=1e-8)


@settings(max_examples=20, deadline=None)
@given(st.floats(0.5, 3.0), st.floats(-3.0, 3.0))
def test_the_branch_is_kept_along_a_path(frequency, phase):
    """Also where another branch is nearer to zero joints, and beyond half a turn of the wrist."""
    present = (0.0, 0.5, -1.9, 2.3, 3.0, -0.7, -3.0)
    start = present
    for number in range(300):
        swing = math.sin(2.0 * math.pi * frequency * number / 300 + phase) - math.sin(phase)
        wanted = tuple(x + 0.25 * swing * (-1) ** k for k, x in enumerate(start))
        present = solve(wanted, present).joints
        np.testing.assert_allclose(present, wanted, rtol=0, atol=1e-8)


def command(**start):
    """ArmInverse in process, initialised."""
    model = ARM.ArmInverse(instance_name="inverse")
    variables = {variable.name: variable for variable in model.vars.values()}
    for name, value in start.items():
        variables[name].setter(value)
    model.exit_initialization_mode()
    return model, variables


@pytest.mark.parametrize(
    ("start", "message"),
    [
        (
            {"position[1]": 3.0},
            "inverse: the first command: out of reach: the wrist's centre would be 3.85124 m from A2; "
            "allowed: 0.0507002 m to 2.3507 m. Move target_position or rail_position, or let the rail carry "
            "more by rail_share.",
        ),
        (
            {"position[3]": 0.6},
            "inverse: the first command: wrist singularity: A4 and A6 are in line but for an angle, A5, of "
            "sine 0.0442843; allowed: 0.05 (wrist_margin) or more. Move target_position up or down, or "
            "turn the tool.",
        ),
        (
            {
                "target_position[1]": 0.515,
                "target_position[3]": 2.0,
                "joint_upper[4]": 3.0,
                "joint_lower[4]": -3.0,
            },
            "shoulder singularity: the wrist's centre is ",
        ),
        (
            {"rail_position": 1.6, "target_position[1]": 1.6 + 1.6840350802243567},
            "inverse: the first command: rail would stand at 1.6 m; allowed: -1.5 m to 1.5 m. Move "
            "target_position or rail_position, or start in another branch (present).",
        ),
        (
            {"velocity[2]": 4.0},
            "A1 would move at 3.42163 rad/s; allowed: up to 2.14675 rad/s. Command it slower, ",
        ),
        (
            {"orientation[1]": 0.5},
            "inverse: the first command: orientation is a quaternion (w, x, y, z) of length 0.5; allowed: 1 "
            "within 0.001; no turn is (1, 0, 0, 0).",
        ),
        (
            {"joint_lower[3]": 1.0},
            "inverse: parameters: joint_lower[3], of A2, is 1 rad; allowed: below joint_upper[3], "
            "-0.0872665 rad.",
        ),
        (
            {"a_2": 0.0, "tool_orientation[1]": 0.0},
            "inverse: parameters: a_2 is 0.0 m; allowed: above 0 m, it is a link. tool_orientation is a "
            "quaternion (w, x, y, z) of length 0.707107; allowed: 1 within 0.001; no turn is (1, 0, 0, 0).",
        ),
    ],
)
def test_refuses_what_the_arm_cannot_do(start, message):
    with pytest.raises(ValueError) as caught:
        command(**start)
    assert message in str(caught.value)
    if message.startswith("inverse"):
        assert str(caught.value) == message


def test_refuses_a_command_that_jumps():
    model, variables = command()
    before = model.present
    variables["position[2]"].setter(0.01)
    with pytest.raises(ValueError) as caught:
        model.do_step(0.25, 1e-3)
    assert str(caught.value).startswith("inverse: command of the step from 0.25 s: A1 would have to go ")
    assert "rad within 0.001 s; allowed: 0.00214675 rad. The command jumps" in str(caught.value)
    assert model.present is before
    assert model.do_step(0.25, 1.0)


def test_the_rail_carries_its_share():
    for share in (0.0, 0.3, 1.0):
        model, variables = command(**{"rail_share": share, "rail_position": 0.2, "position[1]": 0.1})
        variables["velocity[1]"].setter(0.05)
        found, rates = model.current()
        assert found.joints[0] == pytest.approx(0.2 + share * 0.1, abs=1e-15)
        assert rates[0] == pytest.approx(share * 0.05, abs=1e-16)
