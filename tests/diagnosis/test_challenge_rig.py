"""The rig that makes cases: as the model believes where it is smooth, and off where an effect is hidden."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from orchestrator.diagnosis.rig.catalogue import catalogue
from orchestrator.diagnosis.rig.challenge import evidence
from orchestrator.diagnosis.rig.challenge.draw import (
    NOISE,
    RUNS,
    Plan,
    draw_case,
    make_run,
    plan_cases,
    run_series,
    tolerances,
)
from orchestrator.diagnosis.rig.challenge.evidence import imitated, visibility
from orchestrator.diagnosis.rig.challenge.hidden import HIDDEN, TIED, Hidden
from orchestrator.diagnosis.rig.challenge.outside import OUTSIDE
from orchestrator.diagnosis.rig.challenge.outside_fresh import FRESH
from orchestrator.diagnosis.rig.challenge.rig import drive
from orchestrator.diagnosis.rig.challenge.rig_parameters import CALIBRATED
from orchestrator.diagnosis.rig.model import RigModel
from orchestrator.diagnosis.rig.software import ControllerReplay, DynamicsReplay
from tests.benchmarks.rig_calibration.simulated_cases import observed

_ALL = {**HIDDEN, **OUTSIDE, **FRESH}


def study_of(case, indices):
    """What the lab hands over of some runs of a case, without files between."""
    return observed(case, {index: make_run(case, index) for index in indices})


def square(parts):
    """Mean square of all residuals, over their noise."""
    return float(np.mean(np.concatenate(parts) ** 2))


@cache
def plain():
    """A rig without roughness and effects, and its study."""
    case = draw_case(Plan("none", (), 0.0), 5, 1, roughness=0.0)
    return case, study_of(case, (0, 3))


def test_the_model_leaves_only_noise_of_a_smooth_rig():
    case, study = plain()
    true = {name: case.plain[knob] for name, knob in CALIBRATED.items()}
    for part in RigModel(study, study.runs).residuals(true, (), np.zeros(0)):
        # 3000 samples: the mean square of pure noise has a standard deviation of 0.026.
        assert np.mean(part**2) == pytest.approx(1.0, abs=0.1)
        assert np.abs(part).max() < 6.5
    assert max(np.abs(run["sensor_force"]).max() for run in study.runs) > 50.0


def test_the_calibration_error_shows():
    _, study = plain()
    assert square(RigModel(study, study.runs).residuals({}, (), np.zeros(0))) > 1.15


def test_its_software_is_the_lab_s():
    _, study = plain()
    for replay in (DynamicsReplay(study, study.runs), ControllerReplay(study, study.runs)):
        assert square(replay.residuals({}, (), np.zeros(0))) < 1.2  # of the log's last digit


def test_effects_hidden_are_those_of_the_catalogue():
    assert set(HIDDEN) == set(catalogue())
    assert len(OUTSIDE) >= 8 and not set(OUTSIDE) & set(catalogue())
    assert {one.place for one in OUTSIDE.values()} == {one.place for one in HIDDEN.values()}


@pytest.mark.parametrize("effect", _ALL.values(), ids=lambda one: one.id)
def test_a_strong_effect_shows_and_only_where_it_acts(effect):
    case = draw_case(Plan("single", (effect,), 1.0), 3, 7)
    log = make_run(case, 0)
    bare = make_run(draw_case(Plan("none", (), 0.0), 3, 7), 0)
    n = min(log.shape[1], bare.shape[1])
    assert not np.array_equal(log[:, :n], bare[:, :n])
    study = study_of(case, (0,))
    for place, replay in (("dynamics", DynamicsReplay), ("controller", ControllerReplay)):
        left = square(replay(study, study.runs).residuals({}, (), np.zeros(0)))
        assert (left > 3.0) == (effect.place == place), (place, left)


def test_roughness_is_benign():
    """A rough rig is distinguished from a smooth one by a few percent of the noise, not by more."""
    squares = []
    for number in range(1, 5):
        case = draw_case(Plan("none", (), 0.0), 8, number)
        study = study_of(case, (1,))
        true = {name: case.plain[knob] for name, knob in CALIBRATED.items()}
        squares.append(square(RigModel(study, study.runs).residuals(true, (), np.zeros(0))))
    assert 0.95 < np.mean(squares) < 1.12
    assert max(squares) < 1.2


def test_chance_repeats_and_differs_between_runs_of_one_rig():
    case = draw_case(Plan("single", (HIDDEN["sensor.coloured-noise"],), 0.5), 3, 2)
    first, again, repeat = make_run(case, 3), make_run(case, 3), make_run(case, 5)
    assert np.array_equal(first, again)
    assert RUNS[3].mass == RUNS[5].mass and not np.array_equal(first[3], repeat[3])


def test_taking_an_effect_away_leaves_all_other_chance():
    hidden = draw_case(Plan("single", (HIDDEN["sensor.bias"],), 1.0), 4, 9)
    bare = draw_case(Plan("none", (), 0.0), 4, 9)
    assert hidden.plain == bare.values and hidden.lab == bare.lab
    changed = {name for name in hidden.values if hidden.values[name] != bare.values[name]}
    assert changed == {"bias"}


def test_tight_tolerances_are_stated_for_the_same_lab():
    plan = Plan("none", (), 0.0)
    sound, tight = draw_case(plan, 4, 9), draw_case(plan, 4, 9, tight=2.5)
    assert tight.lab == sound.lab
    for name, knob in CALIBRATED.items():
        if knob != "c":  # which stays above zero
            error = sound.values[knob] - sound.lab.nominal[name]
            assert tight.values[knob] - tight.lab.nominal[name] == pytest.approx(2.5 * error, rel=1e-6)


def test_evidence_falls_with_the_magnitude_and_calibration_explains_its_part():
    found = {}
    for magnitude in (1.0, 0.1):
        case = draw_case(Plan("single", (HIDDEN["contact.cubic"],), magnitude), 3, 4)
        logs = [make_run(case, index) for index in range(3)]
        found[magnitude] = visibility(case, logs)
    # Twice ten times smaller is a hundred times less, to first order.
    assert 20.0 < found[1.0] / found[0.1] < 400.0
    # A wall displaced by a thousandth of its tolerance is nothing that logs could tell.
    case = draw_case(Plan("single", (HIDDEN["contact.wall-offset"],), 1e-5), 3, 4)
    assert visibility(case, [make_run(case, index) for index in range(3)]) < 0.1


def test_nobody_knows_what_is_drawn():
    case = draw_case(Plan("single", (HIDDEN["sensor.coloured-noise"],), 0.2), 3, 4)
    logs = [make_run(case, index) for index in range(3)]
    known, drawn = (visibility(case, logs, chance=chance) for chance in (False, True))
    hidden = case.hidden["sensor.coloured-noise"]
    deviation, keep = hidden["coloured"], hidden["coloured_keep"]
    turn = np.exp(-1j * np.pi * (np.arange(500) + 0.5) / 500.0)

    def process(deviation, keep):
        return deviation**2 * (1.0 - keep**2) / np.abs(1.0 - keep * turn) ** 2

    # Over the white noise and what little of its own the sensor of this rig colours.
    noise = 0.5**2 + 0.1**2 / 12.0 + process(case.plain["colour"], case.plain["colour_keep"])
    power = process(deviation, keep) / noise
    expected = 0.5 * 9000 * np.mean(power - np.log1p(power))
    assert drawn == pytest.approx(expected, rel=0.3)
    assert known > 1.2 * drawn


def test_what_roughness_explains_is_no_evidence(monkeypatch):
    case = draw_case(Plan("single", (HIDDEN["contact.cubic"],), 0.02), 3, 4)
    logs = [make_run(case, index) for index in range(3)]
    usual = visibility(case, logs)
    monkeypatch.setattr(evidence, "ROUGHNESS", {"load": 1e-9})
    assert visibility(case, logs) > 2.0 * usual


def test_little_coloured_noise_is_that_of_any_rig(monkeypatch):
    case = draw_case(Plan("single", (HIDDEN["sensor.coloured-noise"],), 0.06), 3, 4)
    logs = [make_run(case, index) for index in range(3)]
    reported = visibility(case, logs, chance=True)
    monkeypatch.setattr(evidence, "_COLOURS", ())
    assert visibility(case, logs, chance=True) > 1.5 * reported


def test_what_another_effect_imitates_cannot_be_distinguished_from_it():
    rivals = [HIDDEN[name] for name in ("contact.asymmetry", "contact.cubic", "sensor.drift")]
    found = {}
    for name, magnitude in (("structure.bend", 0.2), ("robot.cogging", 0.2)):
        case = draw_case(Plan("outside", (OUTSIDE[name],), magnitude), 3, 4)
        logs = [make_run(case, index) for index in range(3)]
        found[name] = (visibility(case, logs), *imitated(case, logs, rivals))
    reported, nearest = found["structure.bend"]
    assert reported > 100.0 and nearest.beyond < 0.1 * reported and nearest.like == ("contact.asymmetry",)
    reported, nearest = found["robot.cogging"]
    assert reported > 100.0 and 0.8 * reported < nearest.beyond <= reported


def test_two_effects_imitate_what_one_does_not():
    both = (HIDDEN["contact.asymmetry"], HIDDEN["structure.offset"])
    case = draw_case(Plan("pair", both, 0.4), 3, 4)
    logs = [make_run(case, index) for index in range(3)]
    one, two = imitated(case, logs, [*both, HIDDEN["contact.hertz"]], most=2)
    assert set(two.like) == {one.id for one in both} and one.like == two.like[:1]
    assert one.beyond > 50.0 and two.beyond < 0.05 * one.beyond


def test_coloured_noise_of_the_force_hides_what_is_slow():
    case = draw_case(Plan("single", (HIDDEN["sensor.drift"],), 0.3), 3, 4)
    logs = [make_run(case, index) for index in range(3)]
    reported = {}
    for colour in (0.0, 0.1):  # over white noise of 0.5 N
        same = replace(case, values={**case.values, "colour": colour}, plain={**case.plain, "colour": colour})
        reported[colour] = visibility(same, logs)
    # Of what hardly changes, as much as the power of noise near zero: 1 + 0.2^2 (1 + k)/(1 - k).
    keep = case.plain["colour_keep"]
    power = 1.0 + 0.25 / (0.25 + 0.1**2 / 12.0) * 0.2**2 * (1.0 + keep) / (1.0 - keep)
    assert reported[0.0] / reported[0.1] == pytest.approx(power, rel=0.1)


def test_what_is_hidden_beside_noise_tells_no_more_than_the_noise_lets_it():
    bias, steps, coloured, drift = (
        HIDDEN[f"sensor.{name}"] for name in ("bias", "quantisation", "coloured-noise", "drift")
    )
    plan = Plan("pair", (bias, steps), 1.0)
    case, rest = draw_case(plan, 3, 4), draw_case(replace(plan, effects=(steps,)), 3, 4)
    logs = [make_run(case, index) for index in range(3)]
    # Nobody knows the noise that carries a reading across a step: a bias is as good as a calibration's error.
    strayed = case.hidden["sensor.bias"]["bias"] / tolerances(case.lab)["force_bias"]
    assert visibility(case, logs, rest) == pytest.approx(0.5 * strayed**2, rel=0.1)
    reported = []
    for beside in ((), (coloured,)):
        plan = Plan("single", (drift, *beside), 0.3)
        case, rest = draw_case(plan, 3, 4), draw_case(replace(plan, effects=beside), 3, 4)
        reported.append(visibility(case, [make_run(case, index) for index in range(3)], rest))
    assert reported[0] > 5.0 * reported[1] > 0.0


def test_what_an_effect_shows_counts_from_what_the_lab_believes():
    """A sensor whose offset is what its lab takes it for says nothing, though the offset is an effect."""
    bare = draw_case(Plan("none", (), 0.0), 5, 5)
    width = tolerances(bare.lab)["force_bias"]
    strays = (bare.plain["bias"] - bare.lab.nominal["force_bias"]) / width

    def reported(by):
        effect = Hidden("sensor.bias", lambda rng, size: {"bias": by * width})
        case = draw_case(Plan("single", (effect,), 1.0), 5, 5)
        return visibility(case, [make_run(case, index) for index in range(3)])

    assert abs(strays) > 0.3 and reported(-strays) == 0.0
    for by in (6.0, -6.0):
        # Half the square of what the lab would have to be off by, less that of what it is off by.
        assert reported(by) == pytest.approx(0.5 * (strays + by) ** 2 - 0.5 * strays**2, rel=0.1)


def test_what_shows_in_the_first_ticks_alone_is_no_evidence(monkeypatch):
    """How the robot moved before a log began nobody has measured."""

    case = draw_case(Plan("none", (), 0.0), 5, 1)
    logs = [make_run(case, index) for index in range(3)]
    begun = replace(case, values={**case.values, "cold": 3.0, "cold_time": 3e-3})
    assert visibility(begun, logs) < 1.0
    monkeypatch.setattr(evidence, "_BEGIN", 0)
    assert visibility(begun, logs) > 20.0


def test_a_dent_of_the_derivatives_hides_no_imitation(monkeypatch):
    """What the force of a tool ripples by hides, nearby, that a later sensor does what a low-pass does."""
    filtered = Hidden("sensor.low-pass", lambda rng, size: {"filter_time": 2.335e-4})
    inertia = Hidden("sensor.tool-inertia", lambda rng, size: {"tool": 1.294})
    plan = Plan("pair", (filtered, inertia), 0.3)
    case, rest = draw_case(plan, 7, 8), draw_case(replace(plan, effects=(inertia,)), 7, 8)
    logs = [make_run(case, index) for index in range(3)]
    reported = visibility(case, logs, rest)
    monkeypatch.setattr(evidence, "_OPEN", (math.inf, math.inf))
    assert 0.0 < reported < 0.7 * visibility(case, logs, rest)


def test_of_a_pair_the_other_effect_may_have_any_size():
    """What a structure gives way to a force, a frame that softens more does for the most part, too."""
    plan = Plan("pair", (HIDDEN["contact.softening"], HIDDEN["structure.compliance"]), 0.9)
    case = draw_case(plan, 3, 4)
    logs = [make_run(case, index) for index in range(3)]
    rest = draw_case(replace(plan, effects=plan.effects[:1]), 3, 4)
    free = visibility(case, logs, rest)
    held = visibility(case, logs, replace(rest, plan=replace(plan, effects=())))
    assert 0.0 < free < 0.5 * held


def test_an_effect_imitates_itself():
    case = draw_case(Plan("single", (HIDDEN["contact.asymmetry"],), 0.4), 3, 4)
    logs = [make_run(case, index) for index in range(3)]
    (nearest,) = imitated(case, logs, [HIDDEN["contact.asymmetry"], HIDDEN["contact.hertz"]])
    assert nearest.like == ("contact.asymmetry",) and nearest.beyond < 0.03 * visibility(case, logs)


def test_plans_take_turns_and_avoid_ties():
    plans = plan_cases(200, 1, tuple(HIDDEN.values()), tuple(OUTSIDE.values()), pairs=True)
    counts = {
        kind: sum(plan.kind == kind for plan in plans) for kind in ("none", "single", "pair", "outside")
    }
    assert counts == {"none": 50, "single": 74, "pair": 38, "outside": 38}
    named = [plan.effects[0].id for plan in plans if plan.kind == "single"]
    assert set(named) == set(HIDDEN)
    pairs = [{one.id for one in plan.effects} for plan in plans if plan.kind == "pair"]
    assert all(len(pair) == 2 and not any(pair <= tied for tied in TIED) for pair in pairs)
    alike = sum(len({name.partition(".")[0] for name in pair}) == 1 for pair in pairs)
    assert alike == 19
    sizes = [plan.magnitude for plan in plans if plan.kind == "single"]
    assert min(sizes) < 0.08 and max(sizes) > 0.7


def test_finer_steps_move_what_is_measured_by_less_than_its_noise():
    case = draw_case(Plan("single", (HIDDEN["contact.viscoelastic"],), 1.0), 6, 3)
    log, plan = make_run(case, 0), RUNS[0]
    outs = [
        drive(case.lab, case.values, plan.mass, plan.speed, log, run_series(case, 0, case.values), substeps)
        for substeps in (40, 80, 320)
    ]
    coarse, fine = (np.abs(one - outs[2]) for one in outs[:2])
    assert coarse[2].max() < 0.01 * NOISE[0]
    assert coarse[3].max() < 0.1 * NOISE[1]
    assert fine[3].max() < 0.75 * coarse[3].max()
