"""What each of the fresh kinds outside the catalogue does, by itself."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from orchestrator.diagnosis.challenge.draw import NOISE, RUNS, TICKS, Plan, draw_case, make_run
from orchestrator.diagnosis.challenge.knobs import knobs
from orchestrator.diagnosis.challenge.rig import COLUMNS, drive
from orchestrator.diagnosis.challenge.series import draw_series
from orchestrator.diagnosis.challenge.software import first_satellite, move_satellite
from tests.diagnosis.challenge_parts import (
    PLANT,
    TICK,
    answers,
    force_at,
    lags,
    moved,
    pressed,
    pushed,
    series_of,
)

FORCE, ENCODER = COLUMNS.index("sensor_force"), COLUMNS.index("encoder_position")
RUN = RUNS[0]


@cache
def smooth():
    """A rig that is as the lab believes, but for its calibration, and its first run."""
    case = draw_case(Plan("none", (), 0.0), 78, 1, roughness=0.0)
    return case, make_run(case, 0)


@cache
def driven(**knobs):
    """What the blocks of that rig give without noise, driven by its log, with some knobs besides; series."""
    case, log = smooth()
    values = {**case.values, "noise_scale": 0.0, **knobs}
    series = draw_series(values, NOISE, TICKS, np.random.SeedSequence(1))
    return drive(case.lab, values, RUN.mass, RUN.speed, log, series), series


def rates(position):
    return np.gradient(position, TICK)


def test_a_sensor_with_its_own_cycle_repeats_what_is_no_older_than_that():
    plain, read = driven()[0][FORCE], driven(cycle=2.5e-3)[0][FORCE]
    pressing = np.abs(plain[3:]) > 20.0
    assert np.mean(np.diff(read)[2:][pressing] == 0.0) == pytest.approx(0.6, abs=0.01)
    since = np.stack([plain[3:], plain[2:-1], plain[1:-2], plain[:-3]])
    # Between two ticks, force may peak a little higher.
    assert np.all((read[3:] <= since.max(axis=0) + 0.5) & (read[3:] >= since.min(axis=0) - 0.5))
    assert np.abs(driven(cycle=1e-6)[0][FORCE] - plain).max() < 0.01


def test_a_sensor_errs_between_fringes():
    plain, bias = driven()[0][FORCE], smooth()[0].values["bias"]
    read = driven(fringe=1.5, fringe_span=30.0)[0][FORCE]
    assert read - plain == pytest.approx(1.5 * np.sin(2.0 * np.pi * (plain - bias) / 30.0), abs=1e-9)


def test_a_zero_shifts_by_chance_after_each_contact():
    read, series = driven(zero=1.0)
    shifts = read[FORCE] - driven()[0][FORCE]
    assert shifts[:200] == pytest.approx(0.0, abs=1e-9)
    levels = shifts[np.flatnonzero(np.abs(np.diff(shifts)) > 1e-6) + 1]
    assert len(levels) >= 4 and levels == pytest.approx(series.zero[1 : len(levels) + 1])
    assert np.std(series.zero) == pytest.approx(1.0, rel=0.15)


def test_a_weak_pole_lags_in_its_place():
    more = lags(5e-3, pole=0.4, pole_at=2.5e-3, pole_width=3e-4) / lags(5e-3)[-1]
    assert more[350:650].max() == pytest.approx(1.0 / 0.6, rel=0.03)
    assert more[-1] == pytest.approx(1.0, abs=1e-3)


def test_lost_counts_move_the_rod_unseen():
    found, series = driven(lost=4e-5, lost_rate=4.0)
    slips = np.flatnonzero(series.lost)
    assert set(np.abs(series.lost[slips])) == {4e-5} and 4 <= len(slips) <= 24
    seen = (found - driven()[0])[ENCODER]
    first = slips[0]
    assert seen[first] == pytest.approx(-series.lost[first]) and not seen[:first].any()
    alone = slips[:-1][np.diff(slips) > 60]
    assert len(alone) >= 4 and np.abs(seen[alone + 40]).max() < 1e-7  # the servo has made up for it
    # The frames are where the rod is, not where its encoder has it.
    assert force_at(3e-4, memory=[(11, 2e-4)], lost=4e-5) == pytest.approx(force_at(5e-4))


def test_a_loaded_gear_rubs_on_the_way_in_and_out():
    plain, rubbing = (moved(pressed, 250, 0.0045, gear=gear, gear_rate=1e-3) for gear in (0.0, 0.1))
    off, force, rate = rubbing[0] - plain[0], np.abs(plain[1]), rates(plain[0])
    expected = -0.1 * force * np.sign(rate) / PLANT["omega"] ** 2
    for way in (1.0, -1.0):
        fast = (force > 30.0) & (way * rate > 1e-2)
        assert fast.sum() > 20
        assert np.median(off[fast] / expected[fast]) == pytest.approx(1.0, abs=0.2)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_cable_pulls_once_it_is_taut(side):
    plain = driven()[0]
    pull = driven(taut=side * 800.0, taut_from=1e-3)[0][FORCE] - plain[FORCE]
    assert pull == pytest.approx(-side * 800.0 * np.maximum(side * plain[ENCODER] - 1e-3, 0.0), abs=0.06)
    assert np.abs(pull).max() > 3.0


def test_an_uneven_thread_moves_the_tip():
    thread = {"thread": 2e-5, "thread_pitch": 5e-4, "thread_phase": 0.3}
    for depth in (1e-4, 3e-4, 4e-4):
        off = 2e-5 * np.sin(2.0 * np.pi * (0.005 + depth) / 5e-4 + 0.3)
        assert force_at(depth, c=0.0, **thread) == pytest.approx(-1e5 * (depth + off))
    steep = 1.0 + 2.0 * np.pi * 2e-5 / 5e-4 * np.cos(2.0 * np.pi * 0.0053 / 5e-4 + 0.3)
    moving = force_at(3e-4, 0.02, **thread) - force_at(3e-4, **thread)
    assert moving == pytest.approx(-50.0 * 0.02 * steep)


def test_a_magnet_pulls_at_the_front_frame_both_ways():
    magnet = {"magnet": 4.0, "magnet_gap": 5e-4}
    for rate in (0.02, -0.02):
        assert force_at(-5e-4, rate, **magnet) == pytest.approx(1.0)
        assert force_at(2e-4, rate, **magnet) - force_at(2e-4, rate) == pytest.approx(4.0)
    assert force_at(-6.1e-3, **magnet) == 0.0  # beyond its reach
    assert force_at(-1.02e-2, **magnet) == force_at(-1.02e-2) > 0.0  # at the rear frame


def test_a_latch_resists_up_to_its_crest_and_then_pulls_in():
    latch = {"latch": 5.0, "latch_depth": 3e-4}
    off = [force_at(depth, **latch) - force_at(depth) for depth in (2e-4, 3e-4, 4e-4, 9e-4)]
    assert off == pytest.approx([-5.0, 0.0, 5.0, 0.0], abs=1e-3)
    assert force_at(-1e-2 - 3e-4, **latch) == force_at(-1e-2 - 3e-4) > 0.0  # at the rear frame


def test_scraping_scales_the_force_of_a_contact_by_chance():
    assert force_at(4e-4, memory=[(12, 0.1)], scrape=0.05) == pytest.approx(1.1 * force_at(4e-4))
    scrape = series_of({"scrape": 0.05, "scrape_time": 3e-3}).scrape
    assert np.std(scrape) == pytest.approx(0.05, rel=0.2)
    assert np.corrcoef(scrape[1:], scrape[:-1])[0, 1] == pytest.approx(np.exp(-1.0 / 3.0), abs=0.06)
    assert not series_of({}).scrape.any()


def test_a_queue_grows_at_once_and_drains_by_and_by():
    values = {"queue": 3e-3, "queue_rate": 6.0, "queue_drain": 0.1}
    waits = series_of(values).arrival - series_of({}).arrival
    steps = np.round(np.diff(waits), 9)
    came = steps > 0.0
    assert 4 <= came.sum() <= 30 and np.all(steps[came] >= 2.9e-3) and waits.min() >= 0.0
    draining = (waits[:-1] > 1.1e-4) & ~came
    assert draining.sum() > 100 and np.all(steps[draining] == -1e-4)


def test_commands_come_later_while_the_sensor_has_news():
    log = smooth()[1]
    plain, late = driven()[0][ENCODER], driven(busy=1e-3, busy_force=10.0)[0][ENCODER]
    busy = np.abs(log[FORCE]) > 10.0
    off = late - plain
    assert not off[: int(np.argmax(busy))].any()
    long = np.convolve(busy, np.ones(40))[: len(busy)] == 40.0
    assert long.sum() > 100
    assert off[long] == pytest.approx(-1e-3 * rates(plain)[long], abs=1e-6)


def test_what_is_loose_stays_behind_until_its_gap_is_used_up():
    p, state = knobs({"loose": 0.2, "loose_gap": 1e-4, "loose_omega": 100.0}), first_satellite(0.0)
    assert pushed(1.0, loose=0.2, loose_gap=1e-4, loose_omega=100.0) == pytest.approx(1e-3 / 80.0)
    for tick in range(400):
        move_satellite(p, 100.0, tick * TICK, TICK, 5.0 if tick < 200 else 0.0, 0.0, state)
        if tick == 20:
            assert state[6] == 0.0 and state[1] > 0.0
    assert abs(state[5] - state[0]) < 1e-3 and state[6] > 0.0
    assert 80.0 * state[1] + 20.0 * state[6] == pytest.approx(1.0)


def test_a_crew_pushes_by_chance_and_lets_go_by_and_by():
    body = series_of({"crew": 2.0, "crew_time": 0.02}).body
    assert np.std(body) == pytest.approx(2.0, rel=0.25)
    assert np.corrcoef(body[10:], body[:-10])[0, 1] == pytest.approx(np.exp(-0.5), abs=0.12)
    assert not series_of({}).body.any()


@pytest.mark.parametrize(("hertz", "left"), [(40.0, 0.4), (1.0, 1.0), (200.0, 1.0)])
def test_a_notch_takes_out_its_frequency(hertz, left):
    notch = {"notch": 0.6, "notch_omega": 2.0 * np.pi * 40.0, "notch_width": 0.5}
    # Below 4 N, there is nothing but the force.
    out = answers(3.0 * np.sin(2.0 * np.pi * hertz * TICK * np.arange(2000)), **notch)
    assert np.abs(out[1000:]).max() == pytest.approx(3.0 * left, rel=0.15)
