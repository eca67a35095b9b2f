"""Roots and borders of delay systems that are published or have a closed form, and random ones simulated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import random_systems
import scipy.linalg
from scipy.optimize import brentq

import orchestrator as orc
from orchestrator.frequency.delay_equation import Link
from orchestrator.frequency.delay_system import DelaySystem
from orchestrator.frequency.from_system import linearise
from orchestrator.frequency.sampled_system import sampled_system
from orchestrator.frequency.step_report import largest_step
from orchestrator.simulation.run import prepare


def dde(a, *delayed):
    """x' = A x + sum of A_k x(t - tau_k); `delayed`: pairs of A_k and tau_k."""
    a = np.asarray(a, float)
    n, eye = len(a), np.eye(len(a))
    links = tuple(
        Link(f"term {place}", int(j), int(i), float(matrix[i][j]), delay)
        for place, (matrix, delay) in enumerate(delayed)
        for i, j in np.argwhere(np.asarray(matrix) != 0)
    )
    names = [tuple(f"p.{kind}{index}" for index in range(n)) for kind in "xuy"]
    return DelaySystem(a, eye, eye, 0.0 * eye, *names, links)


def rightmost(system, count=6):
    return system.modes(count).modes[0].root


def neurons(coupling):
    """Two neurons, linear around rest: the example of DDE-BIFTOOL's manual."""
    return dde(-0.5 * np.eye(2), (-np.eye(2), 1.5), ([[0.0, 1.0], [coupling, 0.0]], 0.2))


def test_hopf_point_of_the_neurons_of_dde_biftool():
    """Engelborghs, Luzyanina, Samaey, Sieber, DDE-BIFTOOL manual: a_21 = 0.8071, omega = 0.7820."""
    border = brentq(lambda one: rightmost(neurons(one)).real, 0.7, 0.9, xtol=1e-10)
    assert border == pytest.approx(0.8071, abs=5e-5)
    assert rightmost(neurons(border)).imag == pytest.approx(0.7820, abs=5e-5)
    # The pitchfork at which a root is 0: (kappa - beta)^2 = a_12 a_21.
    assert min(abs(one.root) for one in neurons(2.25).modes(8).modes) < 1e-9
    assert neurons(2.26).modes(8).unstable - neurons(2.24).modes(8).unstable in (-1, 1)


def test_delay_margin_of_the_usual_example_of_the_delay_literature():
    """Gu, Kharitonov, Chen, Stability of Time-Delay Systems (2003): stable up to 6.1725."""
    a, late = np.diag([-2.0, -0.9]), [[-1.0, 0.0], [-1.0, -1.0]]
    border = brentq(lambda delay: rightmost(dde(a, (late, delay))).real, 5.0, 7.0, xtol=1e-10)
    assert border == pytest.approx(6.1725, abs=2e-4)
    # In closed form, of s = -0.9 - exp(-s tau).
    omega = np.sqrt(1.0 - 0.81)
    assert border == pytest.approx(np.arccos(-0.9) / omega, rel=1e-9)


# Examples of TDS-CONTROL: Verheyden, Luzyanina, Roose, J. Comput. Appl. Math. 214 (2008); Wu,
# Michiels, J. Comput. Appl. Math. 236 (2012).
EXAMPLES = {
    "Verheyden": (
        [[-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -10, -4], [0, 0, 4, -10]],
        ([[3, 3, 3, 3], [0, -1.5, 0, 0], [0, 0, 3, -5], [0, 5, 5, 5]], 1.0),
    ),
    "Wu": (
        [[-9.6713, -9.7546, -9.4913], [1.8381, 1.7961, 9.5716], [1.3647, -2.7957, -7.3561]],
        ([[1.0115, -9.3006, 5.3222], [7.2688, -1.1960, 9.9968], [3.6508, -1.2035, -4.8507]], 0.1),
        ([[7.7163, 4.5911, -5.5072], [-9.0056, -0.0260, -7.5404], [-3.3669, 0.9332, -0.2958]], 0.15),
        ([[7.4808, -7.2571, 9.4377], [2.8285, -7.1768, -1.4221], [-1.0353, 9.6519, 5.1208]], 0.25),
    ),
}


def test_pocket_of_stability_of_a_system_with_one_delay():
    """Olgac, Sipahi, IEEE TAC 47 (2002): stable up to 0.1624 and from 0.1859 to 0.2219."""
    a = [[-1.0, 13.5, -1.0], [-3.0, -1.0, -2.0], [-2.0, -1.0, -4.0]]
    late = [[-5.9, 7.1, -70.3], [2.0, -1.0, 5.0], [2.0, 0.0, 6.0]]
    system = dde(a, (late, 0.0))
    joined = replace(system, links=tuple(one._replace(connection="late") for one in system.links))
    each = tuple(one._replace(connection=f"late {place}") for place, one in enumerate(system.links))
    assert replace(system, links=each).delay_margin().delay == pytest.approx(0.1624, abs=1e-4)

    def rate(delay):
        return rightmost(joined.later("late", delay)).real

    borders = [brentq(rate, *bracket, xtol=1e-9) for bracket in ((0.15, 0.17), (0.18, 0.2), (0.2, 0.23))]
    assert borders == pytest.approx([0.1624, 0.1859, 0.2219], abs=1e-4)
    assert rate(0.17) > 0.0 > rate(0.2)


def generator(a, delayed, order):
    """Eigenvalues of the collocated generator over the longest delay (Breda, Maset, Vermiglio, 2005)."""
    n, longest = len(a), max(delay for _, delay in delayed)
    nodes = 0.5 * longest * (np.cos(np.pi * np.arange(order + 1) / order) - 1.0)
    weights = np.array(
        [1.0 / np.prod(4.0 * (one - np.delete(nodes, k)) / longest) for k, one in enumerate(nodes)]
    )
    gaps = nodes[:, None] - nodes
    with np.errstate(divide="ignore"):
        slope = weights / weights[:, None] / gaps
    np.fill_diagonal(slope, 0.0)
    np.fill_diagonal(slope, -slope.sum(axis=1))
    whole = np.kron(slope, np.eye(n))
    whole[:n] = 0.0
    for matrix, delay in ((a, 0.0), *delayed):
        apart = -delay - nodes
        near = np.argmin(abs(apart))
        if abs(apart[near]) < 1e-12:
            values = np.eye(order + 1)[near]
        else:
            values = weights / apart / np.sum(weights / apart)
        whole[:n] += np.kron(values, matrix)
    return np.linalg.eigvals(whole)


@pytest.mark.parametrize("name", EXAMPLES)
def test_examples_of_tds_control(name):
    """Against the eigenvalues of the infinitesimal generator, as that program finds them."""
    a, *delayed = EXAMPLES[name]
    delayed = [(np.array(matrix, float), delay) for matrix, delay in delayed]
    found = dde(a, *delayed).modes(10)
    expected = generator(np.array(a, float), delayed, 48)
    right = expected[expected.real > found.line]
    assert len(right) == sum(2 if one.root.imag else 1 for one in found.modes)
    for one in found.modes:
        assert np.min(abs(right - one.root)) < 1e-7 * abs(one.root)


@pytest.mark.parametrize("omega", [0.4, 1.0, 1.6])
def test_stability_border_of_a_balanced_pendulum(omega):
    """x'' = a x - P x(t - tau) - D x'(t - tau), with P and D of Stepan (1989)."""
    a, delay = 2.0, 0.6
    p = (omega**2 + a) * np.cos(omega * delay)
    d = (omega**2 + a) * np.sin(omega * delay) / omega

    def loop(factor):
        return dde([[0.0, 1.0], [a, 0.0]], ([[0.0, 0.0], [-factor * p, -factor * d]], delay))

    roots = [one.root for one in loop(1.0).modes(8).modes]
    assert min(abs(one - 1j * omega) for one in roots) < 1e-9
    assert abs(loop(1.001).modes(8).unstable - loop(0.999).modes(8).unstable) == 2


def test_longest_delay_with_which_a_pendulum_can_be_balanced():
    """sqrt(2/a): just below there are stable gains, just above there are none (Stepan 1989)."""
    a = 2.0
    critical = np.sqrt(2.0 / a)

    def stable(p, d, delay):
        return dde([[0.0, 1.0], [a, 0.0]], ([[0.0, 0.0], [-p, -d]], delay)).modes().stable

    omega = np.linspace(0.01, 1.0, 400)
    below = 0.9 * critical
    top = (omega**2 + a) * np.cos(omega * below)
    best = omega[np.argmax(top)]
    assert stable(0.5 * (a + top.max()), (best**2 + a) * np.sin(best * below) / best, below)
    gains = [(p, d) for p in np.linspace(1.0, 1.5, 6) * a for d in np.linspace(0.5, 1.6, 8) * a * critical]
    assert not any(stable(p, d, 1.02 * critical) for p, d in gains)


@pytest.mark.parametrize("lobe", [1, 2, 5])
@pytest.mark.parametrize("ratio", [1.02, None, 1.3])
def test_lobes_of_turning(lobe, ratio):
    """x'' + 2 zeta x' + x = -w (x - x(t - tau)); the least w of all lobes is 2 zeta (1 + zeta)."""
    zeta = 0.05
    r = ratio or np.sqrt(1.0 + 2.0 * zeta)
    w = ((1.0 - r * r) ** 2 + (2.0 * zeta * r) ** 2) / (2.0 * (r * r - 1.0))
    delay = 2.0 / r * (lobe * np.pi - np.arctan((r * r - 1.0) / (2.0 * zeta * r)))

    def turning(factor):
        cut = factor * w
        a = [[0.0, 1.0], [-1.0 - cut, -2.0 * zeta]]
        return dde(a, ([[0.0, 0.0], [cut, 0.0]], delay))

    roots = [one.root for one in turning(1.0).modes(14).modes]
    assert min(abs(one - 1j * r) for one in roots) < 1e-9
    assert turning(1.002).modes(14).unstable - turning(0.998).modes(14).unstable == 2
    if ratio is None:
        assert w == pytest.approx(2.0 * zeta * (1.0 + zeta))
        assert turning(0.998).modes().stable


def test_margins_of_a_delayed_loop_that_a_toolbox_could_not_find():
    """ControlSystems.jl issue 941: C G H exp(-s), C = 0.6 + 30 s; margins of the response as written."""
    numerator = np.polymul(np.polymul([30.0, 0.6], [0.04, 0.0001, 1.1]), [0.25])
    denominator = np.polymul([1.0, 0.03, 254.9], [1.0, 1.0, 0.25])
    a = np.diag(np.ones(3), 1)
    a[-1] = -denominator[:0:-1]
    c = np.zeros((1, 4))
    c[0, : len(numerator)] = numerator[::-1]
    b = np.array([[0.0], [0.0], [0.0], [1.0]])
    link = Link("p.y -> p.u", 0, 0, -1.0, 1.0)
    system = DelaySystem(a, b, c, np.zeros((1, 1)), tuple("abcd"), ("p.u",), ("p.y",), (link,))

    def response(omega):
        s = 1j * omega
        return np.polyval(numerator, s) / np.polyval(denominator, s) * np.exp(-s)

    omega = np.geomspace(1e-3, 1e2, 400_000)
    size = abs(response(omega)) - 1.0
    places = np.flatnonzero(np.diff(np.sign(size)))
    crossings = [brentq(lambda w: abs(response(w)) - 1.0, omega[k], omega[k + 1]) for k in places]
    found = system.margins("p.y -> p.u", system.modes())
    assert [one.omega for one in found.crossovers] == pytest.approx(crossings, rel=1e-9)
    for one, w in zip(found.crossovers, crossings, strict=True):
        assert one.phase_margin == pytest.approx(np.degrees(np.angle(-response(w))), abs=1e-6)
    values = response(omega)
    places = np.flatnonzero((np.diff(np.sign(values.imag)) != 0) & (values.real[1:] < 0.0))
    turns = [brentq(lambda w: response(w).imag, omega[k], omega[k + 1]) for k in places]
    factors = [-1.0 / response(w).real for w in turns]
    expected = min((one for one in factors if one > 1.0), default=np.inf)
    assert found.gain_margin[1] == pytest.approx(expected, rel=1e-6)
    assert found.stable is (system.count_right_of(0.0) == 0)


PLANT = """
model Plant "x' = A x + u"
  parameter Real a11 = -1;
  parameter Real a12 = 0;
  parameter Real a13 = 0;
  parameter Real a21 = 0;
  parameter Real a22 = -1;
  parameter Real a23 = 0;
  parameter Real a31 = 0;
  parameter Real a32 = 0;
  parameter Real a33 = -1;
  input Real u1(start = 0);
  input Real u2(start = 0);
  input Real u3(start = 0);
  output Real x1(start = 0, fixed = true);
  output Real x2(start = 0, fixed = true);
  output Real x3(start = 0, fixed = true);
equation
  der(x1) = a11 * x1 + a12 * x2 + a13 * x3 + u1;
  der(x2) = a21 * x1 + a22 * x2 + a23 * x3 + u2;
  der(x3) = a31 * x1 + a32 * x2 + a33 * x3 + u3;
end Plant;
"""


@pytest.fixture(scope="module")
def plant(tmp_path_factory):
    pytest.importorskip("casadi", reason="needs the extra build")
    folder = tmp_path_factory.mktemp("plant")
    (folder / "Plant.mo").write_text(PLANT, encoding="utf-8")
    return str(orc.build(folder / "Plant.mo", folder / "Plant.fmu").path)


def sampled_feedback(plant, a, gains, step, *through):
    """u = K x of the last communication point; `gains`: from a state to an input, by their numbers."""
    start = {f"a{i + 1}{j + 1}": float(value) for (i, j), value in np.ndenumerate(np.asarray(a))}
    targets = sorted({target for _, target in gains})
    connections = [
        {
            "from": [
                {"port": f"p.x{source}", "gain": gains[source, target]}
                for source, to in gains
                if to == target
            ],
            "to": f"p.u{target}",
            "through": list(through),
        }
        for target in targets
    ]
    others = {f"u{number}": 0.0 for number in (1, 2, 3) if number not in targets}
    return {
        "run": {"master": "jacobi", "step_size": f"{step!r} s", "stop_time": f"{10 * step:.12g} s"},
        "instances": {"p": {"fmu": plant, "start": {**start, **others}}},
        "connections": connections,
    }


def sampled(config):
    prepared = prepare(config)
    return sampled_system(prepared, linearise(prepared))


def test_longest_sampling_of_networked_control(plant):
    """Zhang, Branicky, Phillips, IEEE Control Systems Magazine 21 (2001): stable for sampling up to 1.7 s."""
    a = [[0.0, 1.0], [0.0, -0.1]]
    config = sampled_feedback(plant, a, {(1, 2): -0.375, (2, 2): -1.15}, 0.1)
    prepared = prepare(config, ("run.stop_time=100 s",))
    found = largest_step(prepared, linearise(prepared), 0, False, False)["value"]
    assert found == pytest.approx(1.7, abs=0.05)

    def radius(step):
        whole = np.zeros((3, 3))
        whole[:2, :2], whole[1, 2] = a, 1.0
        made = scipy.linalg.expm(whole * step)
        return np.max(abs(np.linalg.eigvals(made[:2, :2] + made[:2, 2:] @ [[-0.375, -1.15]]))) - 1.0

    assert found == pytest.approx(brentq(radius, 1.0, 3.0), rel=3e-4)


# (numerator, denominator), and the margins that Matlab gives, or python-control since it is repaired.
MARGINS = {
    # python-control issue 465
    "third order": ([2.0], [1.0, 3.0, 2.0, 0.0], 2.7928, 1.36397, 31.5416, 0.749339),
    # python-control issue 523
    "resonant": (
        [1.1 * (2 * np.pi) ** 2],
        [1.0, 0.8 * np.pi, (2 * np.pi) ** 2],
        2.384196,
        11.711872,
        18.161036,
        8.747772,
    ),
}


@pytest.mark.parametrize("name", MARGINS)
def test_margins_of_sampled_loops(plant, name):
    """With held inputs at 0.05 s, in the co-simulation that does this: where gain and delay end stability."""
    numerator, denominator, gain_margin, gain_omega, phase_margin, phase_omega = MARGINS[name]
    order = len(denominator) - 1
    a = -np.eye(3)
    a[:order, :order] = np.diag(np.ones(order - 1), 1)
    a[order - 1, :order] = -np.array(denominator[:0:-1])

    def loop(factor, *through):
        return sampled(sampled_feedback(plant, a, {(1, order): -factor * numerator[0]}, 0.05, *through))

    assert loop(0.9999 * gain_margin).unstable == 0
    assert loop(1.0001 * gain_margin).unstable == 2
    assert loop(gain_margin).modes()[0].root.imag == pytest.approx(gain_omega, rel=1e-4)
    late = np.radians(phase_margin) / phase_omega
    assert loop(1.0, {"delay": f"{0.995 * late:.9g} s"}).unstable == 0
    # The line between two points takes from the gain what lets the delay be a little longer.
    assert loop(1.0, {"delay": f"{1.06 * late:.9g} s"}).unstable == 2


@pytest.mark.parametrize(("states", "delays"), [((2, 20), (1, 4)), ((20, 60), (2, 6))])
def test_signs_of_stability_of_random_systems(states, delays):
    """Those nearer to the border than 1 % of their rate are not judged; 500 are in tests/benchmarks."""
    count = 100 if states[1] == 20 else 15
    systems = random_systems.drawn(count, states, delays, seed=20)
    found = random_systems.compared(systems)
    assert found.judged > 0.9 * count and found.wrong == 0
    assert 0.15 * count < found.unstable < 0.85 * count
    assert found.median_error < 2e-3


@pytest.mark.parametrize(
    ("gain", "published"),
    [(0.05, 30.915), (0.1, 15.201), (0.15, 9.960), (0.2, 7.335), (0.4, 3.382), (0.6, 2.042), (1.0, 0.923)],
)
def test_delay_margins_of_load_frequency_control(gain, published):
    """Integral control of one area, Sonmez, Ayasun, Nwankpa, IEEE Trans. Power Systems 31 (2016)."""
    system = orc.System(step_size="20 ms", stop_time="10 s")
    system.add("area", "Area", tie=0.0, integral_gain=gain)
    system.connect("area.command", "area.setpoint")
    (margin,) = linearise(system.data).margins().values()
    assert margin.delay_margin == pytest.approx(published, abs=6e-4)


@pytest.mark.parametrize("name", ["servo-compliant", "tank-level", "load-frequency"])
def test_bundled_examples_with_a_delay_become_unstable_at_their_delay_margin(name):
    linear = linearise(name)
    late = {key: one.delay_margin for key, one in linear.margins().items() if " delay " in key}
    connection, margin = next((key, one) for key, one in late.items() if np.isfinite(one))
    for factor, unstable in ((0.999, 0), (1.001, 2)):
        later = linear.system.later(connection, factor * margin)
        assert later.modes().unstable == unstable
