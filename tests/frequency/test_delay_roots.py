"""Rightmost roots of delay equations against closed forms; sums of terms with delays; refusals."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import lambertw

from orchestrator.base.errors import ConfigError, OrchestratorError
from orchestrator.effects import Effect
from orchestrator.frequency import (
    Loop,
    QuasiPolynomial,
    Transfer,
    characteristic,
    count_right_of,
    rightmost_roots,
)
from orchestrator.frequency.connections import known_effects
from orchestrator.frequency.loop import Wire

MASS, STIFFNESS, OMEGA, XI = 279.06976744186045, 176e3, 471.23889803846896, 0.8


def scalar(a: float, b: float, tau: float) -> np.ndarray:
    """Roots of x' = a x + b x(t - tau), rightmost first."""
    values = [a + lambertw(b * tau * np.exp(-a * tau), k) / tau for k in range(-30, 31)]
    return np.array(sorted(values, key=lambda one: -one.real))


@pytest.mark.parametrize(
    ("a", "b", "tau"),
    [
        (-1.0, -2.0, 1.0),
        (0.5, -1.2, 0.7),
        (-3.0, 2.5, 4.0),
        (0.0, -1.7, 1.0),
        (2.0, 1.0, 0.3),
        (-1e3, -2e3, 1e-3),
    ],
)
def test_scalar_equation_against_lambert_w(a, b, tau):
    found = rightmost_roots(characteristic(Transfer.rational([-b], [1.0, -a], tau)), 7)
    expected = scalar(a, b, tau)[: len(found.values)]
    assert len(found.values) >= 7
    for root in expected:
        assert np.min(np.abs(found.values - root)) < 1e-8 * max(1.0, abs(root))
    assert np.max(found.residuals) < 1e-12


def test_printed_roots():
    """The On-Line Encyclopedia of Integer Sequences prints the fixed points z of exp(z), A059526 with A059527
    and A277681, and that of exp(-z), A030178: -z are the roots of x' = -x(t - 1), z that of x' = x(t - 1)."""
    found = rightmost_roots(characteristic(Transfer.rational([1.0], [1.0, 0.0], 1.0)), 4).values
    assert found[0] == pytest.approx(-0.318131505204764135312654 + 1.337235701430689408901162j, abs=1e-13)
    assert found[2].real == pytest.approx(-2.062277729598283884978487, abs=1e-12)
    found = rightmost_roots(characteristic(Transfer.rational([-1.0], [1.0, 0.0], 1.0)), 1).values
    assert found[0] == pytest.approx(0.567143290409783872999969, abs=1e-13)


def test_triangular_systems_as_jarlebring_and_damm():
    """Jarlebring, Damm, Automatica 43 (2007) 2124: triangular A, B have the spectrum of their diagonals."""
    diagonals = ((-1.0, -2.0), (-0.3, 0.8), (0.2, -1.1))
    tau = 1.3
    # det of the triangle: a product of (s - a) - b exp(-tau s), multiplied out into powers of the delay.
    rows = np.zeros((4, 4))
    rows[0, 0] = 1.0
    for a, b in diagonals:
        shifted = np.zeros_like(rows)
        shifted[:, 1:] += rows[:, :-1]
        shifted[:, :] -= a * rows
        shifted[1:, :] -= b * rows[:-1, :]
        rows = shifted
    found = rightmost_roots(QuasiPolynomial(rows, tau * np.arange(4.0)), 9)
    every = np.concatenate([scalar(a, b, tau) for a, b in diagonals])
    expected = every[every.real > found.line]
    assert len(expected) == len(found.values) >= 9
    assert all(np.min(np.abs(found.values - root)) < 1e-8 for root in expected)


def test_root_on_the_axis_at_the_critical_delay():
    """X' = -x(t - pi/2) has the roots +-j."""
    found = rightmost_roots(characteristic(Transfer.rational([1.0], [1.0, 0.0], np.pi / 2)), 4)
    assert found.values[0] == pytest.approx(1j, abs=1e-10)
    assert found.values[1] == pytest.approx(-1j, abs=1e-10)


def test_without_delay_roots_are_those_of_the_polynomial():
    found = rightmost_roots(characteristic(Transfer.rational([6.0], np.poly([-1.0, -4.0, -5.0]))))
    np.testing.assert_allclose(
        np.sort(found.values), np.sort(np.roots(np.polyadd([6.0], np.poly([-1, -4, -5]))))
    )


@pytest.mark.parametrize("line", [-3.0, -1.5, -0.5, 0.0, 0.4])
def test_roots_are_counted_right_of_any_line(line):
    equation = characteristic(Transfer.rational([1.2], [1.0, -0.5], 0.7))
    assert count_right_of(equation, line) == np.sum(scalar(0.5, -1.2, 0.7).real > line)


def test_a_root_on_the_line_is_not_counted_in_silence():
    with pytest.raises(OrchestratorError, match="a root lies on the line Re s = 0 to within rounding"):
        count_right_of(characteristic(Transfer.rational([1.0], [1.0, 0.0, 0.0])))


def test_terms_add_and_multiply_as_their_values_do():
    one = Transfer.rational([1.0, 2.0], [1.0, 3.0, 5.0], 0.3)
    two = Transfer.rational([4.0], [1.0, 7.0], 0.1)
    s = np.array([0.3 + 1j, -0.2 - 4j, 2.0])
    np.testing.assert_allclose((one + two)(s), one(s) + two(s))
    np.testing.assert_allclose((one - 2.0 * two)(s), one(s) - 2 * two(s))
    np.testing.assert_allclose((one * two)(s), one(s) * two(s))
    assert not (one - one).terms
    product = characteristic(one * two + one)
    below = np.polyval([1, 3, 5], s) * np.polyval([1, 7], s)
    np.testing.assert_allclose(product(s) / below, 1 + one(s) * two(s) + one(s))


def test_python_control_and_back():
    control = pytest.importorskip("control")
    system = control.tf([1.0, 2.0], [1.0, 3.0, 5.0])
    loop = Transfer.of_control(system, 0.2)
    omega = np.array([0.1, 1.0, 30.0])
    response = loop.frequency_response(omega)
    expected = system(1j * omega) * np.exp(-0.2j * omega)
    np.testing.assert_allclose(response.frdata[0, 0], expected, rtol=1e-13)


@pytest.mark.parametrize(("error", "up_to"), [(1e-2, 500.0), (1e-4, 1500.0)])
def test_pade_keeps_its_error_bound_with_the_lowest_order(error, up_to):
    loop = Transfer.rational([OMEGA**2], [1.0, 2 * XI * OMEGA, OMEGA**2], 0.006)
    model, order = loop.pade(error, up_to)
    omega = np.linspace(1.0, up_to, 700)
    assert np.max(np.abs(model(1j * omega) - loop(1j * omega))) <= error * 1.01
    import control

    above, below = control.pade(0.006, order - 1)
    lower = np.polyval(above, 1j * omega) / np.polyval(below, 1j * omega)
    assert np.max(np.abs(lower - np.exp(-0.006j * omega))) > error


def test_docking_borders():
    """Damping at which the contact's root stands on the axis; measured before with another program."""
    loop = Loop.of("docking-1d-uncompensated")
    for tau, border in ((2e-3, 955.7), (6e-3, 1686.1)):
        for damping, unstable in ((border - 0.1, 2), (border + 0.1, 0)):
            changed = loop.with_parameters({"robot.tau_m": tau, "contact.damping": damping})
            assert rightmost_roots(changed.characteristic(), 2).unstable == unstable


def test_coefficients_come_from_the_config():
    loop = Loop.of("docking-1d-uncompensated", ["robot.tau_m=3 ms", "contact.damping=50 N.s/m"]).gain()
    s = np.array([1j, 3 + 25j, 400j])
    servo = OMEGA**2 / (s**2 + 2 * XI * OMEGA * s + OMEGA**2) * np.exp(-3e-3 * s)
    np.testing.assert_allclose(loop(s), (STIFFNESS + 50 * s) * servo / (MASS * s**2), rtol=1e-12)


def refused(function) -> str:
    with pytest.raises(ConfigError) as caught:
        function()
    return str(caught.value)


def test_refusals_of_transfers():
    assert refused(lambda: Transfer.rational([1.0], [0.0], -1.0, "sensor")) == (
        "sensor: the denominator is zero\n  it needs a coefficient that is not\n"
        "sensor: delay is -1.0 s\n  allowed: finite and not negative"
    )
    assert refused(lambda: characteristic(Transfer.rational([1.0, 0, 0], [1.0, 1.0]))) == (
        "loop: the loop is improper: a term of the loop has a numerator of degree 2 over a denominator of "
        "degree 1\n"
        "  Give the part that differentiates a time constant."
    )
    assert refused(lambda: characteristic(Transfer.rational([2.0, 1.0], [1.0, 1.0]))) == (
        "loop: algebraic loop: a term of the loop has a numerator of degree 1 over a denominator of "
        "degree 1, without delay\n  a loop whose gain falls to zero at high frequency. "
        "Give a part of the loop a delay or a lag."
    )
    assert refused(lambda: characteristic(Transfer.rational([2.0, 1.0], [1.0, 1.0], 0.1))) == (
        "loop: the closed loop is of neutral type: a term of the loop has a numerator of degree 1 over a "
        "denominator of degree 1, with delay\n  a loop whose gain falls to zero at high frequency. "
        "Give a part of the loop a lag."
    )


def test_refusals_of_configured_loops():
    loop = Loop.of("docking-1d-uncompensated")
    wrong = loop.with_parameters({"satellite.mass": 0.0, "robot.tau_m": -1e-3})
    assert refused(wrong.gain) == (
        "satellite.mass: it is 0.0 kg\n  allowed: finite and positive\n"
        "robot.tau_m: it is -0.001 s\n  allowed: finite and not negative"
    )
    assert refused(lambda: loop.with_parameters({"robot.taum": 1.0})).splitlines()[0] == (
        "docking-1d-uncompensated: no parameter robot.taum"
    )
    wires = tuple(wire for wire in loop.wires if wire.target != ("satellite", "force"))
    assert refused(replace(loop, wires=wires).gain) == (
        "docking-1d-uncompensated: no loop leads back to satellite.force\n"
        "  what is connected to it does not depend on the satellite's motion"
    )
    robot = Wire(("robot", "position"), ("robot", "command"))
    turned = (robot, *(wire for wire in loop.wires if wire.target != ("robot", "command")))
    assert refused(replace(loop, wires=turned).gain) == (
        "docking-1d-uncompensated: algebraic loop, or one that does not pass through the satellite: "
        "robot.position -> robot.position\n  only the loop through the satellite can be analysed"
    )
    models = {name: model for name, model in loop.models.items() if name != "robot"}
    assert refused(replace(loop, models=models, others={"robot": "Crane"}).gain).splitlines()[0] == (
        "docking-1d-uncompensated: robot is a Crane, whose transfer function is not known here"
    )


class Unknown(Effect):
    """An effect of a user's, whose law nobody knows here."""


def through(effects: str, *more: str) -> Loop:
    return Loop.of("docking-1d-uncompensated", [f"connections[satellite.force].through={effects}", *more])


def test_effects_on_connections_are_part_of_the_loop():
    plain = Loop.of("docking-1d-uncompensated").gain()
    s = np.array([1j, 3 + 25j, 400j])
    found = through("[{delay: 1 ms}, {low-pass: 200 Hz}, {gain: 0.5}, {offset: 3 N}]")
    expected = 0.5 * np.exp(-1e-3 * s) / (1 + s / (400 * np.pi)) * plain(s)
    np.testing.assert_allclose(found.gain()(s), expected, rtol=1e-12)
    assert found.notes == ()
    held = through("[{saturate: {low: -9 N, high: 9 N}}, {sample-and-hold: 4 ms}]")
    np.testing.assert_allclose(held.gain()(s), np.exp(-2e-3 * s) * plain(s), rtol=1e-12)
    assert held.notes == (
        "contact.force -> satellite.force: saturate is not linear and is left out",
        "contact.force -> satellite.force: sample-and-hold counts as a delay of half a period",
    )
    # A delay in the path back acts as one of the robot.
    one, two = through("[{delay: 4 ms}]"), Loop.of("docking-1d-uncompensated", ["robot.tau_m=6 ms"])
    np.testing.assert_allclose(
        rightmost_roots(one.characteristic(), 4).values, rightmost_roots(two.characteristic(), 4).values
    )


def test_sums_of_sources_add_up(tmp_path):
    path = tmp_path / "twice.yaml"
    path.write_text(
        "extends: docking-1d-uncompensated\n"
        "connections:\n"
        "  - satellite.position -> robot.command\n"
        "  - robot.position -> contact.position\n"
        "  - robot.velocity -> contact.velocity\n"
        "  - {from: [contact.force, {port: contact.force, gain: -3}], to: satellite.force}\n",
        encoding="utf-8",
    )
    s = np.array([1j, 30j])
    np.testing.assert_allclose(Loop.of(path).gain()(s), -2 * Loop.of("docking-1d-uncompensated").gain()(s))


def test_an_effect_of_unknown_law_is_refused():
    loop = Loop.of("docking-1d-uncompensated")
    wires = tuple(
        replace(wire, effects=(("mine", Unknown()),)) if wire.target == ("satellite", "force") else wire
        for wire in loop.wires
    )
    told = refused(replace(loop, wires=wires).gain)
    assert told.startswith(
        "docking-1d-uncompensated: connection to satellite.force: the effect mine has no transfer function "
        "that is known here\n  known effects: gain, offset, delay, low-pass, "
    )
    # Those without a law here are known to runs alone.
    assert not {"drift", "dropout", "jitter", "map"} & set(known_effects())
    assert ", ".join(known_effects()) in told
    assert told.endswith("Measure the response with orchestrator.frequency.sweep_system.")
