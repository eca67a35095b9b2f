"""Loops whose corners lie far apart, sharp resonances, and loops that negative feedback meets at rest."""

import numpy as np
import pytest

from orchestrator.frequency import Loop, Transfer, critical_delays, margins
from orchestrator.frequency.margins import gain_crossovers
from orchestrator.frequency.spans import at_rest, span


@pytest.mark.parametrize("gain", [1e-9, 1e-4, 1.0])
def test_a_slow_crossover_behind_a_fast_pole(gain):
    """L = g/(s (1 + T s)) crosses at g; a delay of a right angle there is what it bears."""
    loop = Transfer.rational([gain], [1e-6, 1.0, 0.0])
    told = margins(loop)
    assert [one.omega for one in told.crossovers] == [pytest.approx(gain, rel=1e-9)]
    assert told.delay_margin == pytest.approx(np.pi / 2 / gain, rel=1e-5)
    begin, found = critical_delays(Transfer(), loop, 2.0 / gain)
    assert begin == 0 and [one.delay for one in found] == [pytest.approx(np.pi / 2 / gain, rel=1e-5)]


def test_a_soft_contact_behind_a_fast_sensor():
    """1 N/mm on 4000 kg is 0.08 Hz; a sensor of 1 MHz put that below the frequencies looked at."""
    slow = ["contact.stiffness=1 N/mm", "satellite.mass=4000 kg", "contact.damping=100 N.s/m"]
    fast = Transfer.rational([1.0], [1.0 / (2e6 * np.pi), 1.0])
    plain = Loop.of("docking-1d-uncompensated", slow).gain()
    alone, behind = margins(plain), margins(plain * fast)
    assert len(behind.crossovers) == len(alone.crossovers) == 1
    assert behind.delay_margin == pytest.approx(alone.delay_margin, rel=1e-4)
    assert behind.modulus_margin == pytest.approx(alone.modulus_margin, rel=1e-4)


def test_gain_margin_of_a_double_integrator_at_low_frequency():
    """K (s + 1)^2/s^3 is stable from k = 1/2 on, however slow the rest of it."""
    slow = 1e-5
    loop = Transfer.rational([1.0, 2 * slow, slow**2], [1.0 / slow, 0.0, 0.0, 0.0])
    told = margins(loop * Transfer.rational([1.0], [1e-6, 1.0]))
    assert told.stable
    assert told.gain_margin[0] == pytest.approx(0.5, rel=1e-6)


@pytest.mark.parametrize(
    "loop, expected",
    [
        # Stable by its feedback, from a gain of one on.
        (Transfer.rational([2.0], [1.0, -1.0]), (0.5, np.inf)),
        (Transfer.rational([2.0], [1.0, -1.0], 0.1), (0.5, 7.538715907332869)),
        # A feedback of the wrong sign is borne up to one.
        (Transfer.rational([-0.5], [1.0, 1.0]), (0.0, 2.0)),
        (Transfer.rational([-0.5, 0.0], [1.0, 2.0, 1.0]), (0.0, 4.0)),
        (Transfer.rational([0.5], [1.0, 1.0]), (0.0, np.inf)),
    ],
)
def test_the_gain_margin_counts_where_the_locus_begins(loop, expected):
    assert margins(loop).gain_margin == pytest.approx(expected, rel=1e-9)


def test_at_rest():
    assert at_rest(Transfer.rational([3.0], [1.0, 2.0]) + Transfer.rational([1.0], [1.0, 4.0], 0.3)) == 1.75
    assert at_rest(Transfer.rational([1.0], [1.0, 0.0])) == np.inf
    assert at_rest(Transfer.rational([5.0, 0.0], [1.0, 1.0])) == 0.0
    assert at_rest(Transfer.rational([5.0, 0.0], [2.0, 4.0, 0.0])) == 1.25


@pytest.mark.parametrize("damping", [0.0, 1e-9, 1e-6, 1e-5])
@pytest.mark.parametrize("place", np.linspace(0.0, 1.0, 7))
def test_a_resonance_narrower_than_the_grid(damping, place):
    """A w^2/(s^2 + 2 z w s + w^2): |L| is above one where |1 - (x/w)^2| < a, wherever the grid stands."""
    # A lag in front, so that the grid does not move with the resonance.
    ratio, size, lag = 10 ** (1 / 1500), 4e-5, 0.01
    w = 3.0 * ratio**place
    loop = Transfer.rational([size * w * w], [1.0, 2 * damping * w, w * w], 0.5)
    told = margins(loop * Transfer.rational([1.0], [lag, 1.0]))
    half = np.sqrt(size**2 / (1 + (lag * w) ** 2) - (2 * damping) ** 2)
    expected = [w * np.sqrt(1 - half), w * np.sqrt(1 + half)]
    assert [one.omega for one in told.crossovers] == pytest.approx(expected, rel=1e-7)
    assert [one.falling for one in told.crossovers] == [False, True]


@pytest.mark.parametrize("place", np.linspace(0.0, 0.5, 6))
def test_a_peak_between_two_frequencies_shows_wherever_it_stands(place):
    """Halfway between them both have the same level, and only the next ones tell that there is a peak."""
    peak = 10.0 + place
    found = gain_crossovers(
        lambda s: 2.0 / (1.0 + ((np.abs(s) - peak) / 0.3) ** 2) + 0j, np.arange(5.0, 16.0)
    )
    assert [w for w, _ in found] == pytest.approx([peak - 0.3, peak + 0.3], rel=1e-9)


def test_the_lowest_of_several_dips_is_the_modulus_margin():
    """Beside a broad dip a sharp one, the lower of the two, which the frequencies looked at just miss."""
    sharp = 5e-4
    for place in np.linspace(0.0, 1.0, 11):
        w = 40.0 * 10 ** (place / 1500)
        loop = Transfer.rational([0.9], [1.0, 0.02, 1.0]) + Transfer.rational(
            [-0.97 * 2 * sharp * w, 0.0], [1.0, 2 * sharp * w, w * w]
        )
        dense = w * (1.0 + np.linspace(-2e-3, 2e-3, 400001))
        least = float(np.min(np.abs(1.0 + loop(1j * dense))))
        assert margins(loop).modulus_margin == pytest.approx(least, rel=1e-6)


def test_a_loop_that_carries_nothing():
    told = margins(Transfer())
    assert told.stable and told.delay_margin == np.inf
    assert told.gain_margin == (0.0, np.inf) and told.modulus_margin == 1.0


def test_frequencies_of_an_ordinary_loop_are_six_decades():
    omega = span(Transfer.rational([8.0], np.poly([-1.0, -2.0, -3.0])))
    assert len(omega) == 9001
    assert omega[-1] / omega[0] == pytest.approx(1e6)
