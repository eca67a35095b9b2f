"""A period of the encoder residuals where commands are late periodically."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.diagnosis.rig.challenge.draw import Plan
from orchestrator.diagnosis.rig.challenge.hidden import HIDDEN
from orchestrator.diagnosis.rig.challenge.outside import OUTSIDE
from orchestrator.diagnosis.rig.hardware import weigh_rig
from orchestrator.diagnosis.rig.periodic_delays import rhythm
from tests.benchmarks.rig_calibration.simulated_cases import simulated_study

TICKS = np.arange(3000)


def runs(size: float, period: float = 5.0, noisy=lambda draw, speed: draw) -> float:
    """Evidence in three runs that stray by so much of their noise where they are fastest."""
    draw = np.random.default_rng(3)
    residuals, positions = [], []
    for pace in (0.014, 0.02, 0.02):
        speed = pace * np.sign(np.sin(TICKS / 400.0))
        late = np.cos(2.0 * np.pi * (TICKS / period + draw.random()))
        residuals.append(noisy(draw.standard_normal(len(TICKS)), speed) + size * speed / 0.02 * late)
        positions.append(np.cumsum(speed) * 1e-3)
    return rhythm(residuals, positions)


@pytest.mark.parametrize("period", [3.0, 5.0, 7.3, 18.2, 41.8])
def test_a_period_is_reported_from_far_below_the_noise(period):
    assert runs(0.0, period) == 0.0
    assert runs(0.3, period) > 10.0


def test_what_strays_without_a_period_tells_none():
    """Be it as large as the robot is fast, slow, or of nearly two ticks, as rounding is on every rig."""
    assert runs(0.0, noisy=lambda draw, speed: draw * (1.0 + 100.0 * np.abs(speed))) == 0.0
    assert runs(0.0, noisy=lambda draw, speed: draw + np.convolve(draw, np.ones(40) / 4.0, "same")) == 0.0
    assert runs(1.0, 2.01) == runs(1.0, 300.0) == 0.0


def test_runs_that_do_not_move_or_run_away_tell_nothing():
    noise = np.random.default_rng(4).standard_normal(len(TICKS))
    assert rhythm([noise], [np.zeros(len(TICKS))]) == 0.0
    assert rhythm([noise + np.inf], [1e-5 * TICKS]) == 0.0


def test_commands_that_wait_for_their_turn_are_not_what_chance_delays():
    late, _ = simulated_study(71, 1, plan=Plan("outside", (OUTSIDE["link.time-slots"],), 0.3))
    chance, _ = simulated_study(71, 2, plan=Plan("single", (HIDDEN["link.jitter"],), 0.5))
    assert (found := weigh_rig(late)).outside > 10.0 and found.place == "link"
    assert weigh_rig(chance).outside == 0.0
