"""Motion mapping, Eqs. (1), (2), (10) to (16): each against differentiated poses."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from orchestrator.docking.frames import Motion, attached, placed, relative

STEP = 1e-5
small = st.floats(-1.0, 1.0)
vectors = st.tuples(small, small, small).map(np.array)
turns = st.integers(0, 2**32 - 1).map(lambda seed: Rotation.random(random_state=seed))
motions = st.builds(Motion, vectors, turns, vectors, vectors)


def later(motion, time):
    """The motion after a time at constant twist."""
    turn = Rotation.from_rotvec(motion.angular_velocity * time) * motion.orientation
    return Motion(motion.position + motion.velocity * time, turn, motion.velocity, motion.angular_velocity)


def matrix(motion):
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = motion.orientation.as_matrix(), motion.position
    return result


def check_twist(at):
    """Whether a motion's twist is the derivative of its pose; `at` gives it by time."""
    late, early, now = at(STEP), at(-STEP), at(0.0)
    assert now.velocity == pytest.approx((late.position - early.position) / (2.0 * STEP), abs=1e-8)
    turn = (late.orientation * early.orientation.inv()).as_rotvec()
    assert now.angular_velocity == pytest.approx(turn / (2.0 * STEP), abs=1e-8)


@given(motions, vectors, turns)
@settings(max_examples=50)
def test_equations_10_and_11(body, place, turn):
    assert matrix(attached(body, place, turn)) == pytest.approx(
        matrix(body) @ matrix(Motion.still(place, turn)), abs=1e-14
    )
    check_twist(lambda time: attached(later(body, time), place, turn))


@given(motions, motions, vectors, turns, vectors, turns)
@settings(max_examples=50)
def test_equations_12_and_13(a, b, place_a, turn_a, place_b, turn_b):
    def seen(time):
        return relative(attached(later(a, time), place_a, turn_a), attached(later(b, time), place_b, turn_b))

    t_ai = matrix(a) @ matrix(Motion.still(place_a, turn_a))
    t_bi = matrix(b) @ matrix(Motion.still(place_b, turn_b))
    assert matrix(seen(0.0)) == pytest.approx(np.linalg.inv(t_bi) @ t_ai, abs=1e-12)
    check_twist(seen)


@given(motions, motions, vectors, turns)
@settings(max_examples=50)
def test_equations_14_to_16_give_the_robot_the_satellites_relative_motion(a, b, place, turn):
    target = Motion.still(place, turn)

    def end(time):
        return placed(target, relative(later(a, time), later(b, time)))

    # Eq. (1): from the target's assembly frame, the simulator looks as the satellites do.
    assert matrix(relative(end(0.0), target)) == pytest.approx(matrix(relative(a, b)), abs=1e-12)
    assert matrix(end(0.0)) == pytest.approx(matrix(target) @ matrix(relative(a, b)), abs=1e-12)
    check_twist(end)
    # Eq. (16) with what it leaves out: R_t R_Bi^-1 (v_Ai - v_Bi - omega_Bi x (r_Ai - r_Bi)).
    speed = a.velocity - b.velocity - np.cross(b.angular_velocity, a.position - b.position)
    assert end(0.0).velocity == pytest.approx((turn * b.orientation.inv()).apply(speed), abs=1e-12)


@given(motions, motions, vectors, turns, vectors, turns)
@settings(max_examples=30)
def test_equation_2_a_sensor_alike_in_both_systems_reads_alike(a, b, place, turn, sensor, sensor_turn):
    """The rod as seen from the sensor: on the satellites, and in the laboratory."""
    target = Motion.still(place, turn)
    in_space = relative(a, attached(b, sensor, sensor_turn))
    in_laboratory = relative(placed(target, relative(a, b)), attached(target, sensor, sensor_turn))
    assert matrix(in_laboratory) == pytest.approx(matrix(in_space), abs=1e-12)
    assert in_laboratory.velocity == pytest.approx(in_space.velocity, abs=1e-12)


def test_printed_forms_fail_where_ours_hold():
    """Eq. (13) as printed puts the robot on the other side; Eq. (12) stops it while its pose moves."""
    b = Motion.of([0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    a = Motion.of([1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0])
    printed = np.linalg.inv(matrix(a)) @ matrix(b)
    assert printed[:3, 3].tolist() == [-1.0, 0.0, 0.0]
    assert relative(a, b).position.tolist() == [1.0, 0.0, 0.0]
    assert (a.velocity - b.velocity).tolist() == [0.0, 0.0, 0.0]
    assert relative(a, b).velocity.tolist() == [0.0, -1.0, 0.0]


def test_rows_are_mapped_one_by_one():
    one = Motion.of([1.0, 2.0, 3.0], [0.5, 0.5, 0.5, 0.5], [0.1, 0.2, 0.3], [0.4, 0.5, 0.6])
    rows = Motion.of(*(np.tile(part, (4, 1)) for part in (
        [1.0, 2.0, 3.0], [0.5, 0.5, 0.5, 0.5], [0.1, 0.2, 0.3], [0.4, 0.5, 0.6])))  # fmt: skip
    base = Motion.still([1.0, 0.0, 0.0], Rotation.from_rotvec([0.0, 0.3, 0.0]))
    assert relative(rows, base).velocity == pytest.approx(np.tile(relative(one, base).velocity, (4, 1)))
    assert placed(base, rows).position.shape == (4, 3)


@pytest.mark.parametrize(
    ("quaternion", "message"),
    [
        ([1.1, 0.0, 0.0, 0.0], "motion: a quaternion has the length 1.1; allowed: 1 within 1e-6"),
        (
            [1.0, 0.0, 0.0],
            "motion: shapes (3,), (3,), (3,), (3,); allowed: (3,), (4,), (3,), (3,), or n rows of each",
        ),
    ],
)
def test_refuses_what_is_no_motion(quaternion, message):
    with pytest.raises(ValueError) as caught:
        Motion.of(np.zeros(3), quaternion, np.zeros(3), np.zeros(3))
    assert str(caught.value) == message
