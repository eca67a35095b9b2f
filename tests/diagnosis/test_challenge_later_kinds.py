"""What the latest kinds outside the catalogue that once were fresh do, each by itself."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from orchestrator.diagnosis.rig.challenge.rig_parameters import rig_parameters
from orchestrator.diagnosis.rig.challenge.series import HISTORY
from orchestrator.diagnosis.rig.challenge.software import (
    compensate,
    first_controller,
    first_satellite,
    move_satellite,
)
from tests.diagnosis.challenge_parts import (
    ENCODER,
    FORCE,
    REAR,
    TICK,
    driven,
    force_at,
    lags,
    moved,
    pressed,
    pushed,
    rates,
    series_of,
    smooth,
    twice,
)


def test_a_servo_kicks_once_it_has_turned():
    kick = {"kick": 5.0, "kick_time": 0.02}
    still = {"front": 1.0, "rear": -1.0, **kick}

    def to_and_fro(now):
        return 0.003 * np.sin(2.0 * np.pi * (now + 0.02) / 0.4)

    start = to_and_fro(-2.0 * 0.8 / 470.0)  # by so much it lags
    plain, kicked = (
        moved(to_and_fro, 400, start, 0.045, **{**still, "kick": size})[0] for size in (0.0, 5.0)
    )
    off, speed = kicked - plain, rates(plain)
    turns = [int(i) for i in np.flatnonzero(np.diff(np.sign(speed)))]
    assert len(turns) == 2 and np.abs(off[: turns[0]]).max() < 1e-9
    for turn in turns:
        way = np.sign(speed[turn + 30])
        reported = way * off[turn : turn + 60]
        assert reported.max() == pytest.approx(5.0 / 470.0**2, rel=0.25)
        assert int(np.argmax(reported)) < 20 and reported[-1] < 0.25 * reported.max()
    assert np.abs(lags(0.02, **kick) - lags(0.02)).max() == 0.0


def test_a_converter_tracks_steady_speeds_and_errs_with_the_acceleration():
    converter = {"resolver": 2.0 * np.pi * 40.0, "resolver_xi": 0.8}
    found, plain = driven(**converter)[0], driven()[0]
    off, position = found[ENCODER] - plain[ENCODER], plain[ENCODER]
    w, fine, at, speed, expected = converter["resolver"], 20, position[0], rates(position)[0], [0.0]
    for before, after in pairwise(position):
        for i in range(fine):
            left = before + (after - before) * i / fine - at
            at += TICK / fine * (speed + 1.6 * w * left)
            speed += TICK / fine * w * w * left
        expected.append(at - after)
    assert np.abs(off).max() > 3e-6
    assert off[100:] == pytest.approx(np.array(expected)[100:], abs=0.05 * np.abs(off).max())
    assert np.array_equal(found[FORCE], plain[FORCE])  # neither servo nor rod know of it


def test_a_clutch_gives_way_beyond_its_force_and_rubs_on_the_way_back():
    given = [(26, -1e-4)]
    assert force_at(4e-4, memory=given, clutch=1e-6, clutch_force=20.0) == pytest.approx(force_at(3e-4))
    clutch = {"clutch": 2e-6, "clutch_force": 20.0, "c": 0.0}
    position, force = moved(pressed, 250, 0.0045, **clutch)
    gone = position - 0.005 + force / 1e5  # by how much the tip is behind
    touching = force < -1.0
    push = -force[touching]
    least = 2e-6 * np.maximum(push - 20.0, 0.0)
    most = 2e-6 * np.maximum(push - 15.0, 0.0)
    gone = gone[touching]
    assert np.all(gone > least - 1e-7) and np.all(gone < most + 1e-7) and push.max() > 40.0
    deepest = int(np.argmax(push))
    assert gone[: deepest - 5] == pytest.approx(least[: deepest - 5], abs=1e-7)
    assert gone[deepest + 30 :] == pytest.approx(most[deepest + 30 :], abs=1e-7)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_rod_bows_sideways_under_load_and_gets_shorter_by_the_square(side):
    bow = {"whip": 2e-5, "whip_omega": 2.0 * np.pi * 12.0, "whip_xi": 0.05, "c": 0.0}

    def push(now):
        return side * pressed(now)

    position, force = moved(push, 400, side * 0.0045, **bow)
    w, fine, y, speed, short = bow["whip_omega"], 20, 0.0, 0.0, []
    for before, after in pairwise(force):
        short.append(2e-5 * y * y)
        for i in range(fine):
            carried = before + (after - before) * i / fine
            speed += TICK / fine * (w * w * (carried / 50.0 - y) - 0.1 * w * speed)
            y += TICK / fine * speed
    touching = np.abs(force[:-1]) > 1.0
    lost = (side * position - 0.005 - np.abs(force) / 1e5)[:-1][touching]
    assert lost == pytest.approx(np.array(short)[touching], abs=0.03 * max(short))
    assert lost.max() > 1e-5


def test_a_gain_turns_itself_down_where_it_is_loud():
    plain, bias = driven()[0][FORCE], smooth()[0].values["bias"]
    read = driven(agc=0.3, agc_time=0.05)[0][FORCE]
    level, expected = 0.0, []
    for n, force in enumerate(plain - bias):
        level += (1.0 - np.exp(-TICK / 0.05)) * (abs(force) - level) if n else 0.0
        expected.append(force / (1.0 + 0.3 * level / 100.0) + bias)
    assert read == pytest.approx(np.array(expected), abs=1e-9)
    assert np.abs(read - plain).max() > 5.0


def test_what_is_small_is_shown_as_none():
    plain = driven()[0][FORCE]
    read = driven(cut=3.0)[0][FORCE]
    small = np.abs(plain) < 3.0
    assert np.all(read[small] == 0.0) and np.array_equal(read[~small], plain[~small])
    assert 0.2 < np.mean(small) < 0.9 and np.abs(plain[small]).max() > 0.0


def test_the_drive_s_current_shifts_the_reading_whatever_its_way():
    found, plain = driven(ground=2.0)[0], driven()[0]
    off, values = found[FORCE] - plain[FORCE], smooth()[0].values
    speed = rates(plain[ENCODER])
    drawn = rates(speed) + 2.0 * values["xi"] * values["omega"] * speed
    current, expected = drawn[0], []
    for one in drawn:
        current += (1.0 - np.exp(-TICK / 2e-3)) * (one - current)
        expected.append(2.0 * abs(current) / 15.0)
    assert off.min() >= 0.0 and off.max() > 1.5 and off.min() < 0.1
    assert off[100:] == pytest.approx(np.array(expected)[100:], abs=0.1)


def test_each_contact_has_a_stiffness_of_its_own_by_chance():
    hits = series_of({"hits": 0.1}).hits
    assert np.std(hits) == pytest.approx(0.1, rel=0.2) and not series_of({}).hits.any()
    assert force_at(4e-4, memory=[(28, 0.1)], c=0.0) == pytest.approx(np.exp(0.1) * force_at(4e-4, c=0.0))
    found, series = driven(hits=0.1, c=0.0)
    bias = smooth()[0].values["bias"]
    plain = driven(c=0.0)[0][FORCE] - bias
    pressing = np.abs(plain) > 10.0
    begins = np.flatnonzero(np.diff(pressing.astype(int)) > 0) + 1
    shares = (found[FORCE] - bias)[pressing] / plain[pressing]
    contact = np.cumsum(np.isin(np.arange(len(plain)), begins))[pressing] - 1
    assert len(begins) >= 3
    for number in range(len(begins)):
        assert shares[contact == number] == pytest.approx(np.exp(series.hits[number]), rel=2e-3)


def test_a_spring_breaks_once_the_front_frame_has_borne_so_much():
    snap = {"snap": 0.2, "snap_after": 4.0, "c": 0.0}
    assert force_at(4e-4, memory=[(27, 3.9)], **snap) == force_at(4e-4, c=0.0)
    broken = [(27, 4.1)]
    assert force_at(4e-4, memory=broken, **snap) == pytest.approx(0.8 * force_at(4e-4, c=0.0))
    assert force_at(REAR - 4e-4, memory=broken, **snap) == force_at(REAR - 4e-4, c=0.0)
    plain, less = (moved(twice, 500, 0.0045, **{**snap, "snap": size})[1] for size in (0.0, 0.2))
    borne = TICK * np.cumsum(np.abs(less))
    touching = (np.abs(plain) > 1.0) & (np.abs(borne - 4.0) > 0.1)
    share = less[touching] / plain[touching]
    assert share == pytest.approx(np.where(borne[touching] > 4.0, 0.8, 1.0), abs=1e-6)
    assert 0.2 < np.mean(share < 0.9) < 0.8


def test_a_room_that_the_rod_seals_fills_with_gas_until_it_leaves():
    vent = {"vent": 4.0, "vent_time": 0.1, "c": 0.0}
    full = [(29, 0.5)]
    assert force_at(4e-4, memory=full, **vent) == pytest.approx(force_at(4e-4, c=0.0) - 2.0)
    assert force_at(-5e-5, memory=full, **vent) == pytest.approx(-2.0 * np.exp(-1.0))
    assert force_at(REAR - 4e-4, memory=full, **vent) == force_at(REAR - 4e-4, c=0.0)
    plain, more = (moved(twice, 500, 0.0045, **{**vent, "vent": size})[1] for size in (0.0, 4.0))
    for contact in (slice(0, 250), slice(250, 500)):
        touching = np.flatnonzero(plain[contact] < 0.0)
        since = TICK * (touching - touching[0])
        assert (plain - more)[contact][touching] == pytest.approx(
            4.0 * (1.0 - np.exp(-since / 0.1)), abs=0.05
        )
    assert np.abs(more[-20:]).max() < 0.01


def test_a_buffer_slips_by_a_frame_now_and_then_within_bounds():
    slip = {"frame_slip": 5e-4, "frame_slip_rate": 8.0}
    later = (series_of(slip).arrival - series_of({}).arrival) / 5e-4
    assert later == pytest.approx(np.round(later), abs=1e-9)
    assert np.abs(later).max() == pytest.approx(2.0) and not later[: HISTORY + 1].any()
    slips = np.diff(np.round(later))
    assert set(slips) == {-1.0, 0.0, 1.0} and 6 <= np.count_nonzero(slips) <= 32  # of 16
    assert np.array_equal(series_of({"frame_slip": 5e-4}).arrival, series_of({}).arrival)


def test_who_receives_goes_straight_on_until_that_strays():
    found = driven(sparse=3e-5)[0][ENCODER]
    plain, desired = driven()[0][ENCODER], smooth()[1][0]
    last, straight, before, taken, reported = desired[0], desired[1] - desired[0], desired[0], [], 0
    for one in desired[1:]:
        if abs(one - last - straight) > 3e-5:
            last, straight, reported = one, one - before, reported + 1
        else:
            last += straight
        before = one
        taken.append(last)
    off = np.array(taken) - desired[1:]
    assert np.abs(off).max() < 3.1e-5 and 20 < reported < 0.2 * len(off)
    seen = (found - plain)[1:]
    late = max(range(12), key=lambda ticks: float(seen[ticks:] @ off[: len(off) - ticks]))
    assert np.corrcoef(seen[late:], off[: len(off) - late])[0, 1] > 0.9 and 2 < late < 8
    assert np.abs(seen).max() < 4e-5


def test_what_presses_hard_is_taken_for_one_body_with_the_port():
    joined = {"joined": 0.25, "joined_force": 10.0}
    for force, share in ((9.0, 1.0), (-9.0, 1.0), (11.0, 0.8), (-30.0, 0.8)):
        assert pushed(force, **joined) == pytest.approx(share * pushed(force))


def test_a_navigation_filter_sets_the_speed_to_coarse_steps_time_and_again():
    p, state = rig_parameters({"fix": 1e-3, "fix_period": 0.0505}), first_satellite(0.0)
    for tick in range(400):
        before = state[1]
        move_satellite(p, 100.0, tick * TICK, TICK, 2.0, 0.0, state)
        free = before + 2e-5
        fixed = np.floor((tick + 1) * TICK / 0.0505) > np.floor(tick * TICK / 0.0505)
        assert state[1] == pytest.approx(1e-3 * round(free / 1e-3) if fixed else free, abs=1e-12)
    # Each tick makes 0.02 mm/s; what was set is not taken back.
    assert state[1] != pytest.approx(400 * 2e-5, abs=1e-6)


def test_a_controller_sums_up_the_force_of_each_contact():
    p, plain = rig_parameters({"summed": 0.5}), rig_parameters({})
    summing, without = (first_controller(1e5, 50.0, 0.0, 0.0) for _ in range(2))
    more = []
    for force in [20.0] * 100 + [2.0] * 10 + [-30.0] * 50:
        for one, state in ((p, summing), (plain, without)):
            compensate(one, 1e5, 1.8e-3, TICK, force, 0.0, 0.0, 0.0, state)
        more.append(summing[11] - without[11])
    assert more[:100] == pytest.approx(0.5 * 20.0 * TICK * np.arange(1, 101))
    assert more[100:110] == pytest.approx([0.0] * 10)
    assert more[110:] == pytest.approx(-0.5 * 30.0 * TICK * np.arange(1, 51))


def test_a_controller_believes_in_part_what_it_expects():
    p, plain = rig_parameters({"blend": 0.4}), rig_parameters({})
    half, without = (first_controller(1e5, 50.0, 0.0, 0.0) for _ in range(2))
    for tick in range(60):
        # A rod that goes 1 mm in; the sensor reads a tenth less than the spring gives.
        position = 1e-3 * np.sin(np.pi * tick / 120.0)
        force = -0.9e5 * position
        for one, state in ((p, half), (plain, without)):
            compensate(one, 1e5, 1.8e-3, TICK, force, position, position, 0.0, state)
        expected = -without[6] * (position - without[5]) - without[7] * without[3]
        if abs(force) > 4.0:
            ahead = force + 1.8e-3 * without[1]
            assert half[11] - without[11] == pytest.approx(0.4 * (expected - ahead), abs=1e-9)
        else:
            assert half[11] == without[11] == force
    assert np.array_equal(np.delete(half, 11), np.delete(without, 11))
