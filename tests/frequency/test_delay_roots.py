"""Rightmost roots of delay equations against closed forms; sums of terms with delays; refusals."""

import control
import numpy as np
import pytest
import scipy.linalg
from scipy.special import lambertw

from orchestrator.base.errors import ConfigError, OrchestratorError
from orchestrator.docking.stability import ContactLoop
from orchestrator.effects import Effect
from orchestrator.frequency import DelaySystem, Link
from orchestrator.frequency.connections import effect_path, known_effects
from orchestrator.frequency.from_system import linearise

PLAIN = "docking-1d-uncompensated"
MASS, STIFFNESS, OMEGA, XI = 279.06976744186045, 176e3, 471.23889803846896, 0.8


def roots(system: DelaySystem, count: int) -> np.ndarray:
    """Rightmost roots, conjugates side by side."""
    found = [one.root for one in system.modes(count).modes]
    return np.array([z for one in found for z in ([one] if one.imag == 0.0 else [one, one.conjugate()])])


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
    found = roots(DelaySystem.loop(control.tf([-b], [1.0, -a]), tau), 9)
    expected = scalar(a, b, tau)[: len(found)]
    assert len(found) >= 5
    for root in expected:
        assert np.min(np.abs(found - root)) < 1e-8 * max(1.0, abs(root))


def test_printed_roots():
    """The On-Line Encyclopedia of Integer Sequences prints the fixed points z of exp(z), A059526 with A059527
    and A277681, and that of exp(-z), A030178: -z are the roots of x' = -x(t - 1), z that of x' = x(t - 1)."""
    found = roots(DelaySystem.loop(control.tf([1.0], [1.0, 0.0]), 1.0), 4)
    assert found[0] == pytest.approx(-0.318131505204764135312654 + 1.337235701430689408901162j, abs=1e-13)
    assert found[2].real == pytest.approx(-2.062277729598283884978487, abs=1e-12)
    found = roots(DelaySystem.loop(control.tf([-1.0], [1.0, 0.0]), 1.0), 1)
    assert found[0] == pytest.approx(0.567143290409783872999969, abs=1e-13)


def test_triangular_systems_as_jarlebring_and_damm():
    """Jarlebring, Damm, Automatica 43 (2007) 2124: triangular A, B have the spectrum of their diagonals."""
    diagonals = ((-1.0, -2.0), (-0.3, 0.8), (0.2, -1.1))
    tau = 1.3
    a, b = (np.triu(np.full((3, 3), 0.7), 1) + np.diag([one[k] for one in diagonals]) for k in (0, 1))
    eye, names = np.eye(3), tuple("xyz")
    links = tuple(Link(f"{k}", k, k, 1.0, tau) for k in range(3))
    modes = DelaySystem(a, b, eye, 0.0 * eye, names, names, names, links).modes(9)
    found = np.array([one.root for one in modes.modes])
    every = np.concatenate([scalar(a, b, tau) for a, b in diagonals])
    expected = every[(every.real > modes.line) & (every.imag > -1e-9)]
    assert len(expected) == len(found) >= 5
    assert all(np.min(np.abs(found - root)) < 1e-8 for root in expected)


def test_root_on_the_axis_at_the_critical_delay():
    """X' = -x(t - pi/2) has the roots +-j."""
    found = roots(DelaySystem.loop(control.tf([1.0], [1.0, 0.0]), np.pi / 2), 4)
    assert found[0] == pytest.approx(1j, abs=1e-10)
    assert found[1] == pytest.approx(-1j, abs=1e-10)


def test_without_delay_roots_are_those_of_the_polynomial():
    below = np.poly([-1.0, -4.0, -5.0])
    found = roots(DelaySystem.loop(control.tf([6.0], below)), 6)
    np.testing.assert_allclose(np.sort(found), np.sort(np.roots(np.polyadd([6.0], below))))


@pytest.mark.parametrize("line", [-3.0, -1.5, -0.5, 0.0, 0.4])
def test_roots_are_counted_right_of_any_line(line):
    system = DelaySystem.loop(control.tf([1.2], [1.0, -0.5]), 0.7)
    assert system.count_right_of(line) == np.sum(scalar(0.5, -1.2, 0.7).real > line)


def test_a_root_on_the_line_is_not_counted_in_silence():
    with pytest.raises(OrchestratorError, match="a root lies on the line Re s = 0 to within rounding"):
        DelaySystem.loop(control.tf([1.0], [1.0, 0.0, 0.0])).count_right_of()


def test_docking_borders():
    """Damping at which the contact's root stands on the axis; measured before with another program."""
    for tau, border in ((2, 955.7), (6, 1686.1)):
        for damping, unstable in ((border - 0.1, 2), (border + 0.1, 0)):
            changes = [f"robot.tau_m={tau} ms", f"contact.damping={damping} N.s/m"]
            found = linearise("docking-1d-uncompensated", changes)
            assert found.system.count_right_of(0.0) == unstable


def test_coefficients_come_from_the_config():
    loop = gain("docking-1d-uncompensated", ["robot.tau_m=3 ms", "contact.damping=50 N.s/m"])
    s = np.array([1j, 3 + 25j, 400j])
    servo = OMEGA**2 / (s**2 + 2 * XI * OMEGA * s + OMEGA**2) * np.exp(-3e-3 * s)
    np.testing.assert_allclose(loop(s), (STIFFNESS + 50 * s) * servo / (MASS * s**2), rtol=1e-6)


def test_refusals_of_systems_taken_in():
    with pytest.raises(ConfigError) as caught:
        DelaySystem.loop(control.tf([1.0], [1.0, 0.5], 0.1), -1.0, "sensor")
    assert str(caught.value) == (
        "sensor: it has 1 inputs, 1 outputs and dt = 0.1\n"
        "  continuous time, as many outputs as inputs\n"
        "sensor: delay is -1.0 s\n  allowed: finite and not negative"
    )


class Unknown(Effect):
    """An effect of a user's, whose law nobody knows here."""


def through(effects: str, *more: str) -> ContactLoop:
    return ContactLoop.of(PLAIN, [f"connections[satellite.force].through={effects}", *more])


def gain(name: str, overrides=()):
    loop = ContactLoop.of(name, overrides)
    return lambda s: loop.linear.system.response(loop.back, s)


def test_effects_on_connections_are_part_of_the_loop():
    plain = gain(PLAIN)
    s = np.array([1j, 3 + 25j, 400j])
    found = through("[{delay: 1 ms}, {low-pass: 200 Hz}, {gain: 0.5}, {offset: 3 N}]")
    expected = 0.5 * np.exp(-1e-3 * s) / (1 + s / (400 * np.pi)) * plain(s)
    np.testing.assert_allclose(found.linear.system.response(found.back, s), expected, rtol=1e-6)
    held = through("[{saturate: {low: -9 N, high: 9 N}}, {sample-and-hold: 4 ms}]")
    found = held.linear.system.response(held.back, s)
    np.testing.assert_allclose(found, np.exp(-2e-3 * s) * plain(s), rtol=1e-6)
    assert [one.rpartition(": ")[2] for one in held.linear.notes[-2:]] == [
        "saturate is not linear and is left out",
        "sample-and-hold counts as a delay of half a period",
    ]
    # A delay in the path back acts as one of the robot.
    one, two = through("[{delay: 4 ms}]"), ContactLoop.of(PLAIN, ["robot.tau_m=6 ms"])
    for mode, other in zip(one.linear.modes(4).modes[:2], two.linear.modes(4).modes[:2], strict=True):
        assert mode.root == pytest.approx(other.root, rel=1e-5)


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
    np.testing.assert_allclose(gain(path)(s), -2 * gain(PLAIN)(s), rtol=1e-6)


def test_effects_without_a_law_here_are_known_to_runs_alone():
    assert effect_path(Unknown()) is None
    assert not {"drift", "dropout", "jitter", "map"} & set(known_effects())
    with pytest.raises(ConfigError, match="the effect jitter has no transfer function that is known here"):
        through("[{jitter: 1 ms, period: 2 ms, seed: 1}]")


@pytest.mark.parametrize("sizes", [(5,), (4, 1, 1), (6, 3), (12,)])
def test_multiple_roots_count_as_a_whole(sizes):
    """Integrators in chains, mixed by a matrix, beside x' = -x(t - 1): rounding separates what lies at 0."""
    draw = np.random.default_rng(sum(sizes))
    chains = scipy.linalg.block_diag(*(np.eye(size, k=1) for size in sizes), np.zeros((1, 1)))
    n = len(chains)
    turn = scipy.linalg.qr(draw.normal(size=(n, n)))[0]
    into, seen = turn[:, -1:], turn[:, -1][None]
    names = tuple(f"x{index}" for index in range(n))
    link = Link("y -> u", 0, 0, -1.0, 1.0)
    system = DelaySystem(turn @ chains @ turn.T, into, seen, np.zeros((1, 1)), names, ("u",), ("y",), (link,))
    found = roots(system, sum(sizes) + 2)
    own = scalar(0.0, -1.0, 1.0)[0]
    assert sum(abs(found) < 1e-12) == sum(sizes)
    assert found[abs(found) > 1e-12][0] == pytest.approx(own.real + 1j * abs(own.imag), rel=1e-9)
    assert system.modes(sum(sizes) + 2).unstable == 0


def test_roots_that_are_near_one_another_are_distinguished():
    poles = np.array([-1e-3, -2e-3, -3e-3, -100.0])
    system = DelaySystem(
        np.diag(poles), *(np.zeros(one) for one in ((4, 0), (0, 4), (0, 0))), tuple("abcd"), (), (), ()
    )
    assert roots(system, 4) == pytest.approx(poles, rel=1e-9)


def test_an_open_contact_leaves_integrators_alone():
    """Two free bodies without force, with filters and clocks that nothing shows left out."""
    modes = linearise("docking-6d-uncompensated").modes(1)
    assert [one.root for one in modes.modes] == 15 * [0.0] and modes.line > -400.0


@pytest.mark.parametrize("pole", [-0.05, -0.0313208716, 3e4, 0.0])
def test_one_state_without_connections_has_its_root(pole):
    empty = np.zeros((1, 0)), np.zeros((0, 1)), np.zeros((0, 0))
    (mode,) = DelaySystem(np.array([[pole]]), *empty, ("level",), (), (), ()).modes().modes
    assert mode.root == pytest.approx(pole, rel=1e-12, abs=1e-15) and mode.residual < 1e-12


def test_a_connection_that_there_is_not_is_refused():
    system = DelaySystem.loop(control.tf([1.0], [1.0, 1.0]), 0.5, "y -> delay -> u")
    for name in ("y -> delay -> u", "y -> u", "u"):
        assert system.later(name, 0.25).modes().modes[0].root.real < 0.0
    for change in (system.later, system.scaled):
        with pytest.raises(ConfigError, match="no connection 'v'"):
            change("v", 2.0)
    with pytest.raises(ConfigError, match="no connection 'v'"):
        system.margins("v")
