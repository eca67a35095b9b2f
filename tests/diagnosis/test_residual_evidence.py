"""Evidence in the residual of an answer, and its effect on the probability of an unknown effect."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from orchestrator.diagnosis.rig.answers import Answer, Group, complete
from orchestrator.diagnosis.rig.any_law import any_law
from orchestrator.diagnosis.rig.calibration import SET, Calibration, own_gains
from orchestrator.diagnosis.rig.catalogue import catalogue
from orchestrator.diagnosis.rig.challenge.draw import Plan
from orchestrator.diagnosis.rig.challenge.outside import OUTSIDE
from orchestrator.diagnosis.rig.coloured_noise import WHITE, Colour
from orchestrator.diagnosis.rig.fit import Fitter
from orchestrator.diagnosis.rig.hardware import weigh_rig
from orchestrator.diagnosis.rig.local_structure import loudest, repeated
from orchestrator.diagnosis.rig.marginal import Marginal
from orchestrator.diagnosis.rig.misfit import in_contact, stretches, uneven, unexplained
from orchestrator.diagnosis.rig.model import RigModel
from orchestrator.diagnosis.rig.nuisance import Weighing, touching
from orchestrator.diagnosis.rig.residual_evidence import excess_deviation
from orchestrator.diagnosis.rig.study import Role
from orchestrator.diagnosis.rig.weigh import conclude
from tests.benchmarks.rig_calibration import learning
from tests.benchmarks.rig_calibration.learning import WeighedCase, learn_sure
from tests.benchmarks.rig_calibration.simulated_cases import bare_study, simulated_study
from tests.diagnosis.rigs import study
from tests.diagnosis.test_weigh import own_study


def touched(ticks: int = 3000) -> np.ndarray:
    """Contacts of 30 ticks, of which every 150 one begins."""
    return np.arange(ticks) % 150 < 30


def test_what_a_contact_law_lacks_is_seen_in_the_contacts():
    rng = np.random.default_rng(7)
    shape = 0.9 * np.sin(2.0 * np.pi * np.arange(30) / 30.0)
    plain = [rng.standard_normal(3000) for _ in range(3)]
    lacking = [r.copy() for r in plain]
    for r in lacking:
        r[touched()] += np.tile(shape, 20)
    masks = [touched()] * 3
    assert in_contact(plain, masks) < 5.0 and in_contact(lacking, masks) > 100.0
    assert unexplained(lacking) < 0.5 * in_contact(lacking, masks)  # it drowns in the run
    # A noise that is as large out of contact is nothing of the contact's.
    assert in_contact([1.3 * r for r in plain], masks) < 5.0
    assert in_contact([np.full(3000, np.inf)] * 3, masks) == np.inf
    assert in_contact(plain, [np.zeros(3000, bool)] * 3) == 0.0


def test_what_happens_once_or_in_every_contact_is_seen():
    rng = np.random.default_rng(9)
    plain = [rng.standard_normal(3000) for _ in range(3)]
    struck, again = [r.copy() for r in plain], [r.copy() for r in plain]
    struck[1][1000:1008] *= 5.0
    for r in again:
        r[touched()] += np.tile(np.sin(np.arange(30) / 5.0), 20)
    masks = [touched()] * 3
    assert loudest(plain) < 3.0 and loudest(struck) > 20.0
    assert repeated(plain, masks) < 5.0 and repeated(again, masks) > 50.0


@pytest.mark.parametrize("noise", [1.0, 1.3, 2.0])
def test_a_louder_noise_is_nothing_that_contacts_repeat(noise):
    rng = np.random.default_rng(8)
    touching = [np.arange(3000) % 150 < 40] * 3
    runs = [noise * rng.standard_normal(3000) for _ in touching]
    assert repeated(runs, touching) < 12.0
    shape = 1.5 * noise * np.exp(-(np.arange(3000) % 150) / 5.0)
    assert repeated([r + shape for r in runs], touching) > 40.0


def test_a_noise_that_is_half_as_large_again_is_no_structure():
    rng = np.random.default_rng(8)
    white = [rng.standard_normal(3000) for _ in range(3)]
    assert unexplained([1.2 * r for r in white]) < 5.0  # 1.44 times the square
    assert unexplained([1.4 * r for r in white]) > 50.0
    slow = [r + 0.5 * np.sin(np.arange(3000) / 60.0) for r in white]
    assert unexplained(slow) > 50.0


def test_noise_that_comes_and_goes_is_no_noise():
    rng = np.random.default_rng(9)
    colour = [lfilter([np.sqrt(1.0 - 0.95**2)], [1.0, -0.95], rng.standard_normal(2500)) for _ in range(3)]
    bumps = [np.zeros(2500) for _ in range(3)]
    for r in bumps:
        for first in rng.integers(0, 2400, 6):
            r[first : first + 40] += 4.0 * np.hanning(40)
    white = [rng.standard_normal(2500) for _ in range(3)]
    assert uneven([a + b for a, b in zip(colour, white, strict=True)], (8, 20)) < 3.0
    assert uneven([a + b for a, b in zip(bumps, white, strict=True)], (8, 20)) > 30.0
    assert uneven([], (8,)) == uneven([np.zeros(2500)], (8,)) == 0.0


def test_a_combination_makes_something_outside_likelier_than_one_effect_does():
    learned = Calibration(several=2.0, floor=0.0)
    none, left = Answer((), 0.0, 500.0), 20.0
    one = learned.probabilities([none, Answer(("a.x",), 90.0, left)], 0.0)[-1]
    two = learned.probabilities([none, Answer(("a.x", "a.y"), 90.0, left)], 0.0)[-1]
    plain = replace(learned, several=0.0).probabilities([none, Answer(("a.x", "a.y"), 90.0, left)], 0.0)[-1]
    assert plain == pytest.approx(one, rel=1e-6)
    assert two / (1.0 - two) == pytest.approx(np.exp(2.0) * one / (1.0 - one), rel=0.05)


def test_what_a_weak_effect_leaves_is_a_share_of_its_own_evidence():
    learned = Calibration(floor=0.0, leaves={"a.strong": 1e-4, "a.weak": 0.03})
    none, strong = Answer((), 0.0, 4e4), Answer(("a.strong",), 4e4, 1700.0)
    both = Answer(("a.strong", "a.weak"), 40_200.0, 1500.0)
    faint = replace(both, effects=("a.faint", *both.effects), unseen=("a.faint",))
    answers = [none, strong, both, faint]
    assert own_gains(answers)[1:] == [
        {"a.strong": 4e4},
        {"a.strong": 40_200.0, "a.weak": 200.0},
        {"a.strong": 40_200.0, "a.weak": 200.0},
    ]
    assert learned.usual(answers).tolist() == pytest.approx([1.0, 5.0, 7.0, 7.0], rel=0.01)
    # What is left is not made usual by the weak effect, which accounts for none of it.
    assert learned.probabilities(answers, 0.0)[-1] > 0.5
    alone = Answer(("a.weak",), 4e4, 1500.0)
    assert learned.probabilities([none, alone], 0.0)[-1] < 0.1


def test_what_a_replay_s_own_error_may_leave_is_nothing_outside():
    learned = Calibration(form=1.0, floor=0.0, leaves={"a.x": 1e-4})
    none, lacking = Answer((), 0.0, 1e9), Answer(("a.x",), 1e7, 4e5)

    def outside(one):
        return learned.probabilities([none, one], 0.0)[-1]

    assert outside(lacking) > 0.5 and outside(replace(lacking, numerics=1.5e5)) < 0.01
    # An imitation that swings up and explains next to nothing is none the more likely for it.
    weak = replace(lacking, gain=20.0)
    assert outside(replace(weak, numerics=1.5e5)) > 0.99 * outside(weak) > 0.5
    # Of what such a replay leaves another effect mends much by chance: that is little evidence.
    both = Answer(("a.x", "a.y"), 1e7 + 2e4, 3.9e5)
    for numerics, likely in ((0.0, True), (1.5e5, False)):
        p = learned.probabilities([none, *(replace(one, numerics=numerics) for one in (lacking, both))], 0.0)
        assert (p[2] > p[1]) == likely


def test_what_is_odd_counts_whatever_evidence_there_is():
    learned = Calibration(floor=0.0, leaves={"a.x": 0.05})
    none = Answer((), 0.0, 500.0)

    def outside(gain, left=0.0, nonrandom=0.0):
        return learned.probabilities([none, Answer(("a.x",), gain, left, nonrandom=nonrandom)], 0.0)[-1]

    def odds(p):
        return p / (1.0 - p)

    # Of a strong effect much may be left since its form is not the catalogue's; but chance is chance.
    assert outside(5e4, left=60.0) < 0.1 * outside(90.0, left=60.0)
    for gain in (90.0, 5e4):
        assert odds(outside(gain, nonrandom=6.0)) == pytest.approx(
            np.exp(6.0) * odds(outside(gain)), rel=1e-3
        )


def test_three_effects_make_something_outside_likelier_by_what_was_learned_of_them():
    names, none = ("a.x", "a.y", "a.z"), Answer((), 0.0, 500.0)
    few, many = (Calibration(several=1.0, many=size, floor=0.0) for size in (1.0, 3.0))
    for count, apart in ((1, 0.0), (2, 0.0), (3, 2.0)):
        answers = [none, Answer(names[:count], 90.0, 20.0)]
        odds = [p / (1.0 - p) for p in (one.probabilities(answers, 0.0)[-1] for one in (few, many))]
        assert np.log(odds[1] / odds[0]) == pytest.approx(apart, abs=1e-6)


def test_a_small_law_that_no_catalogue_holds_is_seen_along_its_shapes():
    own = study(ticks=3000)
    rng = np.random.default_rng(4)
    laws = {}
    for name, size in (("none", 0.0), ("hysteresis", 0.003)):
        runs = []
        for run in own.runs:
            force = run["sensor_force"]
            noise = 0.5 * rng.standard_normal(len(force))
            back = np.tanh(np.gradient(force, 0.001) * np.sign(force) / 2e3)
            columns = dict(run.columns, sensor_force=force + noise + size * force * back)
            runs.append(replace(run, columns=columns))
        model = RigModel(replace(own, runs=tuple(runs)), runs)
        weighing = Weighing.of(model, [], {})
        fitter, weights = weighing.fitter(), weighing.weights
        fit = fitter.fit(())
        laws[name] = any_law(model, fitter, fit, weights, WHITE)[1]
        beside = any_law(model, fitter, fit, weights, Colour(0.4, 0.95, 100.0))[1]
        # The noise is white: a colour that hardly explains more does not hide the law.
        instead = any_law(model, fitter, fit, weights, Colour(0.4, 0.95, 1.0))[1]
        drowned = in_contact(fitter.marginal.left(fit.residuals)[1::2], touching(model, fit))
        assert beside <= laws[name]
        if name == "hysteresis":
            assert laws[name] > 2.0 * drowned
            assert beside < 0.5 * instead and instead > laws[name] - 2.0
    assert laws["none"] < 2.0 and laws["hysteresis"] > 20.0


def test_a_slow_law_is_seen_though_calibration_and_an_effect_take_up_most_of_it():
    own = study(ticks=3000)
    rng = np.random.default_rng(5)
    runs, share = [], 1.0 - np.exp(-0.001 / 2.0)
    for run in own.runs:
        force = run["sensor_force"]
        warmed = 0.015 * lfilter([share], [1.0, share - 1.0], np.abs(force))
        columns = dict(run.columns, sensor_force=force + warmed + 0.5 * rng.standard_normal(len(force)))
        runs.append(replace(run, columns=columns))
    model = RigModel(replace(own, runs=tuple(runs)), runs)
    weighing = Weighing.of(model, [], {})
    fitter = weighing.fitter()
    fit = fitter.fit((catalogue()["sensor.drift"],))
    forces = fitter.marginal.left(fit.residuals)[1::2]
    law = any_law(model, fitter, fit, weighing.weights, WHITE)[1]
    drowned = max(unexplained(forces), in_contact(forces, touching(model, fit)))
    assert law > 8.0 and law > 2.0 * drowned, drowned


def _bristles(run, rng):
    """A soft push before the front frame; the rod does not touch there."""
    force, x = run["sensor_force"], run["encoder_position"]
    gap = x[force < -2.0].min() - x
    return {"sensor_force": force - 1.5 * np.exp(-np.maximum(gap, 0.0) / 3e-4) * (gap > 0.0)}


def _unsettled(run, rng):
    """Another zero in each contact."""
    force = run["sensor_force"].copy()
    for contact in stretches(np.abs(force) > 2.0):
        force[contact] += 0.6 * rng.standard_normal()
    return {"sensor_force": force}


def _leaking(run, rng):
    """The force leaks away in seconds."""
    force = run["sensor_force"]
    return {"sensor_force": force - 0.03 * 0.001 * np.cumsum(force)}


def _dragging(run, rng):
    """The servo is held back by the square of its speed."""
    x = run["encoder_position"]
    v = np.gradient(x, 0.001)
    a, b = 2.0 * 0.7 * 50.0, 50.0**2
    held = lfilter([1e-6], [1.0 + 0.001 * a + 1e-6 * b, -2.0 - 0.001 * a, 1.0], 25.0 * v * np.abs(v))
    return {"encoder_position": x - held}


@pytest.mark.parametrize("law", [None, _bristles, _unsettled, _leaking, _dragging])
def test_laws_at_the_ends_of_contacts_in_their_wake_and_in_the_servo_are_seen(law):
    own = study(ticks=3000)
    rng = np.random.default_rng(7)
    runs = []
    for run in own.runs:
        columns = {**run.columns, **(law(run, rng) if law else {})}
        columns["sensor_force"] = columns["sensor_force"] + 0.5 * rng.standard_normal(3000)
        columns["encoder_position"] = columns["encoder_position"] + 2e-6 * rng.standard_normal(3000)
        runs.append(replace(run, columns=columns))
    model = RigModel(replace(own, runs=tuple(runs)), runs)
    weighing = Weighing.of(model, [], {})
    fitter = weighing.fitter()
    moved, pushed = any_law(model, fitter, fitter.fit(()), weighing.weights, WHITE)
    assert (moved > 8.0) == (law is _dragging), moved
    assert (pushed > 8.0) == (law not in (None, _dragging)), pushed


def test_shapes_count_by_what_is_left_of_them_beside_roughness_and_what_a_fit_chose():
    rng = np.random.default_rng(6)
    rough, raw = rng.standard_normal((60, 3)), 5.0 * rng.standard_normal((60, 2))
    columns, residuals = rng.standard_normal((40, 4)), [rng.standard_normal(30), rng.standard_normal(30)]
    rows = np.arange(20, 60)
    marginal = Marginal(2.0, rough)
    chosen = np.column_stack([marginal.stacked([one]) for one in raw.T])
    full = np.zeros((60, 4))
    full[rows] = columns
    noise = np.eye(60) + rough @ rough.T / 2.0
    spread = raw / np.sqrt(2.0)
    beside = np.linalg.inv(noise + spread @ spread.T)
    before = np.concatenate(residuals) / np.sqrt(2.0)
    best = np.linalg.solve(
        spread.T @ np.linalg.solve(noise, spread) + np.eye(2), spread.T @ np.linalg.solve(noise, before)
    )
    # Wherever a fit ends, residuals are what is left at the best.
    for z in (-best, np.zeros(2), np.ones(2)):
        ended = np.split(np.sqrt(2.0) * (before + spread @ z), 2)
        square, product = marginal.products(ended, columns, rows, chosen, z)
        assert square == pytest.approx(full.T @ beside @ full, rel=1e-9)
        assert product == pytest.approx(full.T @ beside @ before, rel=1e-9)
    left = np.linalg.solve(noise, before - spread @ best)
    assert product == pytest.approx(full.T @ left, rel=1e-9)


def test_what_only_imitates_bends_the_calibration():
    fit = Fitter(RigModel(study(), study().of(Role.TRAIN))).fit(())
    usual = replace(fit, deviation=dict.fromkeys(fit.deviation, 1.1))
    walls = replace(fit, deviation={**usual.deviation, "front_wall": 3.5, "rear_wall": -4.7})
    assert excess_deviation(usual) == 0.0 and excess_deviation(walls) > 8.0


def test_sets_hold_more_where_nothing_is_seen():
    ids = [f"a.{number}" for number in range(20)]
    learned = Calibration(sure=0.99, unseen=dict.fromkeys(ids, 0.05))
    nothing = Fitter(RigModel(study(), study().of(Role.TRAIN))).fit(())
    none = Answer((), 0.0, 0.0, nothing)
    groups = {
        "nothing": Group(tuple(complete([none], ids)), 0.0, "sensor", nothing),
        "one": Group(tuple(complete([none, Answer(("a.3",), 90.0, 0.0)], ids)), 0.0, "sensor", nothing),
    }
    for name, level in (("nothing", 0.99), ("one", SET)):
        found = conclude([groups[name]], learned)
        held = [one.probability for one in found.candidates[: len(found.answer_set)]]
        assert sum(held) >= level > sum(held[:-1])


def test_nothing_but_something_outside_may_be_worth_a_word():
    nothing = Fitter(RigModel(study(), study().of(Role.TRAIN))).fit(())
    found = conclude([Group((Answer((), 0.0, 1e15, nothing),), 0.0, "robot", nothing)], Calibration())
    assert found.effects == ("outside",) and found.answer_set == ("outside",) and found.places == ("robot",)


def test_how_much_sets_hold_is_learned_from_what_stays_unseen(monkeypatch):
    ids = [f"a.{number}" for number in range(12)]

    def case(number: int, pairs: bool) -> WeighedCase:
        """Most rigs hide nothing; the others one effect, or two in a quarter of them. Nothing is seen."""
        one, other = ids[number % 12], ids[(number + 5) % 12]
        truth = () if number % 6 else tuple(sorted((one, other))) if pairs and number % 24 == 0 else (one,)
        return WeighedCase(truth, 0.02, tuple(complete([Answer((), 0.0, 0.0)], ids)), 0.0)

    found = []
    for pairs in (False, True):
        cases = [case(number, pairs) for number in range(360)]
        monkeypatch.setattr(learning, "SHARES", Counter(one.kind for one in cases))  # as many as are planned
        found.append(learn_sure(cases, Calibration())["sure"])
    seldom, often = found
    assert SET <= seldom < often <= 0.995


def test_an_acceleration_limit_is_proposed_where_the_motion_shows_it():
    propose = catalogue()["robot.acceleration-limit"].propose
    assert propose is not None
    for limit in (0.08, 0.2):
        own = own_study(["robot.acceleration-limit"], [limit])
        starts = propose(RigModel(own, own.of(Role.TRAIN)).seen({}, (), np.zeros(0)))
        assert min(abs(start / limit - 1.0) for (start,) in starts) < 0.01
    own = own_study()
    starts = propose(RigModel(own, own.of(Role.TRAIN)).seen({}, (), np.zeros(0)))
    # Where it does not show, it lies below what the servo takes for a moment after each command: omega^2 v h.
    jump = own.nominal["natural_frequency"].value ** 2 * 0.02 * own.tick
    assert all(0.1 * jump < start < jump for (start,) in starts) and len(starts) > 1


def test_frames_that_stand_elsewhere_each_time_are_outside():
    plan = Plan("single", (OUTSIDE["contact.wall-scatter"],), 0.06)
    scattered, _ = simulated_study(8, 2, plan=plan)  # by about 6 micrometres
    found = weigh_rig(scattered).answers[0]
    assert found.effects == () and 20.0 < found.left
    assert weigh_rig(bare_study(8, 2)).answers[0].left < 10.0
