"""Parts of the controller on their own: phase lead, Sage-Husa filter, signs, limits."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

SAMPLE_PERIOD = 5e-4


@pytest.mark.parametrize("tau_s", [1e-3, 4e-3])
@pytest.mark.parametrize("frequency", [1.0, 4.0, 8.0])
def test_phase_lead_is_one_plus_tau_s_times_s_at_contact_frequencies(controller_model, tau_s, frequency):
    omega, filter_time = 2.0 * math.pi * frequency, 1e-3
    time = np.arange(0.0, 2.0, SAMPLE_PERIOD)
    signal = np.sin(omega * time)
    output, rate, previous = [], 0.0, 0.0
    for force in signal:
        lead, rate = controller_model.phase_lead(force, previous, rate, SAMPLE_PERIOD, tau_s, filter_time)
        previous = force
        output.append(lead)
    settled = time > 1.0
    basis = np.column_stack([np.sin(omega * time[settled]), np.cos(omega * time[settled])])
    in_phase, quadrature = np.linalg.lstsq(basis, np.array(output)[settled], rcond=None)[0]
    # The filtered difference lags by its time constant and about half a sample.
    lag = tau_s * omega * omega * (filter_time + SAMPLE_PERIOD)
    assert abs(complex(in_phase, quadrature) - complex(1.0, tau_s * omega)) < lag
    assert abs(math.atan2(quadrature, in_phase) - math.atan(tau_s * omega)) < 1.2 * lag * tau_s * omega + 5e-4


def test_phase_lead_without_delay_or_filter(controller_model):
    assert controller_model.phase_lead(3.0, 1.0, 7.0, SAMPLE_PERIOD, 0.0, 1e-3)[0] == 3.0
    assert controller_model.phase_lead(3.0, 1.0, 7.0, 0.5, 0.25, 0.0) == (4.0, 4.0)


def make_filter(model, forgetting_factor=0.98, **state):
    start = {"stiffness": 1e5, "p_kk": 1e10, "p_cc": 4e4, "r": 1.0, **state}
    return model.SageHusaFilter(model.State(**start), forgetting_factor)


def increments(seed, number, stiffness, damping, noise):
    """Increments as of a contact: tenths of a millimetre, millimetres per second, the force against them."""
    source = np.random.default_rng(seed)
    for _ in range(number):
        position, velocity = 1e-4 * source.standard_normal(), 4e-3 * source.standard_normal()
        force = -stiffness * position - damping * velocity + noise * source.standard_normal()
        yield force, position, velocity


def test_sage_husa_filter_converges_and_finds_the_noise(controller_model):
    kalman = make_filter(controller_model, forgetting_factor=0.995)
    for step in increments(1, 3000, 5e4, 80.0, 0.3):
        kalman.update(*step)
    state = kalman.state
    assert state.stiffness == pytest.approx(5e4, rel=0.01)
    assert state.damping == pytest.approx(80.0, abs=6.0)
    assert math.sqrt(state.r) == pytest.approx(0.3, rel=0.1)
    assert abs(state.stiffness - 5e4) < 4.0 * math.sqrt(state.p_kk)
    assert state.p_kk * state.p_cc > state.p_kc**2


def test_measurement_noise_is_followed_both_ways(controller_model):
    kalman = make_filter(controller_model, forgetting_factor=0.98)
    found = []
    for noise in (0.1, 3.0, 0.1):
        for step in increments(2, 600, 5e4, 80.0, noise):
            kalman.update(*step)
        found.append(math.sqrt(kalman.state.r))
    assert found == pytest.approx([0.1, 3.0, 0.1], rel=0.25)


def test_process_noise_rises_when_the_stiffness_changes_and_lets_the_filter_follow(controller_model):
    kalman = make_filter(controller_model)
    for step in increments(3, 24, 5e4, 0.0, 0.05):
        kalman.update(*step)
    before, fixed = kalman.state.q_kk, kalman.state.p_kk
    found = []
    for step in increments(4, 120, 7e4, 0.0, 0.05):
        kalman.update(*step)
        found.append(kalman.state.q_kk)
    assert max(found) > 10.0 * before
    assert kalman.state.stiffness == pytest.approx(7e4, rel=0.02)
    # Without process noise the certainty gained before would hold the estimate back.
    kept = 24 / (24 + 120)
    assert fixed < 1e6 and abs(kalman.state.stiffness - 7e4) < 0.25 * kept * 2e4


def test_filter_agrees_with_recursive_least_squares(controller_model):
    """With b near one and no process noise yet, one update is the textbook's."""
    kalman = make_filter(controller_model, r=0.25)
    force, position, velocity = -9.0, 1.2e-4, 3e-3
    prior = np.diag([1e10, 4e4])
    h = np.array([-position, -velocity])
    gain = prior @ h / (h @ prior @ h + 0.25)
    expected = np.array([1e5, 0.0]) + gain * (force - h @ np.array([1e5, 0.0]))
    kalman.update(force, position, velocity)
    state = kalman.state
    assert (state.stiffness, state.damping) == pytest.approx(expected, rel=1e-12)
    assert state.innovation == pytest.approx(force + 1e5 * position, rel=1e-12)
    posterior = prior - np.outer(gain, h) @ prior
    assert [state.p_kk, state.p_kc, state.p_cc] == pytest.approx(posterior[[0, 0, 1], [0, 1, 1]], rel=1e-9)


def make_law(model, **parameters):
    return model.ComplianceLaw(model.Parameters(**parameters), model.State())


@pytest.mark.parametrize("frame", [1, -1], ids=["front", "rear"])
def test_compensation_sign(controller_model, frame):
    """A desired rod deeper in the frame than the real one is pushed harder, by k times the difference."""
    law = make_law(controller_model, initial_stiffness=1e5, initial_damping=50.0, hold_compensation=False)
    force = law.sample(
        controller_model.Inputs(
            measured_force=-frame * 40.0,
            position=frame * 5.4e-3,
            velocity=frame * 0.018,
            desired_position=frame * 5.5e-3,
            desired_velocity=frame * 0.020,
        )
    )
    assert force == pytest.approx(-frame * (40.0 + 1e5 * 1e-4 + 50.0 * 0.002), rel=1e-12)
    assert law.state.contact_state == frame


@pytest.mark.parametrize("frame", [1, -1], ids=["front", "rear"])
def test_never_a_pull_once_the_desired_rod_has_left(controller_model, frame):
    law = make_law(controller_model)
    inputs = controller_model.Inputs(
        -frame * 12.0, frame * 5.1e-3, -frame * 0.02, frame * 4.9e-3, -frame * 0.02
    )
    assert law.sample(inputs) == 0.0
    assert law.state.contact_state == frame


def test_hold_compensation_looks_half_a_sample_ahead(controller_model):
    inputs = controller_model.Inputs(-40.0, 5.4e-3, 0.02, 5.5e-3, 0.02)
    forces = [
        make_law(controller_model, hold_compensation=on, sample_period=1e-3).sample(inputs)
        for on in (False, True)
    ]
    assert forces[1] - forces[0] == pytest.approx(-1e5 * 0.02 * 0.5e-3, rel=1e-9)


def test_readings_below_the_threshold_are_no_contact(controller_model):
    law = make_law(controller_model)
    free = controller_model.Inputs(0.0, 0.0, 0.02, 0.0, 0.02)
    for reading, state in ((4.9, 0), (5.1, -1), (2.6, -1), (2.4, 0), (-4.9, 0), (-5.1, 1), (5.1, -1)):
        law.sample(free._replace(measured_force=reading))
        assert law.state.contact_state == state, reading


@pytest.mark.parametrize("mode", ["off", "lead"])
def test_modes_without_compensation(controller_model, mode):
    law = make_law(controller_model, mode=controller_model.MODES[mode], tau_s=2e-3, lead_filter_time=0.0)
    for measured in (0.0, 0.3, -80.0, 120.0, 0.0):
        previous = law.state.previous_measured
        force = law.sample(controller_model.Inputs(measured, 1e-3, 0.1, 2e-3, 0.2))
        assert force == (
            measured if mode == "off" else measured + 2e-3 * (measured - previous) / SAMPLE_PERIOD
        )


# Speeds below the smallest normal number end the component's sample with a division by zero: they underflow.
_wide, _near, _fast = (st.floats(-most, most, allow_subnormal=False) for most in (300.0, 0.01, 0.1))
MOTION = st.lists(st.tuples(_wide, _near, _fast, _near, _fast), min_size=1, max_size=120)


@given(motion=MOTION, tau_s=st.sampled_from([0.0, 1e-3]), settle=st.sampled_from([0.0, 2e-3]))
@settings(max_examples=60, deadline=None)
def test_whatever_comes_the_force_is_finite_and_a_push_and_mirrors(controller_model, motion, tau_s, settle):
    parameters = {"tau_s": tau_s, "settling_time": settle, "identification_period": 1e-3}
    law, mirrored = make_law(controller_model, **parameters), make_law(controller_model, **parameters)
    for values in motion:
        force = law.sample(controller_model.Inputs(*values))
        assert math.isfinite(force)
        assert force * law.state.contact_state <= 0.0
        assert mirrored.sample(controller_model.Inputs(*(-value for value in values))) == -force
        assert mirrored.estimates() == law.estimates()
