"""The bundled docking systems against the characteristic roots of the loop, with every master."""

import cmath
import math

import fmpy
import pytest

from orchestrator.docking.measures import DockingMeasure
from orchestrator.docking.options import DockingOptions
from orchestrator.fmi.bundled import find_fmu
from orchestrator.simulation.run import run

MASS = 279.06976744186045
STIFFNESS = 176e3


def growth_per_contact(omega_n: float, xi_n: float, tau_m: float) -> float:
    """exp(pi sigma/omega) of the root near the contact frequency of

        m s^2 (s^2 + 2 xi_n omega_n s + omega_n^2) + k omega_n^2 exp(-tau_m s) = 0.

    A half-oscillation of the closed loop is one contact. Newton's method from the undelayed root.
    """
    s = 1j * math.sqrt(STIFFNESS / MASS)
    for _ in range(50):
        denominator = s * s + 2 * xi_n * omega_n * s + omega_n**2
        delay = STIFFNESS * omega_n**2 * cmath.exp(-tau_m * s)
        value = MASS * s * s * denominator + delay
        slope = MASS * (2 * s * denominator + s * s * (2 * s + 2 * xi_n * omega_n)) - tau_m * delay
        s -= value / slope
    assert abs(value) < 1e-6 * abs(delay)
    return math.exp(math.pi * s.real / s.imag)


def ratios(result) -> list[float]:
    return [contact["rebound_velocity_ratio"] for contact in result.summary["contacts"]]


def limit_of(result, index: int) -> float:
    """Richardson's extrapolation of a ratio from the step and its half, for an error of first order."""
    change = result.summary["numerics"]["contacts"][index]["rebound_velocity_ratio"]
    return ratios(result)[index] + 2 * change


@pytest.mark.parametrize(
    ("frequency", "tau_ms", "published"),
    [(75, 2, 1.2356), (75, 4, 1.3346), (75, 6, 1.4400), (25, 2, 1.592), (50, 2, 1.319), (100, 2, 1.1956)],
)
def test_uncompensated_rebounds_grow_as_the_roots_say(frequency, tau_ms, published):
    expected = growth_per_contact(2 * math.pi * frequency, 0.8, tau_ms * 1e-3)
    assert expected == pytest.approx(published, rel=3e-4)
    overrides = [f"robot.tau_m={tau_ms} ms", f"robot.omega_n={frequency} Hz", "run.stop_time=2.4 s"]
    result = run("docking-1d-uncompensated", overrides=overrides)
    found = ratios(result)
    assert len(found) >= 4
    for index, ratio in enumerate(found[:8], start=1):
        assert ratio == pytest.approx((-expected) ** index, rel=1e-3 * index)
    changes = [entry["rebound_velocity_ratio"] for entry in result.summary["numerics"]["contacts"]]
    assert all(abs(change) < 1e-3 * abs(ratio) for change, ratio in zip(changes, found, strict=False))


def test_six_milliseconds_of_delay_as_in_the_papers_figure_3():
    """After 7 and 8 contacts: 12.84 and 18.49 times the approach speed (the paper: almost 15)."""
    overrides = ["robot.tau_m=6 ms", "run.stop_time=2.5 s"]
    result = run("docking-1d-uncompensated", overrides=overrides, halving=False)
    contacts = result.summary["contacts"]
    assert contacts[6]["rebound_velocity_ratio"] == pytest.approx(-12.84, rel=1e-3)
    assert contacts[7]["rebound_velocity_ratio"] == pytest.approx(18.49, rel=1e-3)
    assert contacts[6]["peak_force"] == pytest.approx(10.69 * 0.02 * math.sqrt(STIFFNESS * MASS), rel=1e-3)
    assert contacts[6]["side"] == "front" and contacts[7]["side"] == "rear"
    assert contacts[6]["cor"] == pytest.approx(1.4400, rel=1e-3)


def test_jacobi_has_the_same_limit_and_says_how_far_it_is():
    """Jacobi's error is of first order in the step: extrapolating h and h/2 gives the limit."""
    result = run("docking-1d-uncompensated", overrides=["run.master=jacobi", "run.stop_time=1.3 s"])
    expected = growth_per_contact(2 * math.pi * 75, 0.8, 2e-3)
    for index in range(2):
        limit = (-expected) ** (index + 1)
        assert abs(ratios(result)[index]) > 1.005 * abs(limit), "a finite step must show as delay"
        assert limit_of(result, index) == pytest.approx(limit, rel=1e-3)


def test_monolithic_model_agrees_with_the_cosimulation():
    """The whole loop as one FMU, integrated with events: no communication step takes part."""
    recorded = fmpy.simulate_fmu(
        str(find_fmu("UncompensatedDocking")), stop_time=1.2, output_interval=1e-3, output=["velocity"]
    )
    expected = growth_per_contact(2 * math.pi * 75, 0.8, 2e-3)
    assert recorded["velocity"][600] / 0.02 == pytest.approx(-expected, rel=2e-5)
    assert recorded["velocity"][1100] / 0.02 == pytest.approx(expected**2, rel=4e-5)


@pytest.fixture(scope="module")
def active():
    return run("docking-1d")


def test_active_compliance_control_stops_the_divergence(active):
    contacts = active.summary["contacts"]
    assert len(contacts) >= 20
    for contact in contacts[1:]:
        ideal = contact["ideal_velocity_ratio"]
        assert contact["rebound_velocity_ratio"] == pytest.approx(ideal, rel=0.02)
    assert active.summary["stiffness_estimate"] == pytest.approx(STIFFNESS, rel=0.01)
    assert abs(active.summary["damping_estimate"]) < 0.01 * 2 * math.sqrt(STIFFNESS * MASS)


def test_summary_says_what_half_the_step_changes(active):
    numerics = active.summary["numerics"]
    assert numerics["step_size"] == active.summary["run"]["step_size"] / 2
    assert len(numerics["contacts"]) == len(active.summary["contacts"])
    assert 0 < abs(numerics["contacts"][1]["rebound_velocity_ratio"]) < 1e-3
    assert abs(numerics["stiffness_estimate"]) < 1e-3 * STIFFNESS


@pytest.mark.parametrize("delay", ["1 ms", "2 ms"])
def test_lead_compensates_the_sensor_delay(delay):
    """In the limit of small steps: at a finite one, Gauss-Seidel hands the sensor a force of the step's end
    at its begin, which shortens the delay that the controller is given."""
    overrides = [f"sensor.tau_s={delay}", f"controller.tau_s={delay}", "run.step_size=0.1 ms"]
    result = run("docking-1d", overrides=[*overrides, "run.stop_time=2 s"])
    for index in (1, 2):
        assert abs(limit_of(result, index)) == pytest.approx(1.0, abs=2e-3)
    estimate = result.summary["stiffness_estimate"] + 2 * result.summary["numerics"]["stiffness_estimate"]
    assert estimate == pytest.approx(STIFFNESS, rel=0.01)


def test_the_controller_switched_off_lets_the_loop_diverge():
    overrides = ["controller.mode=off", "run.stop_time=2 s"]
    found = ratios(run("docking-1d", overrides=overrides, halving=False))
    growth = growth_per_contact(2 * math.pi * 75, 0.8, 2e-3)
    assert abs(found[2]) > growth**3, "the controller's sampling adds delay to the loop"


def test_active_control_with_jacobi_has_the_same_limit():
    overrides = ["run.master=jacobi", "run.step_size=0.1 ms", "run.stop_time=2 s"]
    result = run("docking-1d", overrides=overrides)
    assert abs(ratios(result)[2]) > 1.01, "a finite step must show as delay"
    for index in (1, 2):
        assert abs(limit_of(result, index)) == pytest.approx(1.0, abs=2e-3)


def test_a_satellite_that_is_pushed_off_from_rest_has_no_first_speed():
    pushed = ["satellite.velocity=0 m/s", "contact.front=-1 mm", "contact.rear=-11 mm", "run.stop_time=1.5 s"]
    result = run("docking-1d-uncompensated", overrides=pushed, halving=False)
    first, second, *_ = result.summary["contacts"]
    for key in ("rebound_velocity_ratio", "ideal_velocity_ratio", "peak_force_ratio"):
        assert [contact[key] for contact in (first, second)] == [None, None]
    assert first["cor"] is None and first["peak_force"] > 100.0
    assert second["cor"] == pytest.approx(growth_per_contact(2 * math.pi * 75.0, 0.8, 2e-3), rel=1e-3)
    measure = DockingMeasure()
    options = DockingOptions(satellite="satellite", robot="robot", contact="contact")
    assert "the satellite was at rest at the start" in measure.headline(result.summary)
    drawn = measure.figures(result.results, options) | measure.comparison({"x": (result.results, options)})
    for figure in drawn.values():
        figure.canvas.draw()
