"""What each of the fresh kinds outside the catalogue does, by itself."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.diagnosis.challenge.knobs import knobs
from orchestrator.diagnosis.challenge.software import (
    compensate,
    first_controller,
    first_satellite,
    move_satellite,
)
from tests.diagnosis.challenge_parts import (
    ENCODER,
    FORCE,
    TICK,
    answers,
    driven,
    force_at,
    moved,
    pressed,
    pushed,
    rates,
    series_of,
    smooth,
)


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
    p, state = knobs(stuck), first_satellite(0.0)
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
    p, plain = knobs({"payload": 1.5}), knobs({})
    with_it, without = (first_controller(1e5, 50.0, 0.0, 0.0) for _ in range(2))
    for tick in range(1, 60):
        # Half a metre per second squared; below 4 N, there is nothing but the force.
        for one, state in ((p, with_it), (plain, without)):
            compensate(one, 1e5, 1.8e-3, TICK, 2.0, 0.25 * (tick * TICK) ** 2, 0.0, 0.0, state)
    assert without[11] == pytest.approx(2.0) and with_it[11] == pytest.approx(2.75)
