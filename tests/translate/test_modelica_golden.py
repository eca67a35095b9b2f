"""The shipped Modelica FMUs against closed forms and an integration that shares nothing with them."""

from __future__ import annotations

import modelica_bench as bench
import numpy as np
import pytest
from scipy.integrate import solve_ivp

# Signal -> tolerance in its unit, for the FMU against its reference: the libraries' last bits.
REPLAY = {"position": 1e-13, "velocity": 1e-11, "force": 1e-7, "penetration": 1e-15, "measured_force": 1e-9}
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
        np.testing.assert_allclose(found, reference[signal], rtol=0, atol=REPLAY[signal], err_msg=signal)


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
