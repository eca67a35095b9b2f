"""SatellitePair: Eqs. (3) to (16), conservation, accuracy, agreement with one dimension, refusals.

Rotations are checked with scipy's, which share no code with the model's.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from conftest import Instance, load_model
from docking_bench import EFFECTIVE_MASS
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

PAIR = load_model("SatellitePair")
POSE = ("position", "orientation", "velocity", "angular_velocity")

small = st.floats(-1.0, 1.0)
vectors = st.tuples(small, small, small)
rotations = st.integers(0, 2**32 - 1).map(lambda seed: Rotation.random(random_state=seed))
scalar_first = rotations.map(lambda turn: tuple(turn.as_quat(scalar_first=True)))
motions = st.builds(PAIR.Motion, vectors, scalar_first, vectors, vectors)


@st.composite
def bodies(draw):
    """A body of points: any inertia that some body can have."""
    points = np.random.default_rng(draw(st.integers(0, 2**32 - 1))).normal(size=(12, 3))
    mass = draw(st.floats(50.0, 5000.0))
    points -= points.mean(axis=0)
    spread = points.T @ points / 12.0
    tensor = mass * (np.trace(spread) * np.eye(3) - spread)
    rows = tuple(tuple(map(float, row)) for row in 0.5 * (tensor + tensor.T))
    return PAIR.Body(mass, rows, PAIR.inverted(rows))


def turned(q):
    return Rotation.from_quat(q, scalar_first=True)


def momenta(pair, states, about=(0.0, 0.0, 0.0)):
    """Linear momentum, angular momentum about a point, kinetic energy, and the size of the terms of each."""
    terms = []
    for body, motion in zip(pair, states, strict=True):
        r = turned(motion.orientation).as_matrix()
        spin = r @ np.array(body.inertia) @ r.T @ motion.angular_velocity
        linear = body.mass * np.array(motion.velocity)
        energy = 0.5 * (linear @ motion.velocity + spin @ motion.angular_velocity)
        terms.append((linear, np.cross(np.subtract(motion.position, about), linear) + spin, energy))
    sums = [terms[0][index] + terms[1][index] for index in range(3)]
    return sums, [np.abs(terms[0][index]).max() + np.abs(terms[1][index]).max() for index in range(3)]


def power(states, wrench):
    """Power that the pair is given: the wrench times the difference of the twists at its point."""
    a, b = states
    r = turned(b.orientation)
    point = r.apply(wrench.point) + b.position
    force, torque = r.apply(wrench.force), r.apply(wrench.torque)
    speed = [np.array(m.velocity) + np.cross(m.angular_velocity, point - m.position) for m in states]
    return force @ (speed[0] - speed[1]) + torque @ np.subtract(a.angular_velocity, b.angular_velocity)


wrenches = st.builds(
    PAIR.Wrench,
    vectors.map(lambda v: PAIR.scale(100.0, v)),
    vectors.map(lambda v: PAIR.scale(10.0, v)),
    vectors,
)


@given(bodies(), bodies(), motions, motions, st.lists(wrenches, min_size=1, max_size=8), vectors)
@settings(max_examples=60)
def test_momentum_of_the_pair_is_conserved_about_any_point_whatever_the_step(a, b, one, two, pushes, about):
    states = one, two
    before, size = momenta((a, b), states, about)
    for number, wrench in enumerate(pushes * 20):
        states = PAIR.advance((a, b), states, wrench, (1e-3, 1e-2, 0.05)[number % 3])
        assert abs(PAIR.length(states[0].orientation) - 1.0) < 1e-15
    after, late = momenta((a, b), states, about)
    for index in (0, 1):
        assert np.abs(after[index] - before[index]).max() <= 1e-12 * (size[index] + late[index])


@given(bodies(), bodies(), motions, motions, wrenches)
@settings(max_examples=20, deadline=None)
def test_kinetic_energy_grows_by_the_work_of_the_wrench(a, b, one, two, wrench):
    """The work is integrated by Simpson's rule over pairs of steps."""
    states, step, count = (one, two), 1e-3, 100
    before, _ = momenta((a, b), states)
    powers = [power(states, wrench)]
    for _ in range(count):
        states = PAIR.advance((a, b), states, wrench, step)
        powers.append(power(states, wrench))
    work = step / 3.0 * np.dot([1.0, *[4.0, 2.0] * (count // 2 - 1), 4.0, 1.0], powers)
    after, size = momenta((a, b), states)
    assert after[2] - before[2] == pytest.approx(
        work, abs=1e-9 * (size[2] + np.abs(powers).max() * step * count)
    )


def textbook(bodies_, wrench, t, y):
    """Eqs. (3) to (9) as they stand, for states of position, orientation, velocity and angular velocity."""
    a, b = y[:13], y[13:]
    r = Rotation.from_quat(b[3:7], scalar_first=True)
    force, torque = r.apply(wrench.force), r.apply(wrench.torque)
    sensor = b[:3] + r.apply(wrench.point)
    result = []
    for sign, body, s in ((1.0, bodies_[0], a), (-1.0, bodies_[1], b)):
        q, v, omega = s[3:7], s[7:10], s[10:13]
        m = Rotation.from_quat(q, scalar_first=True).as_matrix()
        inertia = m @ np.array(body.inertia) @ m.T
        moment = sign * (torque + np.cross(sensor - s[:3], force))
        spin = np.linalg.solve(inertia, moment - np.cross(omega, inertia @ omega))
        w, vector = q[0], q[1:]
        turn = 0.5 * np.array([-omega @ vector, *(w * omega + np.cross(omega, vector))])
        result += [*v, *turn, *(sign * force / body.mass), *spin]
    return result


@given(bodies(), bodies(), motions, motions, wrenches)
@settings(max_examples=8, deadline=None)
def test_motion_is_that_of_the_equations_integrated_by_another_method(a, b, one, two, wrench):
    y = np.concatenate([np.concatenate(one), np.concatenate(two)])
    solution = solve_ivp(
        lambda t, y: textbook((a, b), wrench, t, y), (0.0, 1.0), y, method="DOP853", rtol=1e-12, atol=1e-13
    )
    states = one, two
    for _ in range(1000):
        states = PAIR.advance((a, b), states, wrench, 1e-3)
    found = np.concatenate([np.concatenate(states[0]), np.concatenate(states[1])])
    assert found == pytest.approx(solution.y[:, -1], rel=1e-9, abs=1e-9)


def test_integration_is_of_fourth_order_and_its_error_is_what_the_bound_on_turning_allows():
    """A tumbling body, three unlike moments: halving the step makes the error 16 times smaller."""
    tensor = ((40.0, 2.0, 1.0), (2.0, 55.0, 3.0), (1.0, 3.0, 70.0))
    body = PAIR.Body(300.0, tensor, PAIR.inverted(tensor))
    wrench = PAIR.Wrench((0.0,) * 3, (0.0,) * 3, (0.0,) * 3)

    def tumble(step, count):
        states = (PAIR.Motion((0.0,) * 3, PAIR.UNIT, (0.0,) * 3, (0.6, 0.6, 0.5)),) * 2
        before = momenta((body, body), states)[0][2]
        for _ in range(count):
            states = PAIR.advance((body, body), states, wrench, step)
        return states[0], abs(momenta((body, body), states)[0][2] / before - 1.0)

    exact, _ = tumble(0.0025, 4000)
    errors, energies = [], []
    for step in (0.1, 0.05, 0.025):
        found, energy = tumble(step, round(10.0 / step))
        errors.append((turned(found.orientation) * turned(exact.orientation).inv()).magnitude())
        energies.append(energy)
    assert np.log2(np.array(errors[:-1]) / errors[1:]) == pytest.approx(4.0, abs=0.3)
    # |omega| is 0.985 rad/s: in 0.1 s the body turns as far as is allowed.
    assert energies[0] < 1e-7 * 100
    assert energies[2] < energies[0] / 200.0


def test_wrench_stays_put_in_the_turning_frame_of_the_target():
    """A torque about the axis that B turns about changes nothing else; a fixed direction would."""
    light = PAIR.Body(10.0, ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), None)
    light = light._replace(inverse=PAIR.inverted(light.inertia))
    spinning = PAIR.Motion((0.0,) * 3, PAIR.UNIT, (0.0,) * 3, (0.0, 0.0, 1.0))
    still = spinning._replace(angular_velocity=(0.0,) * 3)
    wrench = PAIR.Wrench((1.0, 0.0, 0.0), (0.0,) * 3, (0.0,) * 3)
    states = still, spinning
    for _ in range(100):
        states = PAIR.advance((light, light), states, wrench, 0.01)
    # F/m (cos t, sin t) integrated twice over 1 s.
    assert states[0].velocity[:2] == pytest.approx(
        (0.1 * math.sin(1.0), 0.1 * (1.0 - math.cos(1.0))), rel=1e-9
    )
    assert states[0].position[:2] == pytest.approx(
        (0.1 * (1.0 - math.cos(1.0)), 0.1 * (1.0 - math.sin(1.0))), rel=1e-8
    )


# --- motion mapping, Eqs. (10) to (16)

DIFFERENCE = 1e-5


def moved(motion, time):
    """The motion a little later, at constant twist: poses to differentiate."""
    turn = Rotation.from_rotvec(np.multiply(motion.angular_velocity, time)) * turned(motion.orientation)
    place = np.add(motion.position, np.multiply(motion.velocity, time))
    return motion._replace(position=tuple(place), orientation=tuple(turn.as_quat(scalar_first=True)))


def differentiated(pose_at):
    """Velocity and angular velocity of a pose by central differences."""
    late, early = pose_at(DIFFERENCE), pose_at(-DIFFERENCE)
    velocity = np.subtract(late.position, early.position) / (2.0 * DIFFERENCE)
    turn = turned(late.orientation) * turned(early.orientation).inv()
    return velocity, turn.as_rotvec() / (2.0 * DIFFERENCE)


def matrix(motion):
    """The homogeneous transformation of a pose."""
    t = np.eye(4)
    t[:3, :3], t[:3, 3] = turned(motion.orientation).as_matrix(), motion.position
    return t


@given(motions, vectors, scalar_first)
@settings(max_examples=50)
def test_twist_of_a_frame_fixed_to_a_body_is_that_of_its_poses(motion, place, orientation):
    """Eqs. (10) and (11)."""
    frame = PAIR.attached(motion, place, orientation)
    fixed = matrix(PAIR.Motion(place, orientation, (0.0,) * 3, (0.0,) * 3))
    assert matrix(frame) == pytest.approx(matrix(motion) @ fixed, abs=1e-14)
    velocity, omega = differentiated(lambda time: PAIR.attached(moved(motion, time), place, orientation))
    assert frame.velocity == pytest.approx(velocity, abs=1e-8)
    assert frame.angular_velocity == pytest.approx(omega, abs=1e-8)
    back = PAIR.detached(frame, place, orientation)
    assert np.concatenate(back) == pytest.approx(np.concatenate(motion), abs=1e-13)


@given(motions, motions)
@settings(max_examples=50)
def test_relative_twist_is_that_of_the_relative_poses(a, b):
    """Eqs. (12) and (13) as corrected: T_Bi^-1 T_Ai, and its derivative."""
    seen = PAIR.relative(a, b)
    assert matrix(seen) == pytest.approx(np.linalg.inv(matrix(b)) @ matrix(a), abs=1e-13)
    velocity, omega = differentiated(lambda time: PAIR.relative(moved(a, time), moved(b, time)))
    assert seen.velocity == pytest.approx(velocity, abs=1e-8)
    assert seen.angular_velocity == pytest.approx(omega, abs=1e-8)
    back = PAIR.composed(b, seen)
    assert np.concatenate(back) == pytest.approx(np.concatenate(a), abs=1e-12)


def test_equations_12_and_13_as_printed_are_not_the_relative_motion():
    """Why they are corrected: 1 m apart, B turning at 1 rad/s, both at rest otherwise."""
    b = PAIR.Motion((0.0,) * 3, PAIR.UNIT, (0.0,) * 3, (0.0, 0.0, 1.0))
    a = PAIR.Motion((1.0, 0.0, 0.0), PAIR.UNIT, (0.0,) * 3, (0.0,) * 3)
    velocity, _ = differentiated(lambda time: PAIR.relative(moved(a, time), moved(b, time)))
    assert velocity == pytest.approx([0.0, -1.0, 0.0], abs=1e-9)
    assert PAIR.relative(a, b).velocity == (0.0, -1.0, 0.0)  # Eq. (12) prints v_A - v_B, which is zero
    printed = np.linalg.inv(matrix(a)) @ matrix(b)
    assert printed[:3, 3].tolist() == [-1.0, 0.0, 0.0]  # where B is, seen from A


# --- the FMU


def arrays(**values):
    """Start values of arrays, by element."""
    found = {}
    for name, numbers in values.items():
        entry = next(entry for entry in PAIR.ENTRIES if entry.name == name)
        found |= dict(zip(entry.elements(), np.ravel(numbers).tolist(), strict=True))
    return found


def read(instance: Instance, name: str) -> np.ndarray:
    entry = next(entry for entry in PAIR.ENTRIES if entry.name == name)
    return np.array(instance.get(*entry.elements()))


@given(motions, motions, vectors, vectors, scalar_first, scalar_first)
@settings(max_examples=20)
def test_relative_start_is_met_whatever_the_frames(start, b, place_a, place_b, turn_a, turn_b):
    model = PAIR.SatellitePair(instance_name="pair")
    for name, value in zip(POSE, start, strict=True):
        setattr(model, f"start_{name}", value)
    for name, value in zip(POSE, b, strict=True):
        setattr(model, f"{name}_b", value)
    model.assembly_position_a, model.assembly_orientation_a = place_a, turn_a
    model.assembly_position_b, model.assembly_orientation_b = place_b, turn_b
    model.exit_initialization_mode()
    seen = {variable.name: variable.getter() for variable in model.vars.values()}
    for name, value in zip(POSE, start, strict=True):
        found = [seen[f"{name}[{index}]"] for index in range(1, len(value) + 1)]
        assert found == pytest.approx(value, abs=1e-12), name


@pytest.mark.parametrize("form", ["", "-native"], ids=["python", "native"])
def test_oblique_contact_off_centre_conserves_momentum(form, instantiate):
    """10 s at 1 kHz of pushes."""
    pair = instantiate("SatellitePair", form).initialise(
        **arrays(
            inertia_a=[[40.0, 2.0, 1.0], [2.0, 55.0, 3.0], [1.0, 3.0, 70.0]],
            assembly_position_a=[0.5, 0.2, -0.1],
            sensor_position=[0.1, 0.3, 0.2],
            sensor_orientation=[0.5, 0.5, 0.5, 0.5],
            start_velocity=[0.02, 0.01, -0.005],
            start_angular_velocity=[0.02, -0.01, 0.03],
            angular_velocity_b=[0.01, 0.02, -0.01],
        )
    )
    linear, angular = read(pair, "linear_momentum"), read(pair, "angular_momentum")
    spin, fastest = read(pair, "angular_velocity_a"), 0.0
    for number in range(10_000):
        push = 100.0 * max(0.0, math.sin(2e-3 * math.pi * number)) * math.cos(0.02 * number)
        pair.set(**arrays(force=[0.1 * push, 0.2 * push, -push], torque=[0.05 * push, 0.0, 0.02 * push]))
        pair.fmu.doStep(number * 1e-3, 1e-3)
        if number % 100 == 0:
            fastest = max(fastest, np.abs(read(pair, "angular_velocity_a") - spin).max())
    for name, before in (("linear_momentum", linear), ("angular_momentum", angular)):
        assert np.abs(read(pair, name) - before).max() < 1e-11 * np.abs(before).max(), name
    assert abs(np.linalg.norm(read(pair, "orientation")) - 1.0) < 1e-14
    assert fastest > 0.05, "it has been pushed"


@pytest.mark.parametrize("form", ["", "-native"], ids=["python", "native"])
def test_along_the_line_of_centres_it_is_the_one_dimensional_system(form, instantiate):
    pair = instantiate("SatellitePair", form).initialise(**arrays(start_velocity=[0.02, 0.0, 0.0]))
    line = instantiate("SatelliteDynamics", form).initialise(velocity=0.02)
    assert line.get("mass") == (EFFECTIVE_MASS,)
    start = pair.get("kinetic_energy")[0]
    for number in range(4000):
        force = -140.0 * math.sin(0.025 * number) if number % 500 < 125 else 0.0
        line.set(force=force)
        pair.set(**{"force[1]": force})
        for instance in (pair, line):
            instance.fmu.doStep(number * 5e-4, 5e-4)
        (x, v), (distance, speed) = line.get("position", "velocity"), pair.get("position[1]", "velocity[1]")
        assert (distance, speed) == pytest.approx((x, v), rel=1e-12, abs=1e-13)
    change = pair.get("kinetic_energy")[0] - start
    relative = line.get("kinetic_energy")[0] - 0.5 * EFFECTIVE_MASS * 0.02**2
    # Work on the relative motion is all the work there is.
    assert change == pytest.approx(relative, rel=1e-9) and abs(change) > 1e-3
    others = read(pair, "position")[1:].tolist() + read(pair, "angular_velocity").tolist()
    assert others == [0.0] * 5


def refused(instance, action) -> str:
    with pytest.raises(Exception, match="failed with status"):
        action()
    return instance.log[0][1]


@pytest.mark.parametrize(
    ("start", "message"),
    [
        ({"mass_a": 0.0}, "mass_a is 0.0 kg; a finite mass above 0 kg is needed"),
        ({"mass_b": -1.0}, "mass_b is -1.0 kg; a finite mass above 0 kg is needed"),
        (
            {"inertia_a[1,2]": 3.0},
            "inertia_a is not symmetric: [1,2], [1,3], [2,3] are 3.0, 0.0, 0.0 kg.m2 and [2,1], [3,1], [3,2] "
            "are 0.0, 0.0, 0.0 kg.m2; give both of a pair the same value",
        ),
        (
            {"inertia_a[1,2]": 60.0, "inertia_a[2,1]": 60.0},
            "inertia_a is not positive definite: diagonal 50.0, 50.0, 50.0 kg.m2, [1,2], [1,3], [2,3] 60.0, "
            "0.0, 0.0 kg.m2; its three principal moments have to be above 0 kg.m2",
        ),
        (
            {"inertia_b[1,1]": 14000.0},
            "inertia_b violates the triangle inequality: diagonal 14000.0, 6666.666666666667, "
            "6666.666666666667 kg.m2, [1,2], [1,3], [2,3] 0.0, 0.0, 0.0 kg.m2; no principal moment of a body "
            "is above the sum of the other two",
        ),
        (
            {"orientation_b[1]": 1.1, "mass_a": 0.0},
            "mass_a is 0.0 kg; a finite mass above 0 kg is needed; orientation_b has the length 1.1; "
            "allowed: 1 within 1e-06; divide its elements 1.1, 0.0, 0.0, 0.0 by it",
        ),
    ],
)
@pytest.mark.parametrize("form", ["", "-native"], ids=["python", "native"])
def test_refuses_what_no_body_has(form, start, message, instantiate):
    pair = instantiate("SatellitePair", form)
    text = refused(pair, lambda: pair.initialise(**start))
    if not form:
        text = text.split("ValueError(")[1].strip("')\"")
    assert text == f"SatellitePair_0: {message}"


def test_a_flat_plate_is_a_body(instantiate):
    pair = instantiate("SatellitePair")
    pair.initialise(**arrays(inertia_a=[[10.0, 0.0, 0.0], [0.0, 20.0, 0.0], [0.0, 0.0, 30.0]]))


@pytest.mark.parametrize("form", ["", "-native"], ids=["python", "native"])
def test_refuses_a_step_in_which_a_satellite_would_turn_too_far(form, instantiate):
    pair = instantiate("SatellitePair", form).initialise(**arrays(angular_velocity_b=[0.0, 30.0, 0.0]))
    pair.fmu.doStep(0.0, 1e-3)
    text = refused(pair, lambda: pair.fmu.doStep(1e-3, 1e-2))
    assert (
        "SatellitePair_0: satellite A would turn by 0.3 rad in the step from 0.001 s; allowed: 0.1 rad, up "
        "to which the integration is exact to 1e-7; take a smaller step size"
    ) in text


def test_refuses_inputs_that_are_not_finite(instantiate):
    pair = instantiate("SatellitePair").initialise()
    pair.set(**{"torque[2]": math.inf})
    text = refused(pair, lambda: pair.fmu.doStep(0.5, 1e-3))
    assert (
        "SatellitePair_0: in the step from 0.5 s: input torque is 0.0, inf, 0.0 N.m; finite numbers are "
        "needed. Look at what is connected to it"
    ) in text
