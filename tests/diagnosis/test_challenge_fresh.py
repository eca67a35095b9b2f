"""What each of the fresh kinds outside the catalogue does, by itself."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from orchestrator.diagnosis.rig.challenge.hidden import HIDDEN
from orchestrator.diagnosis.rig.challenge.outside_fresh import FRESH
from orchestrator.diagnosis.rig.challenge.rig_parameters import rig_parameters
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
    answers,
    driven,
    force_at,
    lags,
    moved,
    rates,
    series_of,
    smooth,
    twice,
)

FAR = {"front": 1.0, "rear": -1.0}


def deep(now):
    """A command that goes 1 mm into the front frame, 1 mm into the rear one, and again."""
    return 0.006 * np.sin(2.0 * np.pi * now / 0.5)


def turned(position, length):
    """Which way a friction that bends over some length points along a way, from -1 to 1."""
    way, found = 0.0, [0.0]
    for step in np.diff(position):
        end = np.sign(step)
        way = end + (way - end) * np.exp(-abs(step) / length)
        found.append(way)
    return np.array(found)


@pytest.mark.parametrize("speed", [0.02, -0.01])
def test_a_servo_that_knows_its_command_s_rate_lags_by_so_much_less(speed):
    plain, ahead = lags(speed, **FAR), lags(speed, **FAR, forward=0.3)
    assert plain[-1] == pytest.approx(2.0 * 0.8 / 470.0 * speed, rel=1e-3)
    assert ahead[-1] == pytest.approx(0.7 * plain[-1], rel=0.01)
    still = moved(lambda now: 1e-3, 300, **FAR, forward=0.3)[0]
    assert still[-1] == pytest.approx(1e-3, abs=1e-9)


def test_a_drive_gives_nothing_where_little_is_asked_for():
    for step in (2e-6, 2e-5, 1e-3):
        found = moved(lambda now, to=step: to, 60, **FAR, idle=2.0)[0]
        fine, at, speed, expected = 1000, 0.0, 0.0, []
        for _ in range(60):
            expected.append(at)
            for _ in range(fine):
                asked = 470.0**2 * (step - at) - 2.0 * 0.8 * 470.0 * speed
                speed += TICK / fine * (asked - 2.0 * np.tanh(asked / 2.0))
                at += TICK / fine * speed
        assert found == pytest.approx(np.array(expected), abs=2e-3 * step)
        plain = moved(lambda now, to=step: to, 60, **FAR)[0]
        # Hundreds of m/s2 are hardly less for what is lost of them.
        assert found[10] < 0.25 * plain[10] if step == 2e-6 else found[10] > 0.98 * plain[10]


def test_an_axis_across_jumps_from_one_side_to_the_other_and_stays():
    found, series = driven(hunt=2e-5, hunt_omega=2.0 * np.pi * 3.0, c=0.0)
    plain, k = driven(c=0.0)[0][FORCE], smooth()[0].values["k"]
    off = found[FORCE] - plain
    swing = np.sin(2.0 * np.pi * 3.0 * TICK * np.arange(len(plain)) + series.floor)
    settled = (np.abs(plain) > 12.0) & (np.abs(swing) > 0.4)
    assert off[settled] == pytest.approx(-2e-5 * k * np.sign(swing[settled]), abs=0.02 * 2e-5 * k)
    assert {-1.0, 1.0} == set(np.sign(swing[settled])) and settled.sum() > 300
    assert np.abs(found[ENCODER] - driven(c=0.0)[0][ENCODER]).max() < 2e-8  # but for what the load moves


def test_a_slide_turns_in_its_guide_the_way_that_it_is_dragged():
    yaw = {"yaw": 3e-5, "yaw_length": 2e-4, "c": 0.0}
    given = [(36, 1.0)]
    assert force_at(4e-4, memory=given, **yaw) == pytest.approx(force_at(3.7e-4, c=0.0))
    assert force_at(REAR - 4e-4, memory=given, **yaw) == pytest.approx(force_at(REAR - 4.3e-4, c=0.0))
    position, force = moved(deep, 1000, speed=0.006 * 4.0 * np.pi, **yaw)
    tip = np.where(force < 0.0, 0.005, -0.005) - force / 1e5
    touching = np.abs(force) > 1.0
    ahead = (tip - position)[touching]
    assert ahead == pytest.approx(-3e-5 * turned(position, 2e-4)[touching], abs=5e-7)
    assert ahead.max() > 2.9e-5 and ahead.min() < -2.9e-5


def test_a_converter_keeps_some_of_the_channel_before():
    found, plain = driven(ghost=300.0)[0], driven()[0]
    assert (found - plain)[FORCE] == pytest.approx(300.0 * plain[ENCODER], abs=1e-9)
    assert np.array_equal(found[ENCODER], plain[ENCODER])


def test_samples_get_older_until_their_buffer_is_emptied():
    age = series_of({"buffer": 2e-3, "buffer_period": 0.25}).sampling
    assert 0.0 <= age.min() < 1e-5 and 1.99e-3 < age.max() < 2e-3
    steps = np.diff(age)
    assert np.count_nonzero(steps < 0.0) in (7, 8)
    assert steps[steps > 0.0] == pytest.approx(np.full((steps > 0.0).sum(), 2e-3 * TICK / 0.25))
    assert not series_of({}).sampling.any()
    found, series = driven(buffer=2e-3, buffer_period=0.25)
    plain = driven()[0][FORCE]
    ticks = np.arange(len(plain))
    late = np.interp(ticks - series.sampling / TICK, ticks, plain)
    assert found[FORCE][5:] == pytest.approx(late[5:], abs=0.5)
    assert np.abs(found[FORCE] - plain).max() > 3.0


def test_a_drive_is_the_louder_the_faster_it_goes():
    found, series = driven(buzz=2.0)
    plain = driven()[0]
    assert np.std(series.buzz) == pytest.approx(2.0, rel=0.05)
    speed = np.abs(rates(plain[ENCODER]))
    off = (found - plain)[FORCE]
    assert off[5:-5] == pytest.approx((series.buzz * speed / 0.02)[5:-5], abs=0.2)
    assert np.std(off[speed > 0.015]) > 5.0 * np.std(off[speed < 0.003]) > 0.0


def test_clay_on_the_port_is_beaten_flat():
    clay = {"clay": 5e-5, "clay_impulse": 5.0, "c": 0.0}
    assert force_at(3e-4, **clay) == pytest.approx(force_at(3.5e-4, c=0.0))
    flat = [(37, 5.0)]
    less = force_at(3e-4, memory=flat, **clay)
    assert less == pytest.approx(force_at(3e-4 + 5e-5 / np.e, c=0.0))
    assert force_at(REAR - 4e-4, memory=flat, **clay) == force_at(REAR - 4e-4, c=0.0)
    position, force = moved(twice, 500, 0.0045, **clay)
    thick = -force / 1e5 - (position - 0.005)
    touching = force < -1.0
    expected = 5e-5 * np.exp(-TICK * np.cumsum(-force) / 5.0)
    assert thick[touching] == pytest.approx(expected[touching], abs=1e-6)
    assert thick[touching].max() > 4.9e-5 and thick[touching].min() < 1.5e-5


def test_ropes_rub_over_some_way_and_are_straight_again_between_contacts():
    rope = {"rope": 4.0, "rope_length": 1e-4, "c": 0.0}
    bent = [(38, 0.5)]
    assert force_at(4e-4, memory=bent, **rope) == pytest.approx(force_at(4e-4, c=0.0) - 2.0)
    rear = force_at(REAR - 4e-4, memory=bent, **rope)
    assert rear == pytest.approx(force_at(REAR - 4e-4, c=0.0) + 2.0)
    assert force_at(-1e-5, memory=bent, **rope) == 0.0
    position, plain = moved(twice, 500, 0.0045, c=0.0)
    more = plain - moved(twice, 500, 0.0045, **rope)[1]
    for contact in (slice(0, 250), slice(250, 500)):
        pressing = np.flatnonzero(plain[contact] < 0.0)
        # The spring alone does not hold what pulls back harder than it pushes.
        held = pressing[plain[contact][pressing] < -5.0]
        way = turned(np.concatenate([[0.005], position[contact][pressing]]), 1e-4)[1:]
        assert more[contact][held] == pytest.approx(4.0 * way[np.isin(pressing, held)], abs=0.02)
        assert more[contact][held].max() > 3.9 and more[contact][held].min() < -3.9


def test_a_cup_sucks_on_the_way_out_until_its_lip_lets_go():
    cup = {"cup": 5.0, "cup_reach": 1e-4, "c": 0.0}
    empty = [(39, 4e-4)]
    pulled = force_at(3e-4, memory=empty, **cup)
    assert pulled == pytest.approx(force_at(3e-4, c=0.0) + 5.0 * (1.0 - np.exp(-1.0)))
    for depth in (4e-4, 5e-4):
        assert force_at(depth, memory=empty, **cup) == pytest.approx(force_at(depth, c=0.0))
    lip = force_at(-5e-5, memory=empty, **cup)
    assert lip == pytest.approx(5.0 * (1.0 - np.exp(-4.5)) * np.exp(-1.0))
    assert force_at(-5e-5, **cup) == 0.0
    assert force_at(REAR - 4e-4, memory=empty, **cup) == force_at(REAR - 4e-4, c=0.0)
    position, plain = moved(twice, 500, 0.0045, c=0.0)
    more = moved(twice, 500, 0.0045, **cup)[1] - plain
    for contact in (slice(0, 250), slice(250, 500)):
        depth = position[contact] - 0.005
        deepest = int(np.argmax(depth))
        assert np.abs(more[contact][: deepest - 1]).max() < 1e-9
        out = np.flatnonzero((depth > 0.0) & (np.arange(250) > deepest))
        expected = 5.0 * (1.0 - np.exp(-(depth[deepest] - depth[out]) / 1e-4))
        assert more[contact][out] == pytest.approx(expected, abs=0.05)
        assert np.abs(more[contact][depth < -4.5e-4]).max() == 0.0


def test_a_filter_tracks_steady_commands_and_errs_where_they_speed_up():
    found, plain = driven(tracker=0.8)[0][ENCODER], driven()[0][ENCODER]
    desired = smooth()[1][0]
    at, rate, taken = desired[0], desired[1] - desired[0], []
    for one in desired[1:]:
        ahead = at + rate
        at, rate = ahead + 0.36 * (one - ahead), rate + 0.04 * (one - ahead)
        taken.append(at)
    off, seen = np.array(taken) - desired[1:], (found - plain)[1:]
    speed = np.diff(desired)
    steady = np.array([np.ptp(speed[max(i - 60, 0) : i + 1]) < 2e-8 for i in range(len(off))])
    assert steady.sum() > 200 and np.abs(off[steady]).max() < 5e-7
    assert np.abs(seen).max() > 4e-6
    late = max(range(12), key=lambda ticks: float(seen[ticks:] @ off[: len(off) - ticks]))
    assert np.corrcoef(seen[late:], off[: len(off) - late])[0, 1] > 0.98 and 2 < late < 8


def test_the_delay_wanders_slowly_and_is_never_less_than_it_was():
    plain = series_of({}).arrival
    late = series_of({"wander": 1e-3, "wander_time": 0.05}).arrival - plain
    assert late.min() >= 0.0
    assert np.mean(late) == pytest.approx(1e-3 * np.sqrt(2.0 / np.pi), rel=0.35)
    assert 0.9 < np.corrcoef(late[1:], late[:-1])[0, 1] < 0.999
    lost = series_of({"wander": 1e-3, "wander_time": 0.05, "loss": 0.1}).arrival
    assert np.isinf(lost).any() and not np.isnan(lost).any()


def test_what_a_force_is_on_average_is_taken_for_its_zero():
    p, state, speeds = rig_parameters({"rezero": 0.5}), first_satellite(0.0), [0.0]
    for tick in range(1500):
        move_satellite(p, 100.0, tick * TICK, TICK, 10.0 if tick < 1000 else 0.0, 0.0, state)
        speeds.append(state[1])
    felt = np.diff(speeds) * 100.0 / TICK
    left = (1.0 - 0.5 * TICK) ** np.arange(1, 1501)
    assert felt[:1000] == pytest.approx(10.0 * left[:1000])
    assert felt[1000:] == pytest.approx(-10.0 * (1.0 - left[999]) * left[:500])


def test_a_satellite_is_led_back_to_where_the_rod_is():
    p = rig_parameters({"corrected": 50.0})
    for mass, there in ((100.0, 1e-4), (500.0, -2e-4)):
        state = first_satellite(0.0)
        state[11] = there
        move_satellite(p, mass, 0.0, TICK, 0.0, 0.0, state)
        assert state[1] == pytest.approx(50.0 * there * TICK)
    found, plain, log = driven(corrected=50.0)[0], driven()[0], smooth()[1]
    assert (found - plain)[1] == pytest.approx(50.0 * TICK * (log[2] - log[0]), abs=1e-12)


def test_a_dull_derivative_follows_the_force_s_slope_more_slowly():
    forces = [0.5 * tick for tick in range(25)] + [12.0] * 15
    p, dull, plain = rig_parameters({"dull": 0.4}), first_controller(1e5, 50.0, 0.0, 0.0), answers(forces)
    slope, found, expected = 0.0, [], []
    for before, force in pairwise([0.0, *forces]):
        compensate(p, 1e5, 1.8e-3, TICK, force, 0.0, 0.0, 0.0, dull)
        slope += 0.21 * ((force - before) / TICK - slope)
        found.append(dull[11])
        expected.append(slope)
        assert dull[1] == pytest.approx(slope)
    touching = np.array(forces) > 4.0
    led, less = np.array(found) - forces, 1.8e-3 * np.array(expected)
    assert led[touching] == pytest.approx(less[touching])
    assert led[20] < plain[20] - forces[20] and led[32] > plain[32] - forces[32] > 0.0


def test_a_contact_counts_for_some_ticks_after_its_force():
    forces = [0.0] * 2 + [10.0] * 3 + [0.0] * 4 + [10.0] * 2 + [0.0] * 10
    desired = -1e-4
    plain, late, longer = (answers(forces, desired, release=ticks) for ticks in (0.0, 3.0, 6.0))
    compensated = [(np.abs(one - forces) > 1e-9).tolist() for one in (plain, late, longer)]
    assert compensated[0] == [False] * 2 + [True] * 3 + [False] * 4 + [True] * 2 + [False] * 10
    assert compensated[1] == [False] * 2 + [True] * 6 + [False] + [True] * 5 + [False] * 7
    assert compensated[2] == [False] * 2 + [True] * 15 + [False] * 4
    assert late[2:5] == pytest.approx(plain[2:5]) and late[20] == plain[20] == 0.0


@pytest.mark.parametrize("effect", FRESH.values(), ids=lambda one: one.id)
def test_what_is_not_there_changes_nothing(effect):
    assert effect.id not in HIDDEN
    drawn = effect.draw(np.random.default_rng(3), 0.0)
    assert np.array_equal(driven(**drawn)[0], driven()[0])
    hardly = effect.draw(np.random.default_rng(3), 1e-9)
    assert driven(**hardly)[0] == pytest.approx(driven()[0], rel=1e-6, abs=1e-6)
