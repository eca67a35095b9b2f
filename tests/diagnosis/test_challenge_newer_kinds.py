"""What the newest kinds outside the catalogue that once were fresh do, each by itself."""

from __future__ import annotations

import numpy as np
import pytest

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
    pushed,
    series_of,
    smooth,
    twice,
)

FAR = {"front": 1.0, "rear": -1.0}


def deep(now):
    """A command that goes 1 mm into the front frame, 1 mm into the rear one, and again."""
    return 0.006 * np.sin(2.0 * np.pi * now / 0.5)


@pytest.mark.parametrize("speed", [0.02, -0.01])
def test_a_brake_drags_once_in_each_turn_whatever_the_way(speed):
    brake = {"brake": 2.0, "brake_pitch": 4e-3, "brake_phase": 0.5}
    plain, dragged = lags(speed, **FAR), lags(speed, **FAR, **brake)
    position = speed * TICK * np.arange(900) - dragged
    turned = 2.0 * np.pi * position / 4e-3 + 0.5
    most = 2.0 / 470.0**2
    more = np.sign(speed) * (dragged - plain)[100:]
    assert more == pytest.approx(most * np.maximum(np.sin(turned[100:]), 0.0), abs=0.12 * most)
    assert more.max() > 0.9 * most and np.mean(np.abs(more) < 0.03 * most) > 0.25


def test_a_slow_servo_holds_what_it_asks_for_until_its_next_cycle():
    def step(now):
        return 1e-3 if now >= 0.01 else 0.0

    found = moved(step, 200, **FAR, loop=2e-3)[0]
    fine, at, speed, asked, expected = 1000, 0.0, 0.0, 0.0, []
    for tick in range(200):
        expected.append(at)
        if tick % 2 == 0:
            asked = 470.0**2 * (step(tick * TICK) - at) - 2.0 * 0.8 * 470.0 * speed
        for _ in range(fine):
            speed += TICK / fine * asked
            at += TICK / fine * speed
    plain = moved(step, 200, **FAR)[0]
    assert found == pytest.approx(np.array(expected), abs=2e-6)
    assert np.abs(found - plain).max() > 1e-4 and abs(found[-1] - 1e-3) < 1e-6
    # As fast as its steps, it is the servo that it was.
    assert moved(step, 200, **FAR, loop=2e-5)[0] == pytest.approx(plain, abs=1e-5)


def test_a_rod_slides_in_its_chuck_as_far_as_its_play_goes():
    given = [(32, -1e-4)]
    assert force_at(4e-4, memory=given, chuck=1e-4) == pytest.approx(force_at(3e-4))
    assert force_at(REAR - 4e-4, memory=given, chuck=1e-4) == pytest.approx(force_at(REAR - 5e-4))
    position, force = moved(deep, 1000, speed=0.006 * 4.0 * np.pi, chuck=1e-4, chuck_force=10.0, c=0.0)
    # By how much the tip is ahead, in contacts of either frame.
    ahead = np.where(force < 0.0, 0.005 - force / 1e5, -0.005 - force / 1e5) - position
    for hard in (force < -40.0, force > 40.0):
        assert ahead[hard] == pytest.approx(np.full(hard.sum(), np.sign(force[hard][0]) * 1e-4), abs=1e-6)
    weak = (np.abs(force) > 1.0) & (np.abs(force) < 9.0)
    assert np.all(np.abs(ahead[weak]) < 1.01e-4)
    assert (first := np.flatnonzero(force < -1.0))[0] < 150
    assert ahead[first[0]] == pytest.approx(0.0, abs=1e-6)
    pushing = moved(deep, 1000, speed=0.006 * 4.0 * np.pi, c=0.0)[1]
    assert np.abs(pushing).max() - np.abs(force).max() == pytest.approx(10.0, abs=0.1)


def test_a_slide_swings_on_its_air_until_a_load_damps_it():
    hammer = {"hammer": 1e-5, "hammer_omega": 2.0 * np.pi * 40.0, "hammer_force": 10.0}
    k, bias = smooth()[0].values["k"], smooth()[0].values["bias"]
    plain, found = (driven(**one, c=0.0)[0][FORCE] - bias for one in ({}, hammer))
    off = found - plain
    pressing = plain < -2.0
    begins = np.flatnonzero(np.diff(pressing.astype(int)) > 0) + 1
    ends = np.flatnonzero(np.diff(pressing.astype(int)) < 0) + 1
    assert len(begins) >= 2
    for begin, end in zip(begins, ends, strict=False):
        middle = (begin + end) // 2
        early, late = off[begin : begin + 25], off[middle : middle + 25]
        assert 0.1 * 1e-5 * k < np.abs(early).max() < 2.2e-5 * k
        assert np.abs(late).max() < 0.35 * np.abs(early).max()
    # Its swing neither dies nor grows.
    quiet = {**hammer, "hammer_force": 1e9}
    seen = driven(**quiet, c=0.0)[0][FORCE] - bias - plain
    assert 1.2e-5 * k < np.abs(seen[plain < -20.0]).max() < 2.2e-5 * k


def test_a_cable_that_rubs_reads_what_was_moved_and_forgets_it():
    found, plain = driven(tribo=300.0, tribo_time=0.1)[0], driven()[0]
    assert np.array_equal(found[ENCODER], plain[ENCODER])
    position, charge, expected = plain[ENCODER], 0.0, [0.0]
    for step in np.diff(position):
        charge = charge * np.exp(-TICK / 0.1) + 300.0 * step
        expected.append(charge)
    assert (found - plain)[FORCE][3:] == pytest.approx(np.array(expected)[3:], abs=0.02)
    assert max(expected) > 0.3 and min(expected) < -0.3


def test_a_sensor_that_is_pulled_off_reads_less_on_that_side_alone():
    plain, bias = driven()[0][FORCE], smooth()[0].values["bias"]
    read, force = driven(preload=0.3, preload_force=15.0)[0][FORCE] - bias, plain - bias
    assert read == pytest.approx(force - 0.3 * np.maximum(force - 15.0, 0.0), abs=1e-9)
    assert force.max() > 40.0 and force.min() < -40.0


def test_a_switch_is_heard_at_the_begin_and_at_the_end_of_a_contact():
    plain, bias = driven()[0][FORCE], smooth()[0].values["bias"]
    off = driven(pulse=3.0, pulse_time=0.01)[0][FORCE] - plain
    reported, level, expected, times = False, 0.0, [], 0
    for force in np.abs(plain - bias):
        level *= np.exp(-TICK / 0.01)
        if (force > 6.0) if not reported else (force < 2.0):
            reported, times = not reported, times + 1
            level += 3.0 if reported else -3.0
        expected.append(level)
    assert off == pytest.approx(np.array(expected), abs=1e-9)
    assert times >= 4 and off.max() == pytest.approx(3.0, abs=0.01) == -off.min()


def test_a_pawl_climbs_tooth_after_tooth_on_the_way_in_alone():
    ratchet = {"ratchet": 4.0, "ratchet_pitch": 2e-4, "c": 0.0}
    for teeth, share in ((0.4, 0.5), (0.8, 1.0), (0.9, 0.5), (1.0, 0.0), (2.4, 0.5)):
        depth = teeth * 2e-4
        for rate, way in ((0.02, 1.0), (-0.02, 0.0), (0.0, 0.5)):
            more = force_at(depth, c=0.0) - force_at(depth, rate, **ratchet)
            assert more == pytest.approx(4.0 * share * way, abs=1e-6)
    assert force_at(-1e-5, 0.02, **ratchet) == 0.0
    assert force_at(REAR - 4e-4, -0.02, **ratchet) == force_at(REAR - 4e-4, c=0.0)


def test_a_spring_ejects_some_time_after_the_touch():
    ejector = {"ejector": 5.0, "ejector_after": 0.05, "c": 0.0}
    for since, more in ((0.04, 0.0), (0.053, 5.0 * (1.0 - np.exp(-1.0))), (0.1, 5.0)):
        found = force_at(6e-4, memory=[(33, since)], **ejector)
        assert force_at(6e-4, c=0.0) - found == pytest.approx(more, abs=1e-5)
    ended = force_at(3e-5, memory=[(33, 1.0)], **ejector)
    assert force_at(3e-5, c=0.0) - ended == pytest.approx(5.0 * (1.0 - np.exp(-1.0)))
    assert force_at(REAR - 4e-4, memory=[(33, 1.0)], **ejector) == force_at(REAR - 4e-4, c=0.0)
    plain, more = (moved(twice, 500, 0.0045, **{**ejector, "ejector": size})[1] for size in (0.0, 5.0))
    for contact in (slice(0, 250), slice(250, 500)):
        touching = np.flatnonzero(plain[contact] < -10.0)
        since = TICK * (touching - np.flatnonzero(plain[contact] < 0.0)[0])
        reported = (plain - more)[contact][touching]
        assert reported == pytest.approx(5.0 * (1.0 - np.exp(-np.maximum(since - 0.05, 0.0) / 3e-3)), abs=1.7)
        assert np.abs(reported[since < 0.048]).max() < 1e-9
        assert reported[(since > 0.06)] == pytest.approx(np.full((since > 0.06).sum(), 5.0), abs=0.2)


def test_rubber_gets_softer_by_the_work_done_on_it_and_recovers():
    worked = {"worked": 0.5, "worked_time": 1.0, "c": 0.0}
    warm = [(34, 0.3)]
    assert force_at(4e-4, memory=warm, **worked) == pytest.approx(np.exp(-0.15) * force_at(4e-4, c=0.0))
    assert force_at(REAR - 4e-4, memory=warm, **worked) == force_at(REAR - 4e-4, c=0.0)
    cool = [(35, 0.3)]
    other = force_at(REAR - 4e-4, memory=cool, **worked)
    assert other == pytest.approx(np.exp(-0.15) * force_at(REAR - 4e-4, c=0.0))
    plain, less = (moved(twice, 500, 0.0045, **{**worked, "worked": size})[1] for size in (0.0, 0.5))
    depth = -plain / 1e5
    given, warmth, expected = -0.5 * (less[1:] + less[:-1]) * np.maximum(np.diff(depth), 0.0), 0.0, [0.0]
    for one in given:
        warmth += one / 0.1 - TICK * warmth
        expected.append(warmth)
    touching = plain < -10.0
    share = np.log(less[touching] / plain[touching])
    assert share == pytest.approx(-0.5 * np.array(expected)[touching], abs=0.01)
    assert share.min() < -0.3


def test_commands_wait_for_their_slot():
    plain, found = series_of({}).arrival, series_of({"slot": 2.37e-3}).arrival
    late = found - plain
    assert late.min() >= 0.0 and late.max() < 2.37e-3
    assert np.mean(late) == pytest.approx(1.185e-3, rel=0.05)
    into = np.mod(found / 2.37e-3, 1.0)
    assert np.abs(np.exp(2j * np.pi * into) - np.exp(2j * np.pi * into[0])).max() < 1e-6
    lost = series_of({"slot": 2.5e-3, "loss": 0.1}).arrival
    assert np.isinf(lost).any() and not np.isnan(lost).any()


def test_a_computer_that_stands_by_sends_what_is_behind_now_and_then():
    plain, found = driven()[0][ENCODER], driven(standby=5e-3, standby_every=200.0)[0][ENCODER]
    off, (_, log) = found - plain, smooth()
    for tick in range(200, 2800, 200):
        reported = off[tick : tick + 40]
        expected = -5e-3 * log[1, tick + 1]  # of one command
        # What a command does in all is what it is off by, for a tick.
        assert TICK * reported.sum() == pytest.approx(TICK * expected, abs=0.03 * TICK * 1e-4)
        assert np.abs(reported[:3]).max() < 1e-8 and np.abs(reported[-5:]).max() < 2e-7


def test_a_keeper_of_stations_pushes_back_what_leaves_its_box():
    p, mass = rig_parameters({"box": 2.0, "box_edge": 3e-3}), 100.0
    for position, speed, push in (
        (2.9e-3, 0.01, 0.0),
        (3.1e-3, 0.01, -2.0),
        (3.1e-3, -0.01, 0.0),
        (-3.1e-3, -0.01, 2.0),
        (-3.1e-3, 0.01, 0.0),
    ):
        state = first_satellite(speed)
        state[0] = position
        move_satellite(p, mass, 0.0, TICK, 5.0, 0.0, state)
        assert state[1] - speed == pytest.approx((5.0 + push) * TICK / mass)


def test_a_satellite_s_force_is_smoothed():
    p, state, speeds = rig_parameters({"smoothed": 4e-3}), first_satellite(0.0), [0.0]
    for tick in range(60):
        move_satellite(p, 100.0, tick * TICK, TICK, 10.0 if tick < 30 else 0.0, 0.0, state)
        speeds.append(state[1])
    felt = np.diff(speeds) * 100.0 / TICK
    assert felt[:30] == pytest.approx(10.0 * (1.0 - 0.8 ** np.arange(1, 31)))
    assert felt[30:] == pytest.approx(felt[29] * 0.8 ** np.arange(1, 31))
    assert sum(felt) == pytest.approx(300.0, rel=1e-3)
    assert pushed(10.0, smoothed=1e-9) == pytest.approx(pushed(10.0), rel=1e-5)


def test_what_a_controller_leads_by_is_bounded():
    rise = [0.5 * tick for tick in range(8)] + [3.5 - 3.0 * tick for tick in range(8)]
    plain, none = answers(rise), answers(rise, lead=-1.8e-3)
    for bound in (0.3, 1.0, 50.0):
        p, state = rig_parameters({"lead_bound": bound}), first_controller(1e5, 50.0, 0.0, 0.0)
        found, led = [], []
        for force in rise:
            compensate(p, 1e5, 1.8e-3, TICK, force, 0.0, 0.0, 0.0, state)
            found.append(state[11])
            led.append(1.8e-3 * state[1] if abs(force) > 4.0 else 0.0)
        stretched = np.array(found) - np.array(rise) - np.clip(led, -bound, bound)
        # Whatever else it does depends on where it took the begin of the contact to be, and on no bound.
        assert np.array(found)[:9] == pytest.approx(none[:9])
        if bound == 50.0:
            assert found == pytest.approx(plain)
        elif bound == 0.3:
            assert np.abs(found - plain).max() > 0.7
        in_front = np.abs(rise) < 15.0
        assert stretched[in_front] == pytest.approx((none - np.array(rise))[in_front], abs=1e-9)


def test_a_contact_counts_once_its_force_has_lasted():
    forces = [0.0] * 3 + [10.0] * 4 + [0.0] + [10.0] * 8
    desired = -1e-4
    plain, late = (answers(forces, desired, debounce=ticks) for ticks in (0.0, 5.0))
    compensated = np.abs(late - forces) > 1e-9
    assert compensated.tolist() == [False] * 13 + [True] * 3
    assert np.count_nonzero(np.abs(plain - forces) > 1e-9) == 12
    sooner = np.abs(answers(forces, desired, debounce=1.0) - forces) > 1e-9
    assert sooner.tolist() == [False] * 4 + [True] * 3 + [False] * 2 + [True] * 7
