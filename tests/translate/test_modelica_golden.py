"""The shipped Modelica FMUs against closed forms and an integration that shares nothing with them."""

from __future__ import annotations

import modelica_bench as bench
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

# Signal -> tolerance in its unit, for the FMU against its reference: the libraries' last bits.
REPLAY = {
    "position": 1e-13,
    "velocity": 1e-11,
    "force": 1e-7,
    "penetration": 1e-15,
    "measured_force": 1e-9,
    "point": 1e-15,
    "stored_energy": 1e-12,
    "measured_torque": 1e-9,
    "voltage": 1e-12,
    "motor_position": 1e-13,
    "motor_velocity": 1e-11,
    "load_position": 1e-13,
    "load_velocity": 1e-11,
    "upper": 1e-12,
    "lower": 1e-12,
    "integral": 1e-12,
    "angle": 1e-11,
    "deviation": 1e-12,
    "command": 1e-12,
    "exchange": 1e-11,
}
REPLAY |= {
    name: 1e-11 if "velocity" in name else 1e-13
    for model in ("JointServos", "CartesianResponse")
    for name in bench.OUTPUTS[model]
}
OMEGA, XI = 471.23889803846896, 0.8


@pytest.mark.parametrize("name", bench.INPUTS)
@pytest.mark.parametrize("suffix", ["", "-fmi3"])
def test_fmu_gives_its_reference(name, suffix):
    path = bench.FMUS / name / f"{name}{suffix}.fmu"
    reference = bench.read(name)
    rows = bench.run(name, path)
    assert len(rows) == len(reference["time"])
    for signal in bench.OUTPUTS[name]:
        found = np.array([row[signal] for row in rows])
        np.testing.assert_allclose(
            found,
            reference[signal],
            rtol=0,
            atol=REPLAY.get(signal, REPLAY.get(signal.split("[")[0])),
            err_msg=signal,
        )


def jumps(times: np.ndarray, held: np.ndarray) -> list[tuple[float, float]]:
    """Time and size of every jump of an input whose row i acts over the step that ends at times[i]."""
    return [(times[i - 1], held[i] - held[i - 1]) for i in range(1, len(held)) if held[i] != held[i - 1]]


def test_robot_response_is_the_closed_form():
    reference = bench.read("RobotResponse")
    times, tau = reference["time"], bench.START["RobotResponse"]["tau_m"]
    damped = OMEGA * np.sqrt(1 - XI**2)
    position, velocity = np.zeros_like(times), np.zeros_like(times)
    for when, size in jumps(times, reference["command"]):
        t = np.maximum(times - when - tau, 0.0)
        decay = np.exp(-XI * OMEGA * t)
        position += size * (1 - decay * (np.cos(damped * t) + XI * OMEGA / damped * np.sin(damped * t)))
        velocity += size * OMEGA**2 / damped * decay * np.sin(damped * t)
    np.testing.assert_allclose(reference["position"], position, rtol=0, atol=1e-12)
    np.testing.assert_allclose(reference["velocity"], velocity, rtol=0, atol=5e-10)
    assert np.ptp(position) > 1.4e-3


def second_order(t: np.ndarray, omega: float = OMEGA, xi: float = XI) -> tuple[np.ndarray, np.ndarray]:
    """Answer to a unit step t seconds ago, and its rate."""
    t = np.maximum(t, 0.0)
    damped = omega * np.sqrt(1 - xi**2)
    decay = np.exp(-xi * omega * t)
    answer = 1 - decay * (np.cos(damped * t) + xi * omega / damped * np.sin(damped * t))
    return answer, omega**2 / damped * decay * np.sin(damped * t)


def test_joint_servos_are_the_closed_form():
    reference = bench.read("JointServos")
    times, start = reference["time"], bench.START["JointServos"]
    for axis in range(1, 8):
        position, velocity = np.full_like(times, bench.JOINTS[axis - 1]), np.zeros_like(times)
        found = jumps(times, reference[f"joint_command[{axis}]"])
        assert len(found) == 1
        for when, size in found:
            own = {"omega": start.get(f"omega_n[{axis}]", OMEGA), "xi": start.get(f"xi_n[{axis}]", XI)}
            answer, rate = second_order(times - when - start["tau_m"], **own)
            position, velocity = position + size * answer, velocity + size * rate
        np.testing.assert_allclose(reference[f"joint_position[{axis}]"], position, rtol=0, atol=2e-12)
        np.testing.assert_allclose(reference[f"joint_velocity[{axis}]"], velocity, rtol=0, atol=5e-9)
        step = start["rail_resolution" if axis == 1 else "angle_resolution"]
        read = reference[f"measured_position[{axis}]"] / step
        np.testing.assert_allclose(read, np.round(read), atol=1e-9)
        assert np.abs(read * step - position).max() <= 0.5 * step * (1 + 1e-6)


def test_cartesian_response_is_the_closed_form():
    """Position along each axis; orientation and angular velocity from the rotation vector, by scipy."""
    reference = bench.read("CartesianResponse")
    times, start = reference["time"], bench.START["CartesianResponse"]
    turn = np.zeros((3, len(times)))
    for axis in range(3):
        moved, turn[axis] = np.zeros_like(times), bench.CARTESIAN[0][1][axis]
        for number, when in ((1, 5e-3), (2, 40e-3)):
            step = [
                bench.CARTESIAN[number][kind][axis] - bench.CARTESIAN[number - 1][kind][axis]
                for kind in (0, 1)
            ]
            t = times - when - start["tau_m"]
            moved += step[0] * second_order(t, start.get(f"omega_n[{axis + 1}]", OMEGA))[0]
            turn[axis] += step[1] * second_order(t, xi=start.get(f"rotation_xi_n[{axis + 1}]", XI))[0]
        np.testing.assert_allclose(reference[f"position[{axis + 1}]"], moved, rtol=0, atol=1e-12)
    base = Rotation.from_quat([0.8, 0.0, 0.6, 0.0], scalar_first=True)
    expected = base * Rotation.from_rotvec(turn.T)
    quaternion = np.array([reference[f"orientation[{k}]"] for k in (1, 2, 3, 4)]).T
    found = Rotation.from_quat(quaternion, scalar_first=True)
    assert (found * expected.inv()).magnitude().max() < 1e-9
    np.testing.assert_allclose(np.linalg.norm(quaternion, axis=1), 1.0, rtol=0, atol=1e-14)


def test_cartesian_angular_velocity_is_the_turn_of_the_orientation():
    """A fine run: the orientation's central difference, resolved in O_t."""
    step, rows = 1e-5, []
    path = bench.FMUS / "CartesianResponse" / "CartesianResponse.fmu"
    names = [
        f"{name}[{k}]"
        for name, size in (("orientation", 4), ("angular_velocity", 3))
        for k in range(1, size + 1)
    ]
    with bench.instance(path, **bench.START["CartesianResponse"], **bench.cartesian_command(0)) as fmu:
        fmu.set(bench.cartesian_command(1))
        for _ in range(1500):
            fmu.step(step)
            rows.append(fmu.get(*names))
    rows = np.array(rows)
    turns = Rotation.from_quat(rows[:, :4], scalar_first=True)
    difference = (turns[2:] * turns[:-2].inv()).as_rotvec() / (2 * step)
    assert np.abs(difference).max() > 50.0
    # From the moment on that the command reaches the servo, where the acceleration jumps.
    np.testing.assert_allclose(rows[232:-1, 4:], difference[231:], rtol=0, atol=2e-2)


def test_docking_contact_is_the_contact_law():
    reference = bench.read("DockingContact")
    x, v = reference["position"], reference["velocity"]
    k, c, front, rear = 176e3, bench.START["DockingContact"]["damping"], 5e-3, -5e-3
    force = np.where(x > front, -np.maximum(k * (x - front) + c * v, 0.0), 0.0)
    force += np.where(x < rear, np.maximum(k * (rear - x) - c * v, 0.0), 0.0)
    np.testing.assert_allclose(reference["force"], force, rtol=1e-13, atol=1e-9)
    np.testing.assert_allclose(
        reference["penetration"], np.maximum(np.maximum(x - front, rear - x), 0.0), atol=1e-16
    )
    # The reference holds what the model exists for: both frames, and a frame that would pull.
    assert force.min() < -500 and force.max() > 500
    assert ((force == 0) & (np.abs(x) > 5e-3)).any()


def test_force_sensor_is_the_closed_form():
    reference = bench.read("ForceSensor")
    start = bench.START["ForceSensor"]
    times = reference["time"]
    analog = np.zeros_like(times)
    for when, size in jumps(times, reference["force"]):
        t = np.maximum(times - when - start["tau_s"], 0.0)
        analog += size * (1 - np.exp(-2 * np.pi * start["cutoff"] * t))
    steps = analog / start["resolution"] + 0.5
    # A value on the edge of a rounding step could fall on either side.
    assert np.abs(steps - np.round(steps)).min() > 1e-6 or (analog == 0).any()
    expected = start["resolution"] * np.floor(steps)
    np.testing.assert_allclose(reference["measured_force"], expected, rtol=0, atol=1e-12)
    assert reference["measured_force"].min() < -139 and reference["measured_force"].max() > 32


def test_uncompensated_docking_is_the_delay_equation():
    """Method of steps: within one delay, the delayed command is a known function of time."""
    reference = bench.read("UncompensatedDocking")
    tau, mass, k, gap = bench.START["UncompensatedDocking"]["robot.tau_m"], 279.06976744186045, 176e3, 5e-3
    times = reference["time"]

    def force(p: float) -> float:
        return -k * (p - gap) if p > gap else k * (-gap - p) if p < -gap else 0.0

    state = np.array([0.0, 0.0, 0.0, 0.02])  # rod position and velocity, satellite position and velocity
    solution = np.empty((4, times.size))
    past = None
    for index in range(int(times[-1] / tau) + 1):
        begin = index * tau
        delayed = past or (lambda t: (0.0, 0.0, 0.0, 0.0))

        def slope(t, y, delayed=delayed):
            p, v, _, w = y
            return [v, OMEGA**2 * (delayed(t - tau)[2] - p) - 2 * XI * OMEGA * v, w, force(p) / mass]

        part = solve_ivp(
            slope,
            (begin, begin + tau),
            state,
            method="DOP853",
            rtol=1e-10,
            atol=1e-14,
            max_step=5e-4,
            dense_output=True,
        )
        here = (times >= begin) & (times < begin + tau)
        if here.any():
            solution[:, here] = part.sol(times[here])
        state, past = part.y[:, -1], part.sol
    scale = np.abs(solution[3]).max()
    np.testing.assert_allclose(reference["velocity"], solution[3], rtol=0, atol=1e-8 * scale)
    np.testing.assert_allclose(reference["position"], solution[2], rtol=0, atol=1e-9)
    expected = np.array([force(p) for p in solution[0]])
    np.testing.assert_allclose(reference["force"], expected, rtol=0, atol=1e-7 * np.abs(expected).max())
    assert np.abs(solution[3]).max() > 1.4 * 0.02


NOMINAL = {
    "RobotResponse": ("LabRobot", {"tau_m": 2.3e-3}, "command", ("position", "velocity")),
    "DockingContact": ("LabContact", {"damping": 500.0}, "position", ("force", "penetration")),
    "ForceSensor": ("LabSensor", {"tau_s": 1.3e-3, "cutoff": 100.0}, "force", ("measured_force",)),
}


@pytest.mark.parametrize("plain", NOMINAL)
def test_at_zero_size_an_fmu_is_the_nominal_one(plain):
    more, start, driven, outputs = NOMINAL[plain]
    rows = []
    for name in (plain, more):
        with bench.instance(bench.FMUS / name / f"{name}.fmu", **start) as fmu:
            rows.append([])
            for step in range(400):
                fmu.set({driven: 8e-3 * np.sin(0.03 * step) * (1e4 if driven == "force" else 1.0)})
                if plain == "DockingContact":
                    fmu.set({"velocity": 0.24 * np.cos(0.03 * step)})
                fmu.step(2e-4)
                rows[-1].append(fmu.get(*outputs))
    one, other = map(np.array, rows)
    assert np.ptp(one, axis=0).min() > 0.0
    assert np.abs(one - other).max(axis=0) == pytest.approx(
        0.0, abs=0.0 if plain == "DockingContact" else 1e-12
    )


def test_smooth_motion_is_a_sinusoid_from_rest():
    reference, start = bench.read("SmoothMotion"), bench.START["SmoothMotion"]
    angle = 2 * np.pi * start["frequency"] * reference["time"]
    position = 0.5 * start["stroke"] * (1 - np.cos(angle))
    np.testing.assert_allclose(reference["position"], position, rtol=0, atol=1e-12)
    velocity = np.pi * start["stroke"] * start["frequency"] * np.sin(angle)
    np.testing.assert_allclose(reference["velocity"], velocity, rtol=0, atol=1e-11)
    assert np.ptp(position) > 0.1


def test_cascade_control_is_its_law():
    reference, start = bench.read("CascadeControl"), bench.START["CascadeControl"]
    asked = start["position_gain"] * (reference["reference"] - reference["position"])
    voltage = start["velocity_gain"] * (asked - reference["velocity"])
    np.testing.assert_allclose(reference["voltage"], voltage, rtol=1e-13, atol=1e-11)
    assert voltage.min() < -50 and voltage.max() > 50


def compliant_drive(x, u):
    position, velocity, load, load_velocity = x
    force = 400e3 * (position - load) + 500.0 * (velocity - load_velocity)
    return [velocity, (35.0 * u[0] - 200.0 * velocity - force) / 40.0, load_velocity, (force + u[1]) / 60.0]


def tank_pair(x, u):
    upper, lower = (5e-5 * np.sqrt(2 * 9.80665 * max(level, 1e-6)) for level in x)
    return [(1e-5 * u[0] - upper) / 0.01, (upper - lower) / 0.01]


def level_control(x, u):
    return [30.0 / 60.0 * (u[0] - u[1])]


def area(x, u):
    angle, deviation, _, mechanical, valve = x
    exchange = 0.2 * (angle - u[2])
    return [
        2 * np.pi * 50 * deviation,
        (mechanical - u[1] - deviation - exchange) / 10.0,
        -0.5 * (21.0 * deviation + exchange),
        (valve - mechanical) / 0.3,
        (u[0] - deviation / 0.05 - valve) / 0.1,
    ]


@pytest.mark.parametrize(
    ("name", "rates", "begin", "outputs"),
    [
        ("CompliantDrive", compliant_drive, [0.0, 0.0, 0.0, 0.02], lambda x, u: x),
        ("TankPair", tank_pair, [0.15, 0.2], lambda x, u: x),
        (
            "LevelControl",
            level_control,
            [9.90285],
            lambda x, u: [30.0 * (u[0] - u[1]) + x[0], x[0]],
        ),
        ("Area", area, [0.0] * 5, lambda x, u: [x[0], x[1], x[2], 0.2 * (x[0] - u[2])]),
    ],
)
def test_components_of_drives_processes_and_grids_are_their_equations(name, rates, begin, outputs):
    """The equations of the README, integrated by another solver from step to step."""
    reference = bench.read(name)
    x, step = np.array(begin), bench.STEPS[name]
    inputs = np.array([reference[one] for one in bench.INPUTS[name]]).T
    for row in range(1, len(inputs)):
        u = inputs[row]
        found = solve_ivp(
            lambda t, x, u=u: rates(x, u), (0.0, step), x, method="DOP853", rtol=1e-11, atol=1e-14
        )
        x = found.y[:, -1]
        for signal, value in zip(bench.OUTPUTS[name], outputs(x, u), strict=True):
            assert reference[signal][row] == pytest.approx(value, rel=1e-6, abs=1e-9), (signal, row)


def test_linear_drive_is_the_closed_form():
    """Between jumps of the force the velocity falls to its final value exponentially."""
    reference, start = bench.read("LinearDrive"), bench.START["LinearDrive"]
    b, rate = start["viscous_friction"], start["viscous_friction"] / start["mass"]
    position, velocity = 0.0, start["velocity"]
    found = [(position, velocity)]
    for voltage, load in zip(reference["voltage"][1:], reference["load"][1:], strict=True):
        final, gone = (start["force_per_voltage"] * voltage + load) / b, np.exp(-rate * 1e-3)
        position += final * 1e-3 + (velocity - final) * (1 - gone) / rate
        velocity = final + (velocity - final) * gone
        found.append((position, velocity))
    expected = np.array(found)
    np.testing.assert_allclose(reference["position"], expected[:, 0], rtol=0, atol=1e-10)
    np.testing.assert_allclose(reference["velocity"], expected[:, 1], rtol=0, atol=1e-9)
    assert expected[:, 1].max() > 0.07


FRICTION = bench.FMUS / "FrictionForce" / "FrictionForce.fmu"


def test_coulomb_damper_is_its_law():
    reference, start = bench.read("CoulombDamper"), bench.START["CoulombDamper"]
    v = reference["velocity"]
    np.testing.assert_allclose(
        reference["force"], start["level"] * v / np.hypot(v, start["width"]), rtol=1e-13, atol=1e-9
    )
    assert np.ptp(reference["force"]) > 17e3


def test_friction_force_is_its_laws():
    """Each law by itself, along a path whose friction is known in closed form."""
    v, h = 0.01, 1e-3
    ways = np.arange(201) * h * v  # one way, at one speed
    laws = {
        "viscous": (30.0, {}, 30.0 * v),
        "one_sided": (5.0, {}, 5.0 * v),
        "drag": (40.0, {}, 40.0 * v * v),
        "stiffness": (200.0, {}, 200.0 * ways),
        "level": (20.0, {"distance": 5e-4}, 20.0 * (1.0 - np.exp(-ways / 5e-4))),
        "slip_level": (
            10.0,
            {"slip_distance": 1e-3},
            2.5 * sum(np.minimum(ways / (1e-3 * share), 1.0) for share in (0.125, 0.25, 0.5, 1.0)),
        ),
        "bearing_level": (
            15.0,
            {"bearing_distance": 5e-4, "play": 1e-3},
            15.0 * np.clip((ways - 5e-4) / 5e-4, 0.0, 1.0),
        ),
    }
    for name, (size, shape, expected) in laws.items():
        for sign in (1.0, -1.0):
            found = []
            with bench.instance(FRICTION, **{name: size}, **shape, velocity=sign * v) as fmu:
                for index in range(len(ways)):
                    if index:
                        fmu.fmu.doStep(currentCommunicationPoint=(index - 1) * h, communicationStepSize=h)
                    found += fmu.get("force")
            mirrored = expected if name == "one_sided" else sign * expected
            np.testing.assert_allclose(
                found, np.broadcast_to(mirrored, len(ways)), atol=2e-4 * size, err_msg=name
            )
    # At once, where no distance is given, with more for breaking away.
    with bench.instance(FRICTION, level=20.0, excess=0.5, stribeck_velocity=v, width=v, velocity=v) as fmu:
        assert fmu.get("force")[0] == pytest.approx(
            20.0 * (1.0 + 0.5 * np.exp(-1.0)) / np.sqrt(2.0), rel=1e-12
        )
