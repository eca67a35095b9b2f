"""Margins against python-control and closed forms; critical delays against roots."""

from dataclasses import replace

import control
import numpy as np
import pytest

from orchestrator.docking.stability import ContactLoop
from orchestrator.frequency import DelaySystem, Link, Margins
from orchestrator.frequency.refine import minima, zeros


def loop(above, below, delay: float = 0.0) -> DelaySystem:
    """Negative feedback around above/below, descending powers, behind a delay."""
    return DelaySystem.loop(control.tf(above, below), delay)


def margins(above, below, delay: float = 0.0) -> Margins:
    return loop(above, below, delay).margins("loop")


def test_rational_loop_as_python_control():
    system = control.tf([8.0], np.poly([-1.0, -2.0, -3.0]))
    reported = DelaySystem.loop(system).margins("loop")
    gain, phase, modulus, at_phase, at_gain, at_modulus = control.stability_margins(system)
    assert reported.stable
    assert reported.gain_margin == (0.0, pytest.approx(gain, rel=1e-9))
    assert reported.phase_crossovers[0][0] == pytest.approx(at_phase, rel=1e-9)
    assert reported.phase_margin == pytest.approx(phase, rel=1e-9)
    assert reported.crossovers[0].omega == pytest.approx(at_gain, rel=1e-9)
    assert reported.modulus_margin == pytest.approx(modulus, rel=1e-6)
    assert reported.modulus_margin_at == pytest.approx(at_modulus, rel=1e-3)
    assert reported.sensitivity_peak == pytest.approx(1 / modulus, rel=1e-6)


def test_integrator_with_delay():
    """L = g exp(-tau s)/s: crossover at g, unstable from tau = pi/(2 g), gain margin pi/(2 g tau)."""
    gain, tau = 3.0, 0.1
    reported = margins([gain], [1.0, 0.0], tau)
    assert reported.phase_margin == pytest.approx(90 - np.degrees(gain * tau), rel=1e-10)
    assert reported.delay_margin == pytest.approx(np.pi / 2 / gain - tau, rel=1e-10)
    assert reported.gain_margin[1] == pytest.approx(np.pi / 2 / gain / tau, rel=1e-10)
    assert not margins([gain], [1.0, 0.0], 0.53).stable
    assert np.isnan(margins([gain], [1.0, 0.0], 0.53).delay_margin)


def test_every_crossover_is_considered():
    """A lightly damped mode behind an integrator crosses three times."""
    reported = margins([100.0], np.polymul([1.0, 0.0], [1.0, 0.05, 100.0]))
    assert [one.falling for one in reported.crossovers] == [True, False, True]
    reported = margins([3.0, 0.0], [1.0, 0.04, 100.0])
    assert reported.stable and [one.falling for one in reported.crossovers] == [False, True]
    assert reported.delay_margin == min(one.delay_margin for one in reported.crossovers)


def test_delay_margin_is_where_the_count_changes():
    linear = ContactLoop.of("docking-1d-uncompensated", ["contact.damping=1500 N.s/m"]).linear
    name = "satellite.position -> robot.command"
    margin = linear.margins(names=[name])[name].delay_margin
    assert margin == pytest.approx(3e-3, rel=2e-3)
    for factor, unstable in ((0.999, 0), (1.001, 2)):
        assert linear.system.later(name, factor * margin).count_right_of(0.0) == unstable


def random_loops(seed, count=3):
    """A stable system of several late connections that bears a finite delay."""
    draw = np.random.default_rng(seed)
    n = 2 * count
    for _ in range(50):
        a = draw.normal(size=(n, n)) - 2.5 * np.eye(n)
        b, c = draw.normal(size=(n, count)), draw.normal(size=(count, n))
        d = np.zeros((count, count))
        links = tuple(
            Link(f"line {target}", source, target, float(draw.normal()), float(delay))
            for target, delay in enumerate(draw.uniform(0.0, 0.6, count))
            for source in draw.choice(count, 2, replace=False)
        )
        names = [tuple(f"p.{kind}{index}" for index in range(len(d[0]))) for kind in "uy"]
        system = DelaySystem(a, b, c, d, tuple(f"p.x{index}" for index in range(n)), *names, links)
        if not system.modes().unstable and np.isfinite(system.delay_margin().delay):
            return system
    raise AssertionError("no stable system was drawn")


@pytest.mark.parametrize("seed", range(6))
def test_total_delay_margin_is_where_roots_reach_the_axis(seed):
    system = random_loops(seed)
    for names in (system.loops(), system.loops()[:2]):
        found = system.delay_margin(names)
        if not 0.0 < found.delay < np.inf:
            continue
        later = {}
        for factor in (1e-3, 0.3, 0.999, 1.0, 1.001):
            later[factor] = system
            for name in names:
                later[factor] = later[factor].later(name, factor * found.delay)
        at = later[1.0].root_near(1j * found.omega)
        assert abs(at - 1j * found.omega) < 1e-9 * found.omega
        assert [later[factor].count_right_of(0.0) > 0 for factor in (1e-3, 0.3, 0.999, 1.001)] == [
            *(3 * [False]),
            True,
        ]


def test_a_loop_of_two_connections_bears_half_of_its_delay_margin_in_each():
    plant = DelaySystem.loop(control.tf([2.0], [1.0, 1.0, 0.0]), 0.1)
    twice = DelaySystem.loop(
        control.ss([[0.0, 0.0], [0.0, -1.0]], [[1.0, 0.0], [0.0, 2.0]], np.eye(2)[::-1], np.zeros((2, 2))),
        0.0,
    )
    # The first integrates what the second lags; their product is the loop above.
    links = tuple(one._replace(gain=gain) for one, gain in zip(twice.links, (-1.0, 1.0), strict=True))
    both = replace(twice, links=links).later("loop[1]", 0.1)
    one = plant.delay_margin()
    assert one.delay == pytest.approx(plant.margins("loop").delay_margin, rel=1e-9)
    assert both.delay_margin().delay == pytest.approx(0.5 * one.delay, rel=1e-9)
    assert both.delay_margin(["loop[2]"]).delay == pytest.approx(one.delay, rel=1e-9)


@pytest.mark.parametrize(("feedthrough", "expected"), [(2.0, 0.0), (1.01, 0.0), (0.5, np.inf)])
def test_a_loop_with_much_direct_feedthrough_bears_no_delay(feedthrough, expected):
    """u = -2 u grows as soon as it is late: 1 + L has roots far up, right of the axis."""
    system = DelaySystem.loop(control.ss([[-1.0]], [[1.0]], [[0.3]], [[feedthrough]]))
    assert system.modes().stable
    assert system.margins("loop").delay_margin == system.delay_margin().delay == expected


def test_the_crossover_of_a_fast_loop_beside_many_slow_ones_is_found():
    gains = [*np.linspace(1.0, 2.0, 24), 1e8]
    zero = np.zeros((25, 25))
    system = DelaySystem.loop(control.ss(zero, np.diag(gains), np.eye(25), zero))
    assert system.margins("loop[25]").delay_margin == pytest.approx(np.pi / 2e8, rel=1e-6)


def test_active_loop_bears_any_robot_delay_where_estimates_are_right():
    damped = ["contact.damping=300 N.s/m"]
    for tau in (1, 10, 50):
        later = ContactLoop.of("docking-1d", [*damped, f"robot.tau_m={tau} ms"])
        assert later.linear.modes(2).unstable == 0
    wrong = ContactLoop.of("docking-1d", [*damped, "robot.tau_m=10 ms"], stiffness_estimate=100e3)
    assert wrong.linear.modes(2).unstable == 2


def test_a_system_of_scipy_is_taken_in():
    from scipy import signal

    reported = DelaySystem.loop(signal.TransferFunction([8.0], np.poly([-1.0, -2.0, -3.0]))).margins("loop")
    assert reported.gain_margin[1] == pytest.approx(
        margins([8.0], np.poly([-1.0, -2.0, -3.0])).gain_margin[1]
    )


@pytest.mark.parametrize("delay", [0.0, 0.13])
def test_the_step_response_is_that_of_python_control(delay):
    """With a delay against a closed loop with Pade's approximation of order 12."""
    plant = control.tf([4.0, 2.0], [1.0, 2.0, 3.0, 0.0])
    time = np.linspace(0.0, 12.0, 2401)
    found = loop([4.0, 2.0], [1.0, 2.0, 3.0, 0.0], delay).step_response("loop", time)
    late = control.tf(*control.pade(delay, 12)) if delay else 1.0
    expected = control.step_response(control.feedback(control.ss(plant * late), 1), time).outputs
    late_enough = time > 2.0 * delay
    np.testing.assert_allclose(found[late_enough], expected[late_enough], atol=4e-4)


def test_zeros_and_minima_of_many_brackets_at_once():
    places = np.array([0.3, 0.70001, 5.0, 80.0])
    low, high = places * np.array([0.9, 1.0, 0.5, 0.999]), places * np.array([1.3, 2.0, 1.0, 1.2])

    def cubic(x):
        scaled = x / np.resize(places, len(x)) - 1.0
        return scaled * (1.0 + 4.0 * scaled**2)

    assert zeros(cubic, low, high) == pytest.approx(places, rel=1e-13)
    assert zeros(lambda x: -cubic(x), low, high) == pytest.approx(places, rel=1e-13)
    at, least = minima(lambda x: 3.0 + (x / np.resize(places, len(x)) - 1.0) ** 2, low, high)
    assert at == pytest.approx(places, rel=1e-6) and least == pytest.approx(np.full(4, 3.0), rel=1e-12)
    assert not len(zeros(cubic, low[:0], high[:0]))
