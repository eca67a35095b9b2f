"""Loops whose corners lie far apart, sharp resonances, and loops that negative feedback meets at rest."""

import control
import numpy as np
import pytest

from orchestrator.docking.stability import ContactLoop
from orchestrator.frequency import DelaySystem, Margins
from orchestrator.frequency.margins import gain_crossovers


def margins(system, delay: float = 0.0) -> Margins:
    return DelaySystem.loop(system, delay).margins("loop")


@pytest.mark.parametrize("gain", [1e-9, 1e-4, 1.0])
def test_a_slow_crossover_behind_a_fast_pole(gain):
    """L = g/(s (1 + T s)) crosses at g; a delay of a right angle there is what it bears."""
    loop = control.tf([gain], [1e-6, 1.0, 0.0])
    reported = margins(loop)
    assert [one.omega for one in reported.crossovers] == [pytest.approx(gain, rel=1e-9)]
    assert reported.delay_margin == pytest.approx(np.pi / 2 / gain, rel=1e-5)


def test_a_soft_contact_behind_a_fast_sensor():
    """1 N/mm on 4000 kg is 0.08 Hz; a filter of 1 MHz is seven decades away."""
    slow = ["contact.stiffness=1 N/mm", "satellite.mass=4000 kg", "contact.damping=100 N.s/m"]
    through = "connections[satellite.force].through=[{low-pass: 1 MHz}]"
    plain, fast = (ContactLoop.of("docking-1d-uncompensated", one) for one in (slow, [*slow, through]))
    alone, behind = (one.linear.margins(names=[one.back])[one.back] for one in (plain, fast))
    assert len(behind.crossovers) == len(alone.crossovers) == 1
    assert behind.delay_margin == pytest.approx(alone.delay_margin, rel=1e-4)
    assert behind.modulus_margin == pytest.approx(alone.modulus_margin, rel=1e-4)


def test_gain_margin_of_a_double_integrator_at_low_frequency():
    """K (s + 1)^2/s^3 is stable from k = 1/2 on, however slow the rest of it."""
    slow = 1e-5
    loop = control.tf([1.0, 2 * slow, slow**2], [1.0 / slow, 0.0, 0.0, 0.0])
    reported = margins(loop * control.tf([1.0], [1e-6, 1.0]))
    assert reported.stable
    assert reported.gain_margin[0] == pytest.approx(0.5, rel=1e-6)


@pytest.mark.parametrize(
    "loop, delay, expected",
    [
        # Stable by its feedback, from a gain of one on.
        (control.tf([2.0], [1.0, -1.0]), 0.0, (0.5, np.inf)),
        (control.tf([2.0], [1.0, -1.0]), 0.1, (0.5, 7.538715907332869)),
        # A feedback of the wrong sign is borne up to one.
        (control.tf([-0.5], [1.0, 1.0]), 0.0, (0.0, 2.0)),
        (control.tf([-0.5, 0.0], [1.0, 2.0, 1.0]), 0.0, (0.0, 4.0)),
        (control.tf([0.5], [1.0, 1.0]), 0.0, (0.0, np.inf)),
    ],
)
def test_the_gain_margin_counts_where_the_locus_begins(loop, delay, expected):
    assert margins(loop, delay).gain_margin == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("damping", [0.0, 1e-9, 1e-6, 1e-5])
@pytest.mark.parametrize("place", np.linspace(0.0, 1.0, 7))
def test_a_resonance_narrower_than_the_grid(damping, place):
    """A w^2/(s^2 + 2 z w s + w^2): |L| is above one where |1 - (x/w)^2| < a, wherever the grid stands."""
    # A lag in front, so that the grid does not move with the resonance.
    ratio, size, lag = 10 ** (1 / 1500), 4e-5, 0.01
    w = 3.0 * ratio**place
    loop = control.tf([size * w * w], [1.0, 2 * damping * w, w * w])
    reported = margins(loop * control.tf([1.0], [lag, 1.0]), 0.5)
    half = np.sqrt(size**2 / (1 + (lag * w) ** 2) - (2 * damping) ** 2)
    expected = [w * np.sqrt(1 - half), w * np.sqrt(1 + half)]
    assert [one.omega for one in reported.crossovers] == pytest.approx(expected, rel=1e-7)
    assert [one.falling for one in reported.crossovers] == [False, True]


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
        loop = control.ss(control.tf([0.9], [1.0, 0.02, 1.0])) + control.ss(
            control.tf([-0.97 * 2 * sharp * w, 0.0], [1.0, 2 * sharp * w, w * w])
        )
        dense = w * (1.0 + np.linspace(-2e-3, 2e-3, 400001))
        s = 1j * dense
        value = 0.9 / (s**2 + 0.02 * s + 1.0) - 0.97 * 2 * sharp * w * s / (s**2 + 2 * sharp * w * s + w * w)
        least = float(np.min(np.abs(1.0 + value)))
        assert margins(loop).modulus_margin == pytest.approx(least, rel=1e-6)
