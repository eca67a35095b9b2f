"""Bad data is distinguished from a bad model: mistakes put into good logs are named, effects are not."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from extent import all_or
from logged import logged_study, with_column
from scipy.signal import lfilter

from orchestrator.base.errors import Problem
from orchestrator.diagnosis.rig.answers import weigh_software
from orchestrator.diagnosis.rig.catalogue import catalogue
from orchestrator.diagnosis.rig.checks import check_logs
from orchestrator.diagnosis.rig.consistency import _force_of_velocity, _force_out_of_contact
from orchestrator.diagnosis.rig.study import Role, load_study
from orchestrator.diagnosis.study.mistakes import merged_problems

CASES = Path(__file__).parents[3] / "shared" / "gap" / "cases"


@pytest.fixture(scope="module")
def good():
    return logged_study()


def reported(study):
    refused, warned = check_logs(study)
    return [str(one) for one in refused], [str(one) for one in warned]


def rows(study, keep, run=0):
    runs = list(study.runs)
    runs[run] = replace(runs[run], columns={name: one[keep] for name, one in runs[run].columns.items()})
    return replace(study, runs=tuple(runs))


def test_a_good_log_passes(good):
    assert reported(good) == ([], [])


@pytest.mark.parametrize(
    ("effect", "theta"),
    [
        ("dynamics.mass", (0.15,)),
        ("sensor.gain", (0.25,)),
        ("robot.delay", (0.004,)),
        ("controller.lead", (0.002,)),
        ("structure.offset", (0.0005,)),
        ("dynamics.residual-gravity", (0.005,)),
        ("contact.stiffness", (-0.4,)),
    ],
)
def test_an_effect_is_no_bad_data(effect, theta):
    assert reported(logged_study((catalogue()[effect],), theta)) == ([], [])


def _sizes(effect):
    """Parameters of an effect at twice their usual size, with either sign, over the fits' first shapes."""
    choices = []
    for one in effect.parameters:
        if one.shape:
            shapes = sorted(one.starts)
            choices.append(shapes if len(effect.parameters) < 3 else shapes[:: max(len(shapes) // 4, 1)])
        else:
            both = (2.0 * one.scale, -2.0 * one.scale) if one.low < 0.0 else (2.0 * one.scale,)
            choices.append([min(max(size, one.low), one.high) for size in both])
    return list(product(*choices))


@pytest.mark.parametrize("effect", catalogue().values(), ids=catalogue())
def test_no_effect_of_the_catalogue_at_twice_its_usual_size_is_bad_data(effect):
    sizes = _sizes(effect)
    for theta in sizes[:: all_or(max(len(sizes) // 24, 1), 1)]:
        refused, _ = reported(logged_study((effect,), theta))
        assert refused == [], theta


@pytest.mark.parametrize(("share", "hertz"), [(0.185, 3.83), (0.3, 3.83), (0.37, 3.5)])
def test_a_body_that_swings_on_the_satellite_is_no_bad_data(share, hertz):
    found = logged_study((catalogue()["dynamics.appendage"],), (share, 2.0 * np.pi * hertz))
    assert reported(found) == ([], [])


@pytest.mark.parametrize(("sign", "fits"), [(1.0, True), (-1.0, False)])
def test_what_else_pushes_the_satellite_slowly_is_no_mistake_of_columns(good, sign, fits):
    """As a strong cable does: then only the changes of force and velocity go together."""
    run = good.runs[0]
    slow = 6.0 * float(np.std(run["compensated_force"])) * np.sin(2 * np.pi * 0.4 * run["time"])
    pushed = run["desired_velocity"] + np.cumsum(slow) * good.tick / run.mass
    moved = replace(
        run,
        columns=dict(run.columns)
        | {"desired_velocity": pushed, "compensated_force": sign * run["compensated_force"]},
    )
    body = run.mass * np.diff(pushed) / good.tick
    assert np.corrcoef(body, run["compensated_force"][:-1])[0, 1] < 0.8
    assert (_force_of_velocity(good, moved) is None) is fits


@pytest.mark.parametrize("given", ["filter", "offset", "dither", "noise", "sign", "thousandth"])
def test_a_controller_that_passes_the_force_on_in_its_own_way_is_no_bad_data(good, given):
    """A filter of its own rings on after a contact; what is not about the force is refused."""
    rng = np.random.default_rng(4)
    run = good.runs[0]
    force = run["sensor_force"] + 0.5 * rng.standard_normal(len(run))
    out = {
        "filter": lfilter([0.8, -0.1, 0.05], [1.0, -0.2, 0.05], force),
        "offset": force + 0.3,
        "dither": force + 2.0 * rng.standard_normal(len(run)),
        "noise": 0.5 * rng.standard_normal(len(run)),
        "sign": -force,
        "thousandth": 1e-3 * force,
    }[given]
    reported = _force_out_of_contact(
        good, replace(run, columns=dict(run.columns, sensor_force=force, compensated_force=out))
    )
    assert reported is not None and reported.gross == (given not in ("filter", "offset", "dither"))


def test_a_satellite_that_counts_its_time_coarsely_is_a_gap_of_its_software(good):
    """No column is wrong where ways follow speeds, but not to the last digit."""
    rng = np.random.default_rng(2)
    runs = []
    for run in good.runs:
        way = np.diff(run["desired_position"]) * (1.0 + 0.3 * (rng.random(len(run) - 1) - 0.5))
        position = run["desired_position"][0] + np.concatenate([[0.0], np.cumsum(way)])
        runs.append(replace(run, columns={**run.columns, "desired_position": np.round(position, 9)}))
    coarse = replace(good, runs=tuple(runs))
    assert reported(coarse) == ([], [])
    group, right = weigh_software(coarse, "dynamics"), weigh_software(good, "dynamics")
    assert group.outside > 1e3 and group.place == "dynamics" and right.outside == 0.0


@pytest.mark.parametrize(
    ("column", "factor", "said"),
    [
        ("sensor_force", -1.0, "its sign is reversed"),
        ("compensated_force", -1.0, "its sign is reversed"),
        ("encoder_position", -1.0, "its sign is reversed"),
        ("desired_velocity", -1.0, "its sign is reversed"),
        ("desired_position", 1e3, "1000 times too large"),
        ("desired_velocity", 1e3, "1000 times too large"),
        ("encoder_position", 1e3, "1000 times too large"),
        ("sensor_force", 1e-3, "1000 times too small"),
        ("sensor_force", 0.22480894309971052, "pounds-force"),
        ("stiffness_estimate", 1e-3, "1000 times too small"),
        ("desired_position", 39.37007874015748, "inches"),
    ],
)
def test_a_wrong_sign_or_unit_is_named(good, column, factor, said):
    refused, _ = reported(with_column(good, column, lambda values: factor * values))
    assert len(refused) == 1
    assert refused[0].startswith(f"train-1: column {column}: from row ")
    assert said in refused[0]


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("desired_position", "encoder_position"),
        ("desired_position", "desired_velocity"),
        ("sensor_force", "compensated_force"),
        ("encoder_position", "desired_velocity"),
        ("sensor_force", "encoder_position"),
    ],
)
def test_exchanged_columns_are_named(good, one, other):
    run = good.runs[0]
    columns = {**run.columns, one: run[other], other: run[one]}
    refused, _ = reported(replace(good, runs=(replace(run, columns=columns), *good.runs[1:])))
    assert len(refused) == 1
    place = refused[0].split(":")[1]
    assert one in place and other in place
    assert "Exchange their headers" in refused[0]


@pytest.mark.parametrize(
    "column", ["sensor_force", "compensated_force", "encoder_position", "desired_velocity"]
)
@pytest.mark.parametrize("shift", [-7, -1, 1, 12])
def test_the_clock_of_a_column_is_named(good, column, shift):
    def late(values):
        moved = np.roll(values, shift)
        if shift > 0:
            moved[:shift] = values[0]
        else:
            moved[shift:] = values[-1]
        return moved

    refused, _ = reported(with_column(good, column, late))
    assert len(refused) == 1
    assert column in refused[0]
    assert f"{abs(shift)} ticks {'late' if shift > 0 else 'early'}" in refused[0]


def test_gaps_repeats_and_order_of_time_are_named(good):
    keep = np.ones(2000, bool)
    keep[700:710] = False
    (gap,), _ = reported(rows(good, keep))
    assert gap == (
        "train-1: column time: row 700 (0.71): 10 rows are missing in 1 places, the first 0.011 s long\n"
        "  Log every tick: replays need each input."
    )
    (twice,), _ = reported(rows(good, np.sort(np.append(np.arange(2000), [900, 1200]))))
    assert twice == ("train-1: column time: row 901 (0.9): 2 stamps stand twice\n  Remove the second row.")
    order = np.arange(2000)
    order[[500, 501]] = 501, 500
    (back,), _ = reported(rows(good, order))
    assert "row 501 (0.5): time runs backwards" in back


def test_the_unit_of_time_is_named(good):
    (unit,), _ = reported(with_column(good, "time", lambda time: 1e3 * time))
    assert "rows are 1 s apart, the tick is 0.001 s (1000 times)" in unit


def test_a_clock_that_gains_little_by_little_is_named(good):
    """Each step is right to 5 %, or lies within what stamps are rounded to."""
    slow = with_column(good, "time", lambda time: 1.04 * time)
    (reported_,), warned = reported(slow)
    assert warned == [] and reported_ == (
        "train-1: column time: by their stamps 2000 rows take 2.07896 s, 4 % more than as many steps of "
        "0.001 s\n  Correct `tick`, or the clock that the stamps are of."
    )
    # Two quartzes differ by as much; stamps are rounded.
    assert reported(with_column(good, "time", lambda time: (1.0 + 5e-5) * time)) == ([], [])
    assert reported(with_column(good, "time", lambda time: np.round(time + 2e-4, 3))) == ([], [])


def test_a_dead_channel_is_named(good):
    (dead,), _ = reported(with_column(good, "encoder_position", np.zeros_like))
    assert dead == (
        "train-1: column encoder_position: rows 0 to 1999 are all 0\n"
        "  The channel is dead or not connected; log it, or leave the run out."
    )


def test_a_clipped_channel_is_a_warning(good):
    top = 0.5 * np.max(good.runs[0]["sensor_force"])

    # The sensor clips, and the software computes with what it was given.
    def clip(values):
        return np.clip(values, -np.inf, top)

    study = with_column(good, "sensor_force", clip)
    refused, warned = reported(study)
    assert refused == []
    assert any(one.startswith("train-1: column sensor_force: row ") and "clipped" in one for one in warned)


def test_a_frozen_channel_is_a_warning(good):
    def freeze(values):
        values[500:600] = values[500]
        return values

    refused, warned = reported(with_column(good, "encoder_position", freeze))
    assert refused == []
    assert any("column encoder_position: row 500" in one and "frozen for 100 rows" in one for one in warned)


def test_runs_left_early_are_warned_of(good):
    refused, warned = reported(rows(good, slice(0, 900)))
    assert refused == []
    assert any(one.startswith("train-1: ends at row 899") for one in warned)


def test_too_few_contacts(good):
    short = good
    for run in range(len(good.runs)):
        short = rows(short, slice(0, 180), run)
    refused, _ = reported(short)
    assert len(refused) == 1
    assert refused[0].startswith("runs of the role train: 0 contacts in all (train-1 0, train-2 0)")


def test_a_repeat_of_no_heldout_run_is_warned_of(good):
    runs = tuple(replace(run, role=Role.TRAIN) if run.role is Role.HELDOUT else run for run in good.runs)
    _, warned = reported(replace(good, runs=runs))
    assert any("repeats no held-out run: mass 340 kg" in one for one in warned)


@pytest.mark.skipif(not CASES.is_dir(), reason="the labelled cases are not here")
def test_the_labelled_cases_have_good_data():
    found = {}
    for folder in sorted(CASES.glob("case-*")):
        refused, warned = check_logs(load_study(folder))
        assert refused == [], folder.name
        if warned:
            found[folder.name] = {one.what.split(": ")[1] for one in warned}
    # Its hidden fault is a sensor that clips.
    assert found == {"case-003": {"clipped"}}


@pytest.mark.parametrize(("runs", "said"), [(2, "the same in 1 more run"), (3, "the same in 2 more runs")])
def test_what_is_the_same_in_several_runs_is_reported_once(runs, said):
    of_each = [Problem(f"run-{number}: force", "is mirrored", "", "Turn it.") for number in range(runs)]
    (reported,) = merged_problems(of_each, "the same in {} more run{s}")
    assert reported.what == f"is mirrored; {said}"
