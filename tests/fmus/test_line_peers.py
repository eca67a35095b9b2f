"""The other controllers in the closed loop: what each does, and what it cannot do."""

from __future__ import annotations

import math

import numpy as np
import pytest
from conftest import load_model
from docking_bench import EFFECTIVE_MASS, DockingBench, restitution

PERIOD = 5e-4
LAG = 2e-3 + 2.0 * 0.8 / (2.0 * math.pi * 75.0)
SLOW = {"tau_m": 6e-3}


def run(name, contacts=8, parameters=None, **bench):
    """Free speeds after each contact over the theoretical ones, the state, samples.

    Returns: ratios, shape (contacts,); state; samples of desired position [m], desired velocity [m/s], force
        on the satellite [N], shape (n, 3).
    """
    model, loop = load_model(name), DockingBench(**bench)
    p, s = model.Parameters(sample_period=PERIOD, **(parameters or {})), model.State()
    samples = []

    def control(*inputs):
        s.samples += 1
        model.sample(p, s, model.Inputs(*inputs))
        samples.append((inputs[3], inputs[4], s.force))
        return s.force

    found = np.abs(loop.run(control, PERIOD, contacts))
    theory = restitution(loop.mass, loop.stiffness, loop.damping) ** np.arange(1, len(found) + 1)
    return found / theory, s, np.array(samples)


def growth(*arguments, **options):
    ratios, _, _ = run(*arguments, **options)
    return float((ratios[-1] / ratios[0]) ** (1.0 / (len(ratios) - 1)))


def force_error(samples):
    """Root mean square of the force less the ideal contact's at the desired motion, over the latter's."""
    place, _, force = samples.T
    ideal = -176e3 * np.sign(place) * np.maximum(0.0, np.abs(place) - 5e-3)
    return np.linalg.norm(force - ideal) / np.linalg.norm(ideal)


def test_plain_admittance_diverges_and_a_low_pass_makes_it_worse():
    # 1.2356 by the characteristic roots, and half a sample period of hold on top.
    assert growth("AdmittanceControl") == pytest.approx(1.247, abs=2e-3)
    assert growth("AdmittanceControl", parameters={"filter_time": 5e-3}) > 1.45


def test_virtual_damping_fits_one_rig_only():
    """What stops the growth at 176 N/mm takes a seventh of the speed at 70 N/mm, and fails at 6 ms."""
    tuned = {"virtual_damping": 1010.0}
    assert growth("AdmittanceControl", parameters=tuned) == pytest.approx(1.0, abs=0.02)
    assert growth("AdmittanceControl", parameters=tuned, stiffness=70e3) < 0.86
    assert growth("AdmittanceControl", parameters=tuned, **SLOW) > 1.15


def test_first_order_compensation_stops_the_divergence_it_is_designed_for():
    assert growth("OsakiCompensation", parameters={"delay": LAG}) == pytest.approx(1.0, abs=3e-3)
    slow = {"delay": LAG + 4e-3}
    assert growth("OsakiCompensation", parameters=slow, **SLOW) == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("goal", [0.8, 0.9, 1.0])
def test_first_order_compensation_gives_the_restitution_asked_for(goal):
    """The design takes the robot for a pure delay; it is one and a second-order lag."""
    found = growth("OsakiCompensation", contacts=4, parameters={"delay": LAG, "restitution": goal})
    assert found == pytest.approx(goal, abs=0.03)
    assert found < 1.003


def test_first_order_compensation_needs_the_delay_and_multiplies_noise():
    assert growth("OsakiCompensation", parameters={"delay": LAG}, **SLOW) > 1.15
    _, state, _ = run("OsakiCompensation", parameters={"delay": LAG})
    assert state.lead_time == pytest.approx(LAG, rel=0.15)
    # White noise of sigma comes out as sigma sqrt((1 + T_c/T)^2 + (T_c/T)^2).
    model = load_model("OsakiCompensation")
    p, s = model.Parameters(delay=LAG), model.State()
    noise = np.random.default_rng(1).normal(100.0, 1.0, 5000)
    forces = []
    for value in noise:
        s.samples += 1
        model.sample(p, s, model.Inputs(float(value), 0.0, 0.0, 0.0, 0.0))
        forces.append(s.force)
    factor = state.lead_time / PERIOD
    assert np.std(forces[1:]) == pytest.approx(math.hypot(1.0 + factor, factor), rel=0.05)


def test_design_solves_the_characteristic_equation():
    model = load_model("OsakiCompensation")
    for delay, goal in ((2e-3, 1.0), (5.4e-3, 1.0), (5.4e-3, 0.8), (2e-2, 0.9)):
        p = model.Parameters(delay=delay, restitution=goal)
        right, lead = model.design(p)
        total = delay + 0.5 * p.sample_period
        assert right
        aim = goal / math.sqrt(1.0 + p.stiffness / p.mass * total**2)
        s = complex(0.0, math.sqrt(p.stiffness / p.mass))
        for _ in range(50):  # Newton's method on the closed loop
            grown = p.stiffness * np.exp(-s * total)
            value = p.mass * s * s + grown * (1.0 + lead * s)
            s -= value / (2.0 * p.mass * s + grown * (lead - total * (1.0 + lead * s)))
        assert math.exp(math.pi * s.real / s.imag) == pytest.approx(aim, rel=1e-9)


def test_smith_predictor_is_exact_where_its_models_are():
    ratios, _, samples = run("SmithPredictor")
    assert np.abs(ratios - 1.0).max() < 5e-4
    assert force_error(samples) < 0.01
    ratios, _, _ = run("SmithPredictor", parameters={"damping": 100.0}, damping=100.0)
    assert np.abs(ratios - 1.0).max() < 2e-3
    assert growth("SmithPredictor", parameters={"tau_s": 2e-3}, tau_s=2e-3) == pytest.approx(1.0, abs=2e-3)
    assert growth("SmithPredictor", tau_s=2e-3) > 1.05, "the lead is what compensates the sensor"


@pytest.mark.parametrize(
    ("parameters", "bench"), [({"stiffness": 140e3}, {}), ({}, SLOW)], ids=["stiffness", "robot"]
)
def test_smith_predictor_lives_off_its_models(parameters, bench):
    assert growth("SmithPredictor", parameters=parameters, **bench) > 1.04


@pytest.mark.parametrize(
    "bench",
    [{}, SLOW, {"omega_n": 2.0 * math.pi * 25.0}, {"stiffness": 70e3}, {"damping": 100.0}],
    ids=["nominal", "slow", "25 Hz", "70 N/mm", "damped"],
)
def test_passivity_control_bounds_the_energy_of_any_rig(bench):
    """Told nothing; the ideal contact's rebound, since a spring's work over a contact is its own matter."""
    ratios, state, _ = run("PassivityControl", contacts=12, **bench)
    assert ratios.max() < 1.001
    assert ratios.min() > 0.97
    assert abs(state.energy) < 1e-3 * 0.5 * EFFECTIVE_MASS * 0.02**2


def test_passivity_control_distorts_the_force():
    """Which the others, where they work, do not: the energy is right and the force is not."""
    cases = {"PassivityControl": {}, "OsakiCompensation": {"delay": LAG}, "SmithPredictor": {}}
    errors = {name: force_error(run(name, parameters=reported)[2]) for name, reported in cases.items()}
    assert errors["SmithPredictor"] < 0.01 and errors["OsakiCompensation"] < 0.05
    assert errors["PassivityControl"] > 0.25
    assert force_error(run("PassivityControl", **SLOW)[2]) > 0.35


def test_passivity_observer_books_what_the_two_ports_exchange():
    """Any signals: taken up by the trapezoidal rule, given exactly, since the output is held."""
    model = load_model("PassivityControl")
    p, s = model.Parameters(), model.State()
    source = np.random.default_rng(3)
    rows = source.normal(size=(50, 5)) * (100.0, 1e-3, 0.02, 1e-3, 0.02)
    output, taken_up, given = 0.0, 0.0, 0.0
    for number, row in enumerate(rows):
        if number:
            taken_up += 0.5 * (row[0] + rows[number - 1][0]) * (row[1] - rows[number - 1][1])
            given += output * (row[3] - rows[number - 1][3])
        s.samples += 1
        model.sample(p, s, model.Inputs(*map(float, row)))
        output = s.force
        assert s.energy == pytest.approx(taken_up - given, abs=1e-12)
        assert 0.0 <= s.damping <= p.maximum_damping
