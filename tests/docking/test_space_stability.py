"""Stability in space: equations of satellites against their FMU, roots against a model by hand and runs."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from orchestrator.docking.space_point import satellites_law
from orchestrator.fmi import Point
from orchestrator.frequency.from_system import linearise
from orchestrator.simulation.run import prepare, run

PLAIN = "docking-6d-uncompensated"
# A slow approach: the push hardly turns the satellites, so that one linear system holds for the contact.
SLOW = ["contact.front=-5.8 mm", "run.stop_time=0.4 s", "satellites.start_velocity[1]=2 mm/s"]
MIDDLE = 0.0935
POSE = (("position", 3), ("orientation", 4), ("velocity", 3), ("angular_velocity", 3))
WRENCH = [f"{name}[{index}]" for name in ("force", "torque") for index in (1, 2, 3)]
OUTPUTS = [f"{name}[{index}]" for name, size in POSE for index in range(1, size + 1)]


def test_equations_of_satellites_are_those_of_their_fmu():
    """Both satellites turn about all axes, all frames are oblique: a force's step, run forth by the FMU."""
    one = next(one for one in prepare(PLAIN).system.instances if one.name == "satellites")
    draw = np.random.default_rng(5)
    start = dict(one.start)
    for name in (
        "assembly_orientation_a",
        "assembly_orientation_b",
        "sensor_orientation",
        "start_orientation",
    ):
        start |= numbered(name, Rotation.random(random_state=draw).as_quat(scalar_first=True))
    start |= numbered("orientation_b", Rotation.random(random_state=draw).as_quat(scalar_first=True))
    for name in ("start_velocity", "start_angular_velocity", "angular_velocity_b", "start_position"):
        start |= numbered(name, draw.uniform(-0.3, 0.3, 3))
    values = draw.uniform(-20.0, 20.0, 6)
    step, count, height = 1e-3, 40, 1e-2
    for column in range(6):
        courses = []
        for sign in (1.0, -1.0):
            instance = one.fmu.instantiate("pair")
            inputs = values.copy()
            instance.bind(WRENCH, inputs, [], np.zeros(0))
            instance.enter_initialisation(0.0, {**start, **dict(zip(WRENCH, values, strict=True))}, None)
            instance.exit_initialisation()
            instance.write_inputs()
            space = satellites_law(instance).space
            inputs[column] += sign * height
            course = []
            for index in range(count):
                instance.write_inputs()
                instance.do_step(Point(index, index * step, step))
                course.append([float(value) for value in instance.get_values(OUTPUTS).values()])
            courses.append(np.array(course))
            instance.free()
        found = (courses[0] - courses[1]) / (2.0 * height)
        whole = np.zeros((16, 16))
        whole[:15, :15], whole[:15, 15] = space.a, space.b[:, column]
        expected = [(scipy.linalg.expm(whole * step * n)[:15, 15] @ space.c.T) for n in range(1, count + 1)]
        # The operating point moves on meanwhile: what it adds grows with time.
        size = np.max(abs(found), axis=0)
        for (name, _), part in zip(POSE, np.split(np.arange(13), (3, 7, 10)), strict=True):
            assert np.max(abs(found - expected)[0, part]) < 1e-3 * np.max(abs(found[0, part])), name
            assert np.max(abs(found - expected)[:, part]) < 0.03 * np.max(size[part]), name


def numbered(name: str, values: np.ndarray) -> dict[str, float]:
    return {f"{name}[{index}]": float(value) for index, value in enumerate(values, 1)}


def test_roots_of_a_contact_are_those_of_a_model_by_hand_and_of_runs():
    linear = linearise(prepare(PLAIN, SLOW), at_time=MIDDLE)
    modes = linear.modes(10)
    (root,) = (one.root for one in modes.modes if one.root.imag > 10.0 and one.root.real > -10.0)
    point = {name: float(value) for name, value in linear.point.items()}
    s = by_hand(point, root)
    # By hand they rest, and frames do not turn with B: so much the motion makes.
    assert s == pytest.approx(root, rel=5e-5)
    # The push turns the rod away: a pendulum upside down.
    slow = max(one.root.real for one in modes.modes if one.root.imag == 0.0)
    assert by_hand(point, slow) == pytest.approx(slow, rel=0.02)
    coarse, fine = measured("0.5 ms"), measured("0.25 ms")
    assert abs(fine - coarse) < 2e-5 * abs(fine)
    assert fine.real == pytest.approx(root.real, rel=0.005)
    assert fine.imag == pytest.approx(root.imag, rel=2e-4)


@pytest.mark.slow
def test_an_arm_of_rigid_bodies_that_names_no_states_has_the_roots_of_stiff_joints():
    pytest.importorskip("pinocchio", reason="needs the extra multibody")
    stiff, bodies = (linearise(prepare(f"docking-6d-{arm}"), at_time=0.31) for arm in ("arm", "multibody"))
    assert len(bodies.parts["servos"].states) == 14
    roots = [
        next(one.root for one in linear.modes(12).modes if 20.0 < one.root.imag < 40.0)
        for linear in (stiff, bodies)
    ]
    assert roots[1].imag == pytest.approx(roots[0].imag, rel=1e-5)
    assert roots[1].real == pytest.approx(roots[0].real, abs=1e-4)
    # The drives take each joint alone; the masses that the last axis moves are too small to be seen there.
    drive = 471.23889803846896 * (-0.8 + 0.6j)
    poles = np.linalg.eigvals(bodies.parts["servos"].a)
    assert np.min(abs(poles - drive)) < 1e-3 * abs(drive)


def measured(step: str) -> complex:
    """Rate and frequency of what a small change of the approach changes of the contact's force [rad/s]."""

    def push(speed: float) -> tuple[np.ndarray, np.ndarray]:
        overrides = [*SLOW, f"run.step_size={step}", f"satellites.start_velocity[1]={speed} m/s"]
        found = run(PLAIN, overrides=overrides, halving=False, figures=False).results
        force = np.column_stack([found[f"contact.force[{index}]"] for index in (1, 2, 3)])
        return found.time, np.linalg.norm(force, axis=1)

    (time, one), (_, other) = push(2e-3), push(2.001e-3)
    touching = np.flatnonzero((one > 0.0) & (other > 0.0))
    # From where the robot's own oscillation has died away.
    first, last = touching[0] + round(0.02 / (time[1] - time[0])), touching[-1] - 3
    since, change = time[first:last] - time[first], (other - one)[first:last] / np.max(other - one)

    def left(at: np.ndarray) -> np.ndarray:
        wave = np.exp(complex(*at) * since)
        parts = np.column_stack([wave.real, wave.imag, np.ones_like(since), since])
        return parts @ np.linalg.lstsq(parts, change, rcond=None)[0] - change

    found = least_squares(left, [0.0, 25.0], xtol=1e-14, ftol=1e-14)
    assert np.max(abs(found.fun)) < 1e-5
    return complex(*found.x)


def crossed(a: np.ndarray) -> np.ndarray:
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


def by_hand(point: dict[str, float], s: complex) -> complex:
    """The root near s of two bodies at rest, with the contact's spring behind the robot's lag and delay.

    Displacements of the centres of mass and small turns of A and B, in a frame that stands still where B's
    assembly frame is: M(s) (a, alpha, b, beta) = 0. The bundled system's figures are written out.
    """
    tip, normal = np.array([0.0, 0.03, 0.0]), np.array([-1.0, 0.2, 0.1]) / np.linalg.norm([-1.0, 0.2, 0.1])
    sensor, spring = np.array([0.1, 0.05, 0.0]), 176e3
    bodies = (300.0, 50.0 * np.eye(3)), (4000.0, np.diag([8000.0, 20000.0, 20000.0]) / 3.0)
    lever_a, lever_b = np.array([0.5, 0.0, 0.0]), np.array([-2.0, 0.0, 0.0])
    place = np.array([point[f"satellites.position[{index}]"] for index in (1, 2, 3)])
    touched = np.array([point[f"contact.position[{index}]"] for index in (1, 2, 3)]) + tip
    force = spring * (-normal @ touched - (-5.8e-3)) * normal
    centre_a, centre_b = place - lever_a, -lever_b

    torque_a, torque_b = np.cross(touched - centre_a, force), -np.cross(touched - centre_b, force)
    turning = [np.linalg.solve(bodies[0][1], torque_a), np.linalg.solve(bodies[1][1], torque_b)]

    def matrix(s: complex) -> np.ndarray:
        omega, xi = 471.23889803846896, 0.8
        lag = omega**2 / (s**2 + 2.0 * xi * omega * s + omega**2) * np.exp(-2e-3 * s)
        a, alpha, b, beta = np.split(np.eye(12), 4)
        # The command of the robot: O_Ai in O_Bi.
        own_a, own_b = a - crossed(lever_a) @ alpha, b - crossed(lever_b) @ beta
        seen, turn = own_a - own_b + crossed(place) @ beta, alpha - beta
        end = lag * (seen - crossed(tip) @ turn)
        d_force = -spring * np.outer(normal, normal) @ end
        # The reading is put on B at its sensor: it turns with B.
        d_moment = crossed(touched - sensor) @ d_force - crossed(force) @ end
        moment = np.cross(touched - sensor, force)
        at = own_b - crossed(sensor) @ beta
        d_force = d_force - crossed(force) @ beta
        d_moment = d_moment - crossed(moment) @ beta

        def about(centre: np.ndarray, moved: np.ndarray) -> np.ndarray:
            return d_moment + crossed(sensor - centre) @ d_force - crossed(force) @ (at - moved)

        rows = []
        for (mass, inertia), moved, turned, sign, torque, rate in (
            (bodies[0], a, alpha, 1.0, about(centre_a, a), turning[0]),
            (bodies[1], b, beta, -1.0, about(centre_b, b), turning[1]),
        ):
            # An inertia that turns, in a body whose spin changes at a rate.
            carried = inertia @ crossed(rate) - crossed(inertia @ rate)
            rows += [
                mass * s**2 * moved - sign * d_force,
                (s**2 * inertia + carried) @ turned - sign * torque,
            ]
        return np.vstack(rows)

    def determinant(s: complex) -> complex:
        return complex(np.linalg.det(matrix(s) / np.linalg.norm(matrix(s), axis=1, keepdims=True)))

    for _ in range(30):
        step = 1e-6 * abs(s)
        slope = (determinant(s + step) - determinant(s - step)) / (2.0 * step)
        s = s - determinant(s) / slope
    return complex(s)
