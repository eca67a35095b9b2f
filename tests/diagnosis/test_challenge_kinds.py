"""What kinds outside the catalogue that once were fresh do, each by itself."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.diagnosis.challenge.draw import RUNS, Plan, draw_case, make_run, run_series
from orchestrator.diagnosis.challenge.knobs import knobs
from orchestrator.diagnosis.challenge.rig import COLUMNS, drive
from orchestrator.diagnosis.challenge.series import HISTORY, draw_series
from orchestrator.diagnosis.challenge.software import first_satellite, move_satellite
from tests.diagnosis.challenge_parts import (
    TICK,
    TICKS,
    answers,
    force_at,
    lags,
    moved,
    pressed,
    pushed,
    series_of,
)


def test_a_falsified_command_is_off_by_so_much_now_and_then():
    stray = series_of({"corrupt": 1e-4, "corrupt_rate": 30.0}).stray
    assert set(stray) == {-1e-4, 0.0, 1e-4} and 40 < np.count_nonzero(stray) < 80
    assert not series_of({}).stray.any()


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
    p, pushes = knobs({"plume": 6.0, "plume_reach": 2e-3}), []
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
