"""The controller in the closed loop: what it is for. Bench and theory share no code with it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from docking_bench import EFFECTIVE_MASS, DockingBench, restitution
from scipy.optimize import fsolve

CONTACTS = 20


def run(model, sample_period=5e-4, controller=None, delayed=0, **bench):
    """Free velocities over the theoretical ones, and stiffness and damping at the end of every contact.

    Args:
        delayed: age of the controller's inputs in samples; the force is twice as much older again, as with a
            Jacobi master.
    Returns: ratios, shape (contacts,); estimates, shape (contacts, 2); the law's state.
    """
    loop = DockingBench(**bench)
    settings = {"sample_period": sample_period, "tau_s": loop.tau_s, **(controller or {})}
    law = model.ComplianceLaw(model.Parameters(**settings), model.State())
    assert law.parameters.problems() == ""
    estimates, forces, others = [], [0.0] * (3 * delayed), [(0.0,) * 4] * delayed

    def control(force, *rest):
        forces.append(force)
        others.append(rest)
        before = law.state.contact_state
        output = law.sample(model.Inputs(forces.pop(0), *others.pop(0)))
        if before and not law.state.contact_state:
            estimates.append(law.estimates())
        return output

    ratios = np.abs(loop.run(control, sample_period, CONTACTS))
    theory = restitution(loop.mass, loop.stiffness, loop.damping) ** np.arange(1, len(ratios) + 1)
    return ratios / theory, np.array(estimates), law.state


def characteristic_growth(stiffness, tau_m, omega_n, xi_n):
    """Growth per contact without compensation: exp(pi sigma/omega) of the root of m s^2 + k G(s) = 0."""

    def residual(x):
        s = complex(*x)
        servo = omega_n**2 * np.exp(-tau_m * s) / (s * s + 2.0 * xi_n * omega_n * s + omega_n**2)
        value = EFFECTIVE_MASS * s * s / stiffness + servo
        return [value.real, value.imag]

    sigma, omega = fsolve(residual, [1.0, math.sqrt(stiffness / EFFECTIVE_MASS)], xtol=1e-13)
    return math.exp(math.pi * sigma / omega)


@pytest.mark.parametrize(("tau_m", "published"), [(2e-3, 1.23555), (6e-3, 1.43979)])
def test_bench_grows_as_the_characteristic_root_says(tau_m, published):
    """Without a controller, extrapolated to no hold: the bench itself is right."""
    growth = []
    for step in (2e-4, 1e-4):
        bench = DockingBench(tau_m=tau_m, step=step)
        ratios = np.abs(bench.run(lambda force, *_: force, step, 4))
        growth.append(ratios[-1] / ratios[-2])
    expected = characteristic_growth(bench.stiffness, tau_m, bench.omega_n, bench.xi_n)
    assert expected == pytest.approx(published, abs=1e-5)
    assert 2.0 * growth[1] - growth[0] == pytest.approx(expected, rel=2e-4)


@pytest.mark.parametrize("mode", ["off", "lead"])
def test_without_compensation_the_loop_diverges(controller_model, mode):
    ratios, _, _ = run(controller_model, controller={"mode": controller_model.MODES[mode]})
    # 1.2356 and half a sample period of hold on top.
    assert ratios[1:] / ratios[:-1] == pytest.approx(1.247, abs=2e-3)


@pytest.mark.parametrize("sample_period", [5e-4, 1e-3])
@pytest.mark.parametrize(
    ("bench", "controller"),
    [
        ({}, {}),
        ({}, {"initial_stiffness": 352e3}),
        ({}, {"initial_stiffness": 88e3}),
        ({}, {"initial_stiffness": 17.6e3}),
        ({"tau_m": 6e-3}, {}),
        ({"omega_n": 2.0 * math.pi * 25.0}, {}),
        ({"omega_n": 2.0 * math.pi * 25.0, "tau_m": 6e-3}, {"initial_stiffness": 88e3}),
        ({"resolution": 0.5}, {}),
        ({"speed": 5e-3, "front": 1e-3, "rear": -1e-3}, {}),
        ({"speed": 0.1}, {}),
        ({"stiffness": 20e3}, {}),
        ({"damping": 100.0}, {}),
        ({"stiffness": 70e3, "damping": 100.0}, {}),
        ({"tau_s": 1e-3}, {}),
        ({"tau_s": 2e-3}, {}),
    ],
)
def test_every_contact_rebounds_as_theory_says(controller_model, sample_period, bench, controller):
    ratios, estimates, _ = run(controller_model, sample_period, controller, **bench)
    loop = DockingBench(**bench)
    assert len(ratios) == len(estimates) == CONTACTS
    # The demand is 2 % and 1 %; what is reached (README) leaves room, and losing it should be noticed.
    assert np.abs(ratios - 1.0).max() < 0.006
    assert np.abs(np.diff(ratios)).max() < 0.001
    assert np.abs(estimates[1:, 0] / loop.stiffness - 1.0).max() < 0.004
    assert np.abs(estimates[1:, 1] - loop.damping).max() < 4.0


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    "bench", [{}, {"tau_s": 2e-3, "resolution": 0.5}, {"stiffness": 70e3, "damping": 100.0}], ids=str
)
def test_sensor_noise_of_one_newton(controller_model, bench, seed):
    """White, 1 N standard deviation: the noise's own impulse moves the ratio by 0.14 % a contact."""
    ratios, estimates, _ = run(controller_model, noise=1.0, seed=seed, **bench)
    assert np.abs(ratios - 1.0).max() < 0.02
    # The lead multiplies the noise by 2.7.
    limit = 0.015 if "tau_s" in bench else 0.01
    assert np.abs(estimates[1:, 0] / DockingBench(**bench).stiffness - 1.0).max() < limit


def test_stiffness_is_known_after_the_first_contact(controller_model):
    for initial in (17.6e3, 88e3, 352e3):
        _, estimates, _ = run(controller_model, controller={"initial_stiffness": initial})
        assert estimates[0, 0] == pytest.approx(176e3, rel=2e-3)


@pytest.mark.parametrize(
    ("switch", "low", "high"),
    [("hold_compensation", 1.006, 1.010), ("switching_compensation", 1.012, 1.021)],
)
def test_what_each_of_our_additions_is_worth(controller_model, switch, low, high):
    """Growth per contact without it; with both, below 0.01 %."""
    ratios, _, _ = run(controller_model, controller={switch: False})
    growth = ratios[2:] / ratios[1:-1]
    assert low < growth.min() and growth.max() < high
    ratios, _, _ = run(controller_model)
    assert ratios[2:] / ratios[1:-1] == pytest.approx(1.0, abs=1e-4)


def test_a_sensor_delay_left_uncompensated_reads_as_negative_damping(controller_model):
    """-k tau_s; hence the lead comes before the identification."""
    ratios, estimates, _ = run(controller_model, tau_s=2e-3, controller={"tau_s": 0.0})
    assert estimates[0, 1] == pytest.approx(-176e3 * 2e-3, rel=0.03)
    assert ratios[-1] / ratios[-2] > 1.05
    _, estimates, _ = run(controller_model, tau_s=2e-3)
    assert abs(estimates[0, 1]) < 3.0


@pytest.mark.parametrize("step", [5e-4, 1e-4])
def test_inputs_of_a_jacobi_master_are_compensated_by_their_age(controller_model, step):
    ages = {"tau_s": 2.0 * step, "transfer_delay": step}
    ratios, estimates, _ = run(controller_model, step, ages, delayed=1, step=step)
    assert np.abs(ratios - 1.0).max() < 0.004
    assert estimates[-1, 0] == pytest.approx(176e3, rel=3e-3)
    plain, _, _ = run(controller_model, step, delayed=1, step=step)
    assert plain[-1] > 1.2


def test_energy_left_over_at_the_end_of_a_contact_is_small(controller_model):
    _, _, state = run(controller_model)
    assert 0.0 < abs(state.energy_error) < 1e-4 * 0.5 * EFFECTIVE_MASS * 0.02**2


@pytest.mark.parametrize("spread", [0.0, 0.01])
def test_a_frame_that_changes_its_stiffness_is_identified_at_the_next_contact(controller_model, spread):
    loop = DockingBench()
    law = controller_model.ComplianceLaw(
        controller_model.Parameters(stiffness_spread=spread), controller_model.State()
    )
    found = []

    def control(*inputs):
        before = law.state.contact_state
        output = law.sample(controller_model.Inputs(*inputs))
        if before and not law.state.contact_state:
            found.append(law.estimates()[0])
            loop.stiffness = 140e3 if len(found) >= 10 else 176e3
        return output

    loop.run(control, 5e-4, 11)
    assert found[9] == pytest.approx(176e3, rel=1e-3)
    if spread:
        assert found[10] == pytest.approx(140e3, rel=1e-3)
    else:
        # Without the spread the filter, certain by now, takes the change for noise.
        assert found[10] > 145e3
