"""Kinds outside the catalogue: what each does, seen, stable, new, and by choice."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from orchestrator.cli.main import main
from orchestrator.diagnosis.rig.challenge import make
from orchestrator.diagnosis.rig.challenge.draw import NOISE, RUNS, Plan, draw_case, make_run, run_series
from orchestrator.diagnosis.rig.challenge.evidence import visibility
from orchestrator.diagnosis.rig.challenge.hidden import HIDDEN
from orchestrator.diagnosis.rig.challenge.outside import OUTSIDE
from orchestrator.diagnosis.rig.challenge.outside_fresh import FRESH
from orchestrator.diagnosis.rig.challenge.rig import TICK, drive
from orchestrator.diagnosis.rig.challenge.rig_parameters import rig_parameters
from orchestrator.diagnosis.rig.challenge.series import HISTORY, draw_series
from orchestrator.diagnosis.rig.challenge.software import first_satellite, move_satellite

each = pytest.mark.parametrize("effect", {**OUTSIDE, **FRESH}.values(), ids=lambda one: one.id)


def case_of(effect, size, number=1):
    return draw_case(Plan("outside", (effect,), size), 78, number)


@cache
def bare():
    """A rig that hides nothing, and its first run."""
    case = draw_case(Plan("none", (), 0.0), 78, 1)
    return case, make_run(case, 0)


@each
def test_what_its_blocks_give_strays_the_more_the_larger_it_is(effect):
    plain, log = bare()
    mass, speed = RUNS[0].mass, RUNS[0].speed

    def given(case):
        series = run_series(case, 0, case.values)
        return drive(case.lab, case.values, mass, speed, log, series)

    before = given(plain)
    strays = []
    for size in (0.03, 0.3, 1.0):
        off = np.sqrt(np.mean((given(case_of(effect, size)) - before) ** 2, axis=1))
        # Of the satellite's velocity, what 1 N makes of it in a tick; of the rest, the noise measured.
        strays.append(max(off[1] * mass / TICK, off[2] / NOISE[0], off[3] / NOISE[1], off[4] / NOISE[1]))
    assert strays[0] < strays[1] < strays[2], strays
    assert strays[0] < 2.0 and strays[2] > 0.6, strays


@each
def test_a_rig_with_it_stays_in_range(effect):
    for number in range(1, 5):
        assert make_run(case_of(effect, 1.2, number), 3).shape[1] == 3000, number


@pytest.mark.parametrize("effect", FRESH.values(), ids=lambda one: one.id)
def test_logs_tell_of_it(effect):
    case = case_of(effect, 0.7, 2)
    logs = [make_run(case, index) for index in range(3)]
    assert visibility(case, logs, chance=effect.chance) > 30.0


def test_kinds_are_new_and_of_all_places():
    assert len(FRESH) >= 12 and not set(FRESH) & (set(OUTSIDE) | set(HIDDEN))
    assert {one.place for one in FRESH.values()} == {one.place for one in HIDDEN.values()}
    drawn = [set(one.draw(np.random.default_rng(0), 1.0)) for one in FRESH.values()]
    others = [one.draw(np.random.default_rng(0), 1.0) for one in (*HIDDEN.values(), *OUTSIDE.values())]
    assert not set().union(*drawn) & set().union(*others)


@pytest.mark.parametrize(
    ("given", "kinds"),
    [
        ([], set()),
        (["--outside"], {*OUTSIDE, *FRESH}),
        (["--outside", "all"], {*OUTSIDE, *FRESH}),
        (["--outside", "known"], set(OUTSIDE)),
        (["--outside", "fresh"], set(FRESH)),
    ],
)
def test_the_order_chooses_the_kinds(tmp_path, monkeypatch, given, kinds):
    asked = []

    def plans(count, seed, pool, outside, *rest):
        asked.append({one.id for one in outside})
        raise KeyboardInterrupt

    monkeypatch.setattr(make, "plan_cases", plans)
    main(["challenge", "make", str(tmp_path / "new"), "--cases", "9", "--seed", "1", "--jobs", "1", *given])
    assert asked == [kinds]


def test_a_late_packet_is_obeyed_after_newer_ones():
    series = draw_series({"reorder": 0.05, "reorder_ticks": 3.0}, (0.0, 0.0), 2000, np.random.SeedSequence(1))
    index = np.arange(HISTORY + 2000)
    stepped_back = np.flatnonzero(series.payload < index - 1)
    assert 50 < len(stepped_back) < 150 and set(index[stepped_back] - series.payload[stepped_back]) == {3}
    none = draw_series({}, (0.0, 0.0), 2000, np.random.SeedSequence(1))
    assert np.array_equal(none.payload, index) and np.array_equal(none.arrival, series.arrival)


def test_a_clock_that_is_set_right_delays_up_to_a_bound():
    seed = np.random.SeedSequence(1)
    plain = draw_series({}, (0.0, 0.0), 2000, np.random.SeedSequence(1))
    series = draw_series({"reset": 2e-3, "reset_period": 0.25}, (0.0, 0.0), 2000, seed)
    late = series.arrival - plain.arrival
    assert 0.0 <= late.min() < 1e-4 and 1.9e-3 < late.max() < 2e-3
    assert np.count_nonzero(np.diff(late) < 0.0) in (8, 9)


def test_thrusters_brake_to_half_of_the_speed_at_which_they_fire():
    p, mass = rig_parameters({"thrust": 2.0, "thrust_speed": 0.01}), 100.0
    state = first_satellite(0.02)
    for tick in range(2000):
        move_satellite(p, mass, 1e-3 * tick, 1e-3, 0.0, 0.0, state)
    assert state[1] == pytest.approx(0.005, abs=2.1e-5)  # a tick takes off 2e-5 m/s


def test_a_satellite_that_burns_fuel_is_moved_ever_more():
    p = rig_parameters({"fuel": 0.05})
    speeds = []
    for now in (0.0, 10.0):
        state = first_satellite(0.0)
        move_satellite(p, 100.0, now, 1e-3, 1.0, 0.0, state)
        speeds.append(state[1])
    assert speeds[1] == pytest.approx(2.0 * speeds[0], rel=1e-12)
