"""Linear systems with delays of any shape, against closed forms and simulations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import lambertw

from orchestrator.base.errors import ConfigError, OrchestratorError
from orchestrator.frequency.delay_system import DelaySystem, Link


def chain(a, b, c, d=0.0, *links):
    """A system of one input and one output."""
    a, b, c = np.atleast_2d(a), np.reshape(b, (-1, 1)), np.reshape(c, (1, -1))
    names = tuple(f"x{index}" for index in range(len(a)))
    return DelaySystem(a, b, c, np.array([[float(d)]]), names, ("p.u",), ("p.y",), links)


def loop(gain, delay):
    return Link("p.y -> p.u", 0, 0, gain, delay)


@pytest.mark.parametrize("gain", [0.2, 1.0, 1.5, 2.0, 5.0])
def test_roots_of_a_delayed_integrator_are_lamberts(gain):
    """x' = -k x(t - tau): s tau = W(-k tau), on every branch."""
    tau = 0.7
    modes = chain(0.0, 1.0, 1.0, 0.0, loop(-gain, tau)).modes(6)
    branches = [lambertw(-gain * tau, k) / tau for k in range(-6, 6)]
    expected = sorted((s for s in branches if s.imag >= -1e-12), key=lambda s: -s.real)
    for mode, root in zip(modes.modes, expected, strict=False):
        assert mode.root == pytest.approx(root, rel=1e-10, abs=1e-10)
    assert modes.stable == (gain * tau < np.pi / 2)


@pytest.mark.parametrize(("a", "b"), [(-1.0, -2.0), (0.5, -1.5), (-0.3, -0.9)])
def test_the_border_of_hayes_equation(a, b):
    """x' = a x + b x(t - tau) leaves stability at tau = arccos(-a/b)/sqrt(b^2 - a^2)."""
    border = np.arccos(-a / b) / np.sqrt(b * b - a * a)
    for factor, stable in ((0.999, True), (1.001, False)):
        assert chain(a, 1.0, 1.0, 0.0, loop(b, factor * border)).modes().stable is stable
    start = chain(a, 1.0, 1.0, 0.0, loop(b, 0.0))
    assert start.margins("p.y -> p.u").delay_margin == pytest.approx(border, rel=1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_random_loops_have_the_roots_of_their_scalar_equation(seed):
    draw = np.random.default_rng(seed)
    order = int(draw.integers(1, 6))
    a = draw.normal(size=(order, order)) - 1.5 * np.eye(order)
    b, c = draw.normal(size=(order, 1)), draw.normal(size=(1, order))
    delay, gain = float(draw.uniform(0.1, 2.0)), float(draw.normal())
    modes = chain(a, b, c, 0.0, loop(gain, delay)).modes(6)
    numerator = np.poly(a - b @ c) - np.poly(a)
    for mode in modes.modes:
        below, late = (np.polyval(one, mode.root) for one in (np.poly(a), gain * numerator))
        size = np.polyval(abs(np.poly(a)), abs(mode.root)) + abs(late * np.exp(-delay * mode.root))
        assert abs(below - late * np.exp(-delay * mode.root)) < 1e-9 * size
    assert all(mode.residual < 1e-9 for mode in modes.modes)


@pytest.mark.parametrize("seed", range(30))
def test_signs_of_stability_are_those_of_simulations(seed):
    """Random systems of two to six states with two delays, simulated by the method of steps."""
    draw = np.random.default_rng(1000 + seed)
    n = int(draw.integers(2, 7))
    a = draw.normal(size=(n, n)) - draw.uniform(0.5, 3.0) * np.eye(n)
    b, c = draw.normal(size=(n, 2)), draw.normal(size=(2, n))
    delays = np.array([int(draw.integers(20, 100)), int(draw.integers(20, 100))]) / 100.0
    links = (Link("one", 0, 0, 1.0, delays[0]), Link("two", 1, 1, -1.0, delays[1]))
    names = tuple(f"x{index}" for index in range(n))
    system = DelaySystem(a, b, c, np.zeros((2, 2)), names, ("p.u", "q.u"), ("p.y", "q.y"), links)
    rightmost = system.modes().modes[0].root
    if abs(rightmost.real) < 0.02:
        pytest.skip("too near to the border to be seen in so short a simulation")
    growth = simulated_growth(a, b, c, np.array([1.0, -1.0]), delays)
    assert growth == pytest.approx(rightmost.real, rel=0.05, abs=0.01)


def simulated_growth(a, b, c, gains, delays, step=0.0025, length=60.0):
    """Mean rate of log |x| over the second half of a simulation; the implicit trapezoidal rule."""
    n, late = len(a), np.rint(delays / step).astype(int)
    steps = int(length / step)
    states, outputs = np.zeros((steps + 1, n)), np.zeros((steps + 1, 2))
    states[0] = np.random.default_rng(0).normal(size=n)
    outputs[0] = c @ states[0]
    right, inverse = np.eye(n) + 0.5 * step * a, np.linalg.inv(np.eye(n) - 0.5 * step * a)

    def fed(index):
        return np.array([gains[k] * outputs[index - late[k], k] if index >= late[k] else 0.0 for k in (0, 1)])

    for index in range(steps):
        drive = 0.5 * step * b @ (fed(index) + fed(index + 1))
        states[index + 1] = inverse @ (right @ states[index] + drive)
        outputs[index + 1] = c @ states[index + 1]
        if not 1e-100 < np.linalg.norm(states[index + 1]) < 1e100:
            states = states[: index + 1]
            break
    logs = np.log(np.linalg.norm(states, axis=1))
    # Peaks only: an oscillation's zeros say nothing of its decay.
    blocks = np.array_split(np.arange(len(logs) // 2, len(logs)), 12)
    peaks = [(step * block[np.argmax(logs[block])], np.max(logs[block])) for block in blocks]
    return float(np.polyfit(*np.transpose(peaks), 1)[0])


def test_margins_of_a_double_integrator_with_lead():
    """L = (1 + s)/s^2: crossover at sqrt((1 + sqrt 5)/2)."""
    a, b, c = np.array([[0.0, 1.0], [0.0, 0.0]]), [0.0, 1.0], [1.0, 1.0]
    system = chain(a, b, c, 0.0, loop(-1.0, 0.0))
    found = system.margins("p.y -> p.u", system.modes())
    omega = np.sqrt((1.0 + np.sqrt(5.0)) / 2.0)
    assert found.crossovers[0].omega == pytest.approx(omega, rel=1e-10)
    assert found.phase_margin == pytest.approx(np.degrees(np.arctan(omega)), rel=1e-9)
    assert found.delay_margin == pytest.approx(np.arctan(omega) / omega, rel=1e-9)
    late = system.later("p.y -> p.u", 1.0001 * found.delay_margin)
    early = system.later("p.y -> p.u", 0.9999 * found.delay_margin)
    assert late.modes().unstable == 2 and early.modes().stable


def test_a_gain_margin_is_where_the_gain_makes_it_unstable():
    a = np.array([[-1.0, 1.0, 0.0], [0.0, -1.0, 1.0], [0.0, 0.0, -1.0]])
    system = chain(a, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0], 0.0, loop(-2.0, 0.0))
    found = system.margins("p.y -> p.u", system.modes())
    assert found.gain_margin[1] == pytest.approx(4.0, rel=1e-6)  # 8 of (s + 1)^3 over 2
    assert system.scaled("p.y -> p.u", 4.001).modes().unstable == 2
    assert system.scaled("p.y -> p.u", 3.999).modes().stable


def test_counting_agrees_with_the_list():
    system = chain(0.0, 1.0, 1.0, 0.0, loop(-9.0, 1.0))
    modes = system.modes(8)
    assert system.count_right_of(0.0) == modes.unstable == 4
    with pytest.raises(OrchestratorError, match="lies on the line"):
        chain(0.0, 1.0, 1.0, 0.0, loop(-np.pi / 2, 1.0)).count_right_of(0.0)


def test_parts_that_are_there_twice_have_roots_twice():
    eye, delay, gain = np.eye(2), 0.5, -2.0
    links = (Link("p", 0, 0, gain, delay), Link("q", 1, 1, gain, delay))
    twice = DelaySystem(-eye, eye, eye, 0 * eye, ("p.x", "q.x"), ("p.u", "q.u"), ("p.y", "q.y"), links)
    once = chain(-1.0, 1.0, 1.0, 0.0, loop(gain, delay)).modes(3)
    modes = twice.modes()
    assert twice.count_right_of(modes.line) == 2 * len(modes.modes)
    for place, mode in enumerate(modes.modes):
        assert mode.root == pytest.approx(once.modes[place // 2].root, rel=1e-9)
        assert dict(mode.participation) == pytest.approx({"p.x": 0.5, "q.x": 0.5})


def test_large_systems_are_reduced_to_what_their_links_see():
    """Determinants and open loops are those of the whole equation."""
    draw = np.random.default_rng(3)
    n, m = 60, 3
    a = draw.normal(size=(n, n)) / np.sqrt(n) - 1.2 * np.eye(n)
    a[:2, :2] = [[0.0, 1.0], [0.0, 0.0]]
    a[:2, 2:] = 0.0
    b, c = draw.normal(size=(n, m)) / np.sqrt(n), draw.normal(size=(m, n))
    links = tuple(Link(str(k), k, k, (-1.0) ** k, 0.2 * k) for k in range(m))
    names = [tuple(f"p.{kind}{k}" for k in range(size)) for kind, size in (("x", n), ("u", m), ("y", m))]
    system = DelaySystem(a, b, c, np.full((m, m), 0.1), *names, links)
    s = np.concatenate([draw.normal(size=40) + 1j * draw.normal(size=40), [0.0, 1e-9, 1j]])
    whole = system._matrix(s)
    assert system._signs(s) == pytest.approx(np.linalg.slogdet(whole)[0], abs=1e-9)
    for place in (0, 40):
        cut = DelaySystem(a, b, c, system.d, *names, (links[0], links[2]))
        drive = np.zeros(n + m)
        drive[n + 1] = 1.0
        x = np.linalg.solve(cut._matrix(s[place : place + 1])[0], drive)
        y = c[1] @ x[:n] + system.d[1] @ x[n:]
        expected = np.exp(-0.2 * s[place]) * y
        assert system.response("1", s[place : place + 1])[0] == pytest.approx(expected, rel=1e-8)


def test_loops_without_a_state_are_refused():
    with pytest.raises(ConfigError, match="holds a delay and direct feedthrough"):
        chain(-1.0, 1.0, 1.0, 2.0, loop(1.0, 0.1)).modes()
    with pytest.raises(ConfigError, match=r"algebraic loop through p\.u has no solution"):
        chain(-1.0, 1.0, 1.0, 1.0, loop(1.0, 0.0)).modes()


def test_participation_names_the_states_of_a_mode():
    a = np.diag([-1.0, -50.0])
    system = chain(a, [1.0, 0.0], [1.0, 0.0], 0.0, loop(-0.5, 0.0))
    slow, fast = system.modes(2).modes
    assert slow.participation[0] == ("x0", pytest.approx(1.0))
    assert fast.participation[0] == ("x1", pytest.approx(1.0))
