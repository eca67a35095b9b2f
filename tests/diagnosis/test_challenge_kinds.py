"""What kinds outside the catalogue that once were fresh do, each by itself."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.diagnosis.rig.challenge.draw import RUNS, Plan, draw_case, make_run, run_series
from orchestrator.diagnosis.rig.challenge.rig import COLUMNS, drive
from orchestrator.diagnosis.rig.challenge.rig_parameters import rig_parameters
from orchestrator.diagnosis.rig.challenge.series import HISTORY, draw_series
from orchestrator.diagnosis.rig.challenge.software import (
    compensate,
    first_controller,
    first_satellite,
    move_satellite,
)
from tests.diagnosis.challenge_parts import (
    ENCODER,
    FORCE,
    PLANT,
    TICK,
    TICKS,
    answers,
    driven,
    force_at,
    lags,
    moved,
    pressed,
    pushed,
    rates,
    series_of,
    smooth,
)


def test_a_falsified_command_is_off_by_so_much_now_and_then():
    stray = series_of({"corrupt": 1e-4, "corrupt_rate": 30.0}).corruption
    assert set(stray) == {-1e-4, 0.0, 1e-4} and 40 < np.count_nonzero(stray) < 80
    assert not series_of({}).corruption.any()


@pytest.mark.parametrize("route", [6e-4, -6e-4])
def test_a_route_is_longer_until_or_from_one_instant_on(route):
    longer = series_of({"route": route}).arrival - series_of({}).arrival
    assert set(np.round(longer, 9)) == {0.0, 6e-4}
    assert np.count_nonzero(np.diff(longer > 3e-4)) == 1
    changed = int(np.argmax(np.diff(longer > 3e-4)))
    assert HISTORY + 0.2 * TICKS <= changed + 1 <= HISTORY + 0.8 * TICKS + 1
    assert (longer[-1] > 0.0) == (route > 0.0)


def test_supply_and_floor_swing_in_another_phase_in_each_run():
    values = {"ripple": 0.1, "ripple_omega": 50.0}
    first = series_of(values)
    other = draw_series(values, (0.0, 0.0), TICKS, np.random.SeedSequence(2))
    assert np.abs(first.supply).max() == pytest.approx(0.1, rel=1e-3)
    assert np.abs(first.supply - other.supply).max() > 0.01 and first.floor != other.floor
    assert not series_of({}).supply.any()


def test_a_coarse_timer_counts_whole_steps_and_loses_none():
    step = 3.1e-4
    counted = np.array([pushed(100.0, tick, timer=step) for tick in range(1000)]) / step
    assert np.allclose(counted, np.round(counted)) and set(np.round(counted)) == {3.0, 4.0}
    assert counted.sum() * step == pytest.approx(1.0, abs=step)


def test_weak_forces_are_ignored_and_strong_ones_less_felt():
    assert pushed(1.9, ignored=2.0) == pushed(-1.9, ignored=2.0) == 0.0
    assert pushed(-5.0, ignored=2.0) == pytest.approx(pushed(-3.0))


def test_a_plume_pushes_off_the_port_and_fades_with_the_distance():
    p, pushes = rig_parameters({"plume": 6.0, "plume_reach": 2e-3}), []
    for position in (0.006, 0.005, 0.003, -0.005):
        state = first_satellite(0.0)
        state[0] = position
        move_satellite(p, 100.0, 0.0, TICK, 0.0, 0.0, state)
        pushes.append(-100.0 * state[1] / TICK)
    assert pushes == pytest.approx([6.0, 6.0, 6.0 / np.e, 6.0 * np.exp(-5.0)], rel=1e-3)


def test_compensation_is_faded_in_at_each_contact():
    forces = np.array([0.0, *[20.0] * 30, 0.0, *[20.0] * 30])
    plain, faded = (answers(forces, desired=1e-4, ramp=ramp) for ramp in (0.0, 5e-3))
    share = np.where(forces == 0.0, 0.0, 1.0 - np.exp(-np.array([0, *range(1, 31), 0, *range(1, 31)]) / 5.0))
    assert faded == pytest.approx(forces + share * (plain - forces))
    assert np.abs(plain - forces).max() > 1.0


def test_a_jump_counts_by_a_share_once():
    # Below 4 N, there is nothing but the force.
    assert answers([0.0, 3.0, 3.0, 3.5, -3.0], gate=0.8, gate_step=2.0) == pytest.approx(
        [0.0, 0.6, 3.0, 3.5, 2.2]
    )
    assert answers([0.0, 1.9, 3.5], gate=0.8, gate_step=2.0) == pytest.approx([0.0, 1.9, 3.5])


def test_a_damper_resists_on_the_way_in_alone():
    into, out = force_at(2e-4, 0.02, valve=2e4), force_at(2e-4, -0.02, valve=2e4)
    assert into - force_at(2e-4, 0.02) == pytest.approx(-8.0)
    assert out == force_at(2e-4, -0.02)


def test_a_floor_that_vibrates_moves_the_frames():
    omega = 2.0 * np.pi * 10.0
    floor = {"floor": 2e-5, "floor_omega": omega}
    still = force_at(5e-4, c=0.0)
    assert force_at(5e-4, t=0.025, c=0.0, **floor) - still == pytest.approx(-2.0)
    assert force_at(5e-4, t=0.075, c=0.0, **floor) - still == pytest.approx(2.0)
    assert force_at(5e-4, memory=[(10, 0.5 * np.pi)], c=0.0, **floor) - still == pytest.approx(-2.0)


def test_a_tip_slides_into_its_seat_in_each_contact():
    def twice(now):
        return pressed(now % 0.25)

    plain, slid = (moved(twice, 500, 0.0045, seat=seat, seat_force=30.0) for seat in (0.0, 5e-5))
    assert np.allclose(plain[0], slid[0])  # the servo does not feel it
    lost = slid[1] - plain[1]
    for contact in (slice(0, 250), slice(250, 500)):
        force, less = plain[1][contact], lost[contact]
        assert np.abs(less[: int(np.argmax(force < -30.0))]).max() < 1e-6
        assert less[int(np.argmin(force))] == pytest.approx(5.0, rel=1e-3)


def test_a_bolted_joint_gives_way_less_on_the_way_back():
    plain, loose = (moved(pressed, 250, 0.0045, joint=joint, joint_force=10.0) for joint in (0.0, 1e-6))
    force = -loose[1]
    given = (-plain[1] - force) / 1e5  # how far [m]
    deepest = int(np.argmax(force))
    same = 0.6 * force.max()
    way_in = int(np.argmax(force > same))
    way_out = deepest + int(np.argmax(force[deepest:] < same))
    assert given[deepest] == pytest.approx(1e-6 * (force.max() - 10.0), rel=0.02)
    assert given[way_out] - given[way_in] == pytest.approx(2e-5, rel=0.25)


def test_a_soft_gain_lags_where_it_is_slow():
    soft = {"soft_gain": 0.4, "soft_gain_rate": 5e-3}
    assert lags(2e-3, **soft)[-1] == pytest.approx(lags(2e-3)[-1] / 0.6, rel=0.01)
    assert lags(8e-3, **soft)[-1] == pytest.approx(lags(8e-3)[-1], rel=1e-6)


def test_a_cold_robot_lags_until_it_is_warm():
    more = lags(5e-3, cold=0.5, cold_time=0.2)[1:] / lags(5e-3)[1:]
    assert more[100] == pytest.approx(1.0 + 0.5 * np.exp(-0.5), rel=0.02)
    assert more[-1] == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize(
    ("knob", "extra"),
    [
        (
            {"pickup": 2.0, "pickup_pitch": 3e-3, "pickup_phase": 0.4},
            lambda x, v: 2.0 * np.sin(2.0 * np.pi * x / 3e-3 + 0.4),
        ),
        ({"bushing": 1.5, "bushing_rate": 2e-3}, lambda x, v: -1.5 * np.tanh(v / 2e-3)),
    ],
    ids=["motor", "bushing"],
)
def test_what_the_sensor_reads_of_motor_and_guide(knob, extra):
    case = draw_case(Plan("none", (), 0.0), 78, 1, roughness=0.0)
    log, plan = make_run(case, 0), RUNS[0]
    series = run_series(case, 0, case.values)
    plain, read = (
        drive(case.lab, {**case.values, **more}, plan.mass, plan.speed, log, series) for more in ({}, knob)
    )
    position = plain[COLUMNS.index("encoder_position")] - series.encoder
    rate = np.gradient(position, TICK)
    row = COLUMNS.index("sensor_force")
    assert read[row] - plain[row] == pytest.approx(extra(position, rate), abs=0.05)


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
    p, state = rig_parameters({"loose": 0.2, "loose_gap": 1e-4, "loose_omega": 100.0}), first_satellite(0.0)
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


def test_a_shaper_holds_a_share_of_each_command_back():
    plain, echoed = driven()[0][ENCODER], driven(shaper=0.3, shaper_time=0.02)[0][ENCODER]
    expected = 0.7 * plain[120:] + 0.3 * plain[100:-20]
    assert echoed[120:] == pytest.approx(expected, abs=2e-6)
    between = driven(shaper=0.3, shaper_time=0.0205)[0][ENCODER]
    assert between[120:] == pytest.approx(expected + 0.15 * (plain[99:-21] - plain[100:-20]), abs=2e-6)


def test_a_guard_yields_once_in_each_contact_for_its_time():
    def held(now):
        return 0.0045 + 0.02 * min(now % 0.25, 0.05) * (now % 0.25 < 0.2)

    guard = {"guard": 0.5, "guard_force": 20.0, "guard_time": 0.03}
    plain, yielding = moved(held, 500, 0.0045), moved(held, 500, 0.0045, **guard)
    for contact in (slice(0, 200), slice(250, 450)):
        off = np.abs(yielding[0] - plain[0])[contact]
        hit = int(np.argmax(np.abs(plain[1][contact]) > 20.0))
        assert off[:hit].max() < 1e-8
        assert off[hit : hit + 30].max() > 1e-5
        assert off[hit + 80 :].max() < 1e-7


def test_what_grows_moves_the_tip_by_and_by():
    growth = {"growth": 2e-4, "growth_time": 1.0, "c": 0.0}
    for t in (0.0, 1.0, 3.0):
        assert force_at(3e-4, t=t, **growth) == pytest.approx(-1e5 * (3e-4 + 2e-4 * (1.0 - np.exp(-t))))
    assert force_at(3e-4, t=0.0, **{**growth, "c": 50.0}) == pytest.approx(-30.0 - 50.0 * 2e-4)


def test_a_hose_swings_on_the_rod():
    hose = {"hose": 2.0, "hose_omega": 2.0 * np.pi * 3.0, "hose_xi": 0.1}
    found = driven()[0]
    pull = driven(**hose)[0][FORCE] - found[FORCE]
    # The hose from the rod's own motion, in ticks.
    w, position, rate = hose["hose_omega"], found[ENCODER], rates(found[ENCODER])
    at, speed, expected = position[0], rate[0], []
    for x, v in zip(position, rate, strict=True):
        swing = w * w * (at - x) + 0.2 * w * (speed - v)
        speed -= TICK * swing
        at += TICK * speed
        expected.append(2.0 * swing)
    assert np.abs(pull).max() > 1.0
    assert pull == pytest.approx(np.array(expected), abs=0.15)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_the_upper_range_has_a_gain_of_its_own_until_well_below(way):
    plain, bias = driven()[0][FORCE], smooth()[0].values["bias"]
    force = np.abs(plain - bias)
    gain = driven(range_gain=way * 0.1, range_force=30.0)[0][FORCE] - plain
    upper = way * 0.1 * (plain - bias)
    assert gain[force > 30.0] == pytest.approx(upper[force > 30.0])
    assert np.all(gain[force < 0.6 * 30.0] == 0.0)
    between = (force > 18.5) & (force < 29.5)
    fast = np.diff(force, prepend=0.0)
    assert np.all(gain[between & (fast > 1.0)] == 0.0)
    assert np.any(np.isclose(gain, upper)[between & (fast < -1.0)])


def test_a_heavy_bit_adds_where_it_is_set():
    plain = driven()[0][FORCE]
    read = driven(bit=2.0, bit_weight=12.8, bit_at=5.0)[0][FORCE]
    is_set = np.floor((plain + 5.0) / 12.8) % 2.0 == 1.0
    assert read - plain == pytest.approx(2.0 * is_set)
    assert 0.02 < np.mean(is_set) < 0.5 and not is_set[np.abs(plain) < 5.0].any()


def test_a_loose_wire_shifts_the_reading_now_and_then_for_a_while():
    series = series_of({"wire": -3.0, "wire_rate": 8.0, "wire_time": 0.01})
    force = series.force - series_of({}).force
    assert set(force) == {-3.0, 0.0}
    begins = np.count_nonzero(np.diff(force) < 0.0)
    assert 6 <= begins <= 30
    assert np.count_nonzero(force) / begins == pytest.approx(11.0, rel=0.5)


def test_a_contact_chatters_from_its_begin():
    chatter = {"chatter": 0.05, "chatter_omega": 2.0 * np.pi * 50.0}
    still = force_at(4e-4)
    for t, memory, turned in ((0.005, 0.0, 1.0), (0.015, 0.0, -1.0), (0.015, 0.01, 1.0)):
        found = force_at(4e-4, t=t, memory=[(16, memory)], **chatter)
        assert found == pytest.approx((1.0 + 0.05 * turned) * still)
    plain, loud = (moved(pressed, 250, 0.0045, chatter=size, chatter_omega=300.0)[1] for size in (0.0, 0.05))
    begin = int(np.argmax(plain < 0.0))
    share = loud[begin + 3 : begin + 60] / plain[begin + 3 : begin + 60] - 1.0
    turned = 300.0 * TICK * np.arange(3, 60)
    best = max(np.corrcoef(share, np.sin(turned + 300.0 * late))[0, 1] for late in (0.0, 5e-4, 1e-3))
    assert best > 0.99 and np.abs(share).max() == pytest.approx(0.05, rel=0.05)


def test_a_pad_stays_dented_at_its_own_frame():
    assert force_at(4e-4, memory=[(17, 1e-4)]) == pytest.approx(force_at(3e-4))
    assert force_at(4e-4, memory=[(18, 1e-4)]) == force_at(4e-4)
    assert force_at(-1e-2 - 4e-4, memory=[(18, 1e-4)]) == pytest.approx(force_at(-1e-2 - 3e-4))

    def twice(now):
        return pressed(now % 0.25)

    plain, kept = moved(twice, 500, 0.0045)[1], []
    deepest = [int(np.argmin(plain[:250])), 250 + int(np.argmin(plain[250:]))]
    for rest in (0.3, 30.0):
        # It is dented as fast, and rises again within some tenths of a second, or hardly.
        lost = (moved(twice, 500, 0.0045, pad=rest / 0.6, pad_time=rest)[1] - plain)[deepest]
        assert lost[0] > 1.0
        kept.append(lost[1] / lost[0])
    assert 1.1 < kept[0] < kept[1] - 0.3


def test_a_brush_resists_before_the_frame_and_less_on_the_way_out():
    brush = {"brush": 2.0, "brush_reach": 1e-3}
    into = [-force_at(depth, 0.02, **brush) for depth in (-1.1e-3, -9e-4, -7e-4, -1e-4)]
    bent = 1.0 - np.exp(-np.array([0.0, 1e-4, 3e-4, 9e-4]) / 3e-4)
    assert into == pytest.approx(2.0 * bent)
    assert -force_at(-1e-4, -0.02, **brush) == pytest.approx(0.4 * bent[-1])
    rear = -1e-2
    assert force_at(rear + 1e-4, -0.02, **brush) == pytest.approx(into[-1])
    assert force_at(5e-4, 0.02, **brush) - force_at(5e-4, 0.02) == pytest.approx(-2.0, abs=0.02)


def test_a_command_takes_longer_the_more_characters_it_has():
    log = smooth()[1]
    plain, late = driven()[0][ENCODER], driven(text=4e-4)[0][ENCODER]
    counts = np.array([len(f"{int(one * 1e6)}") for one in log[0]])
    counts += (log[0] < 0.0) & (log[0] > -1e-6)
    assert set(counts) >= {3, 4, 5}
    long = np.array([len(set(counts[max(i - 40, 0) : i + 2])) == 1 for i in range(len(counts))])
    long[:100] = False
    off = (late - plain)[long]
    assert long.sum() > 300 and off == pytest.approx(-4e-4 * (counts * rates(plain))[long], abs=2e-6)


def test_a_lost_increment_is_missing_until_the_next_whole_command():
    values = {"increments": 0.01, "increments_key": 0.1}
    found, series = driven(**values)
    assert 10 <= series.skipped.sum() <= 60 and 29 <= series.key.sum() <= 31
    assert not series_of({}).skipped.any()
    desired, missing, left = smooth()[1][0], 0.0, np.zeros(len(series.key))
    for n in range(len(left) - 1):
        missing = 0.0 if series.key[n] else missing + series.skipped[n] * (desired[n + 1] - desired[n])
        left[n] = missing
    off = (found - driven()[0])[ENCODER]
    steady = np.array([np.ptp(left[max(i - 45, 0) : i + 1]) == 0.0 for i in range(len(left))])
    steady[:70] = False
    assert (left[steady] != 0.0).sum() > 100
    assert off[steady] == pytest.approx(-left[steady], abs=1e-6)


def test_a_body_that_spins_gives_way_as_its_lever_turns():
    spin = {"spin": 0.1, "spin_omega": np.pi, "spin_phase": 0.3}
    for tick in (0, 400, 1300):
        lever = np.sin(np.pi * tick * TICK + 0.3) ** 2
        assert pushed(20.0, tick, **spin) == pytest.approx(2e-4 * (1.0 + 0.1 * lever))


def test_a_valve_sticks_from_one_instant_until_its_tank_is_empty():
    stuck = {"stuck": 2.0, "stuck_from": 0.5, "stuck_time": 0.2}
    speeds = [pushed(0.0, tick, **stuck) for tick in (499, 501, 700)]
    assert speeds == pytest.approx(2e-5 * np.array([0.0, np.exp(-0.005), np.exp(-1.0)]), rel=1e-3)
    p, state = rig_parameters(stuck), first_satellite(0.0)
    for tick in range(3000):
        move_satellite(p, 100.0, tick * TICK, TICK, 0.0, 0.0, state)
    assert state[1] == pytest.approx(2.0 * 0.2 / 100.0, rel=0.01)


def test_an_output_is_late_now_and_then_where_stiffness_is_estimated():
    forces = [1.0, 2.0, 20.0, 22.0, 25.0, 29.0, 34.0, 40.0, 47.0, 3.0, 1.0]
    plain, late = answers(forces), answers(forces, overrun=0.5)
    expected = plain.copy()
    expected[[3, 5, 7]] = late[[2, 4, 6]]
    assert late == pytest.approx(expected) and np.abs(late - plain).max() > 1.0


def test_a_payload_that_is_not_there_is_taken_for_one():
    p, plain = rig_parameters({"payload": 1.5}), rig_parameters({})
    with_it, without = (first_controller(1e5, 50.0, 0.0, 0.0) for _ in range(2))
    for tick in range(1, 60):
        # Half a metre per second squared; below 4 N, there is nothing but the force.
        for one, state in ((p, with_it), (plain, without)):
            compensate(one, 1e5, 1.8e-3, TICK, 2.0, 0.25 * (tick * TICK) ** 2, 0.0, 0.0, state)
    assert without[11] == pytest.approx(2.0) and with_it[11] == pytest.approx(2.75)
