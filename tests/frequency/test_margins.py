"""Margins against python-control and closed forms; critical delays against roots."""

import control
import numpy as np
import pytest

from orchestrator.frequency import Loop, Transfer, characteristic, count_right_of, critical_delays, margins


def test_rational_loop_as_python_control():
    system = control.tf([8.0], np.poly([-1.0, -2.0, -3.0]))
    told = margins(Transfer.of_control(system))
    gain, phase, modulus, at_phase, at_gain, at_modulus = control.stability_margins(system)
    assert told.stable
    assert told.gain_margin == (0.0, pytest.approx(gain, rel=1e-9))
    assert told.phase_crossovers[0][0] == pytest.approx(at_phase, rel=1e-9)
    assert told.phase_margin == pytest.approx(phase, rel=1e-9)
    assert told.crossovers[0].omega == pytest.approx(at_gain, rel=1e-9)
    assert told.modulus_margin == pytest.approx(modulus, rel=1e-6)
    assert told.modulus_margin_at == pytest.approx(at_modulus, rel=1e-3)
    assert told.sensitivity_peak == pytest.approx(1 / modulus, rel=1e-6)


def test_integrator_with_delay():
    """L = g exp(-tau s)/s: crossover at g, unstable from tau = pi/(2 g), gain margin pi/(2 g tau)."""
    gain, tau = 3.0, 0.1
    told = margins(Transfer.rational([gain], [1.0, 0.0], tau))
    assert told.phase_margin == pytest.approx(90 - np.degrees(gain * tau), rel=1e-10)
    assert told.delay_margin == pytest.approx(np.pi / 2 / gain - tau, rel=1e-10)
    assert told.gain_margin[1] == pytest.approx(np.pi / 2 / gain / tau, rel=1e-10)
    assert not margins(Transfer.rational([gain], [1.0, 0.0], 0.53)).stable
    assert np.isnan(margins(Transfer.rational([gain], [1.0, 0.0], 0.53)).delay_margin)


def test_every_crossover_is_considered():
    """A lightly damped mode behind an integrator crosses three times."""
    loop = Transfer.rational([1.0 * 100.0], np.polymul([1.0, 0.0], [1.0, 0.05, 100.0]))
    told = margins(loop)
    assert [one.falling for one in told.crossovers] == [True, False, True]
    told = margins(Transfer.rational([3.0, 0.0], [1.0, 0.04, 100.0]))
    assert told.stable and [one.falling for one in told.crossovers] == [False, True]
    assert told.delay_margin == min(one.delay_margin for one in told.crossovers)


def test_delay_margin_is_where_the_count_changes():
    loop = Loop.of("docking-1d-uncompensated", ["contact.damping=1500 N.s/m"])
    margin = margins(loop.gain()).delay_margin
    for factor, unstable in ((0.999, 0), (1.001, 2)):
        later = loop.with_parameters({"robot.tau_m": 2e-3 + factor * margin})
        assert count_right_of(later.characteristic()) == unstable


def test_critical_delays_with_directions():
    """A resonance that delay destabilises and stabilises in turn; counts agree between all of them."""
    plant = Transfer.rational([-0.4], [1.0, 0.1, 1.0])
    begin, found = critical_delays(Transfer(), plant, 30.0)
    assert begin == 0
    assert {one.to_right for one in found} == {True, False}
    delays = [one.delay for one in found]
    assert delays == sorted(delays)
    edges = [0.0, *delays, 30.0]
    counts = [0, *(one.unstable_beyond for one in found)]
    for low, high, count in zip(edges[:-1], edges[1:], counts, strict=True):
        late = Transfer.rational([-0.4], [1.0, 0.1, 1.0], 0.5 * (low + high))
        assert count_right_of(characteristic(late)) == count


def test_active_loop_bears_any_robot_delay_where_estimates_are_right():
    loop = Loop.of("docking-1d", ["contact.damping=300 N.s/m"])
    for tau in (1e-3, 1e-2, 5e-2):
        assert margins(loop.with_parameters({"robot.tau_m": tau}).gain()).stable
    wrong = loop.with_parameters({"controller.stiffness_estimate": 100e3, "robot.tau_m": 1e-2})
    assert not margins(wrong.gain()).stable
