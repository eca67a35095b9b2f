"""The experiment that is proposed breaks the tie: simulated with noise, the evidence falls to the cause."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orchestrator.config import Places
from orchestrator.diagnosis.rig.catalogue import catalogue
from orchestrator.diagnosis.rig.expected_evidence import chosen
from orchestrator.diagnosis.rig.experiments import expected_evidence, next_experiment, posterior
from orchestrator.diagnosis.rig.finding import Augmented
from orchestrator.diagnosis.rig.fit import Fitter
from orchestrator.diagnosis.rig.menu import MENU, Experiment, menu_of
from orchestrator.diagnosis.rig.predicted_runs import Chain, Trial
from orchestrator.diagnosis.rig.study import Role, _experiments
from orchestrator.diagnosis.rig.unsimulated_experiments import _ALONE
from tests.diagnosis.labs import Noisy, found, lab, model
from tests.extent import all_or

TIES = [
    (("sensor.delay",), (0.0004,), ("sensor.low-pass", "contact.damping")),
    (("sensor.low-pass",), (0.0006,), ("sensor.delay", "contact.damping")),
    (("contact.damping",), (-60.0,), ("sensor.delay",)),
    (("contact.stiffness",), (-0.1,), ("sensor.gain", "structure.compliance")),
    (("structure.compliance",), (8e-7,), ("sensor.gain", "contact.stiffness")),
    (("sensor.gain",), (-0.1,), ("contact.stiffness", "structure.compliance")),
    (("dynamics.mass-offset",), (0.3,), ("dynamics.mass",)),
    (("dynamics.mass",), (-0.1,), ("dynamics.mass-offset",)),
    (("robot.delay",), (0.0005,), ("robot.bandwidth", "robot.damping")),
]


def _named(name):
    return next(one for one in MENU if one.name == name)


# One of each place.
FEW = [TIES[0], TIES[3], TIES[6], TIES[8]]


@pytest.mark.parametrize(("ids", "theta", "ties"), all_or(FEW, TIES), ids=str)
def test_the_proposed_experiment_breaks_the_tie(ids, theta, ties):
    study = lab(ids, theta)
    reported = next_experiment(study, found(ids, theta, ties))
    assert reported["between"] == [*ids, *ties]
    assert (
        reported["expected_evidence"]
        == min(reported["evidence"].values())
        == reported["menu"][reported["name"]]
    )
    assert reported["expected_evidence"] > 10.0 and reported["then"] == ""
    assert reported["expected_evidence"] >= 0.95 * max(reported["menu"].values())
    # Made with noise, and every candidate fitted to old and new logs alike: the cause wins.
    experiment = _named(reported["name"])
    trial = Trial(study, experiment, model(ids, theta), [catalogue()[one] for one in (*ids, *ties)])
    costs = {}
    for name in (*ids, *ties):
        effect = catalogue()[name]
        chain = Chain((Chain.of(study, study.of(Role.TRAIN), (effect,)), Noisy(trial, 3)))
        fitter = Fitter(chain)
        signs = (1.0,) if effect.parameters[0].low == 0.0 else (1.0, -1.0)
        costs[name] = min(fitter.fit((effect,), None, sign * fitter.starts(effect)[0]).cost for sign in signs)
    for tie in ties:
        assert costs[tie] - costs[ids[0]] > reported["expected_evidence"] * 0.5


def test_what_tells_nothing_is_reported_to_tell_nothing():
    ids, theta = ("sensor.gain",), (-0.1,)
    study = lab(ids, theta)
    reported = next_experiment(study, found(ids, theta, ("contact.stiffness",)))
    for name in ("free-flight chirp", "slow reversals", "light satellite"):
        assert reported["menu"][name] < 1.0
    assert reported["menu"]["dead weights"] > 1000.0
    ids, theta = ("dynamics.mass-offset",), (0.3,)
    reported = next_experiment(lab(ids, theta), found(ids, theta, ("dynamics.mass",)))
    assert [name for name, value in reported["menu"].items() if value > 10.0] == ["off-axis contact"]


def test_no_tie_needs_no_experiment():
    ids, theta = ("robot.delay",), (0.002,)
    assert next_experiment(lab(ids, theta), found(ids, theta)) is None
    outside = replace(found(), candidates=(replace(found().candidates[0], effects=("outside",), model=None),))
    assert next_experiment(lab(), outside) is None


def test_an_experiment_of_ones_own_is_taken_where_it_is_best():
    ids, theta, tie = ("sensor.gain",), (-0.1,), ("contact.stiffness",)
    heavier = replace(_named("dead weights"), name="heavier weights", ticks=3000)
    reported = next_experiment(lab(ids, theta), found(ids, theta, tie), [*MENU, heavier])
    assert reported["name"] == "heavier weights"
    with pytest.raises(ValueError, match="no experiment to choose from"):
        next_experiment(lab(ids, theta), found(ids, theta, tie), [])


def test_of_experiments_that_are_as_good_the_cheapest_is_taken():
    ids, theta = ("sensor.gain",), (-0.1,)
    study, finding = lab(ids, theta), found(ids, theta, ("contact.stiffness",))
    weights, laser = _named("dead weights"), _named("dead weights with tip tracker")
    assert next_experiment(study, finding, [weights, laser])["name"] == weights.name
    assert next_experiment(study, finding, [laser, weights])["name"] == laser.name


def test_what_stays_tied_is_reported_with_the_experiment_for_it():
    ids, theta = ("structure.compliance",), (8e-7,)
    some = [_named("dead weights"), _named("slow reversals")]
    study, finding = lab(ids, theta), found(ids, theta, ("sensor.gain", "contact.stiffness"))
    reported = next_experiment(study, finding, some)
    assert reported["evidence"]["contact.stiffness"] < 10.0
    assert reported["expected_evidence"] < 10.0
    assert reported["leaves"] == [["structure.compliance", "contact.stiffness"]] and reported["then"] == ""


def test_rivals_are_reported_from_each_other_too():
    """One of them may be right, and the first candidate wrong."""
    ids, theta = ("sensor.gain",), (-0.1,)
    study, finding = lab(ids, theta), found(ids, theta, ("structure.compliance", "contact.stiffness"))
    weights, laser, both = map(_named, ("dead weights", "tip tracker", "dead weights with tip tracker"))
    reported = next_experiment(study, finding, [weights, laser, both])
    assert reported["name"] == both.name and reported["leaves"] == [] and reported["then"] == ""
    reported = next_experiment(study, finding, [weights, laser])
    assert reported["name"] == weights.name and reported["then"] == laser.name
    assert reported["leaves"] == [["structure.compliance", "contact.stiffness"]]


def test_what_is_tied_with_one_effect_of_two_stands_with_the_other_one():
    ids, theta = ("robot.delay", "sensor.gain"), (0.0005, -0.1)
    study, finding = lab(ids, theta), found(ids, theta, ("contact.stiffness",))
    assert next_experiment(study, finding) is None
    other = ("contact.stiffness", "robot.delay")
    rival = replace(
        finding.candidates[0], effects=other, probability=0.3, model=model(other, (-0.1, 0.0005)), ties=()
    )
    reported = next_experiment(study, replace(finding, candidates=(*finding.candidates, rival)))
    assert reported["between"] == ["robot.delay + sensor.gain", "contact.stiffness + robot.delay"]


def test_what_no_experiment_tells_apart_does_not_count():
    """Of three candidates the last two are the same in all experiments, and the first in one of them."""
    table = {
        "cheap": {(0, 1): 30.0, (0, 2): 20.0, (1, 2): 1.0},
        "dear": {(0, 1): 90.0, (0, 2): 80.0, (1, 2): 2.0},
    }
    asked = []

    def evidence(name, one, other):
        asked.append((name, one, other))
        return table[name][one, other]

    reported = chosen({"cheap": "a", "dear": "b"}, ["x", "y", "z"], evidence)
    assert reported["name"] == "dear" and reported["expected_evidence"] == 80.0
    assert reported["evidence"] == {"y": 90.0, "z": 80.0} and reported["menu"] == {
        "cheap": 20.0,
        "dear": 80.0,
    }
    assert reported["leaves"] == [["y", "z"]] and reported["then"] == ""
    # Nothing is asked twice.
    assert len(asked) == len(set(asked)) == 6
    table["cheap"][1, 2] = 15.0
    reported = chosen({"cheap": "a", "dear": "b"}, ["x", "y", "z"], evidence)
    assert reported["name"] == "cheap" and reported["expected_evidence"] == 15.0 and reported["leaves"] == []


def test_a_candidate_has_no_evidence_over_itself():
    ids, theta = ("sensor.delay",), (0.0004,)
    study = lab(ids, theta)
    one = posterior(study, model(ids, theta))
    for experiment in MENU:
        assert expected_evidence(study, experiment, one, one) == pytest.approx(0.0, abs=1e-6)


def test_rivals_of_some_probability_are_distinguished_too():
    study, ids, theta = lab(("robot.delay",), (0.0005,)), ("robot.delay",), (0.0005,)
    finding = found(ids, theta)
    other = replace(finding.candidates[0], effects=(), probability=0.02, model=finding.recalibrated)
    reported = next_experiment(study, replace(finding, candidates=(*finding.candidates, other)))
    assert reported["between"] == ["robot.delay", "none"]
    unlikely = replace(other, probability=0.001)
    assert next_experiment(study, replace(finding, candidates=(*finding.candidates, unlikely))) is None


def test_what_the_answer_leaves_lessens_the_evidence():
    ids, theta = ("sensor.gain",), (-0.1,)
    study, finding = lab(ids, theta), found(ids, theta, ("contact.stiffness",))
    some = [_named("dead weights")]
    clean, rough, elsewhere = (
        next_experiment(study, replace(finding, misfit=misfit), some)["expected_evidence"]
        for misfit in ({}, {"sensor": 4.0}, {"dynamics": 1e6})
    )
    assert rough == pytest.approx(clean / 4.0, rel=0.5) and elsewhere == clean


def test_of_what_draws_more_of_the_same_tells():
    finding = found()
    drawn = replace(finding.candidates[0], effects=("sensor.dropout",), model=None, log_evidence=40.0)
    other = replace(drawn, effects=("sensor.coloured-noise",), log_evidence=28.0)
    reported = next_experiment(lab(), replace(finding, candidates=(drawn, other)))
    assert reported["name"] == "the same runs again" and reported["expected_evidence"] == 12.0
    assert reported["between"] == ["sensor.dropout", "sensor.coloured-noise"]
    assert "4000 more ticks" in reported["description"]
    assert next_experiment(lab(), replace(finding, candidates=(drawn,)))["expected_evidence"] == 40.0


@pytest.mark.parametrize("place", _ALONE)
def test_an_unknown_effect_is_shown_by_itself(place):
    outside = replace(found().candidates[0], effects=("outside",), model=None)
    reported = next_experiment(lab(), replace(found(), candidates=(outside,), outside_place=place))
    assert reported["name"] in {one.name for one in MENU} and place in reported["description"]
    assert reported["expected_evidence"] is None and reported["between"] == ["outside", "none"]


def test_a_doubtful_calibration_is_measured_anew():
    strayed = Augmented({"natural_frequency": 480.0, "contact_stiffness": 177000.0}, (), np.zeros(0))
    reported = next_experiment(lab(), replace(found(recalibrated=strayed), doubtful_tolerances=True))
    assert reported["name"] == "free-flight chirp" and "robot" in reported["description"]


def test_a_study_names_experiments_of_its_own():
    study, ids, theta = lab(("sensor.gain",), (-0.1,)), ("sensor.gain",), (-0.1,)
    own = {"name": "soft and slow", "description": "ours", "rod": 0.1, "approach_speed": 0.01}
    listed = menu_of(replace(study, experiments=(own,)))
    assert listed[:-1] == MENU and listed[-1] == Experiment(**own)
    hammer = {"name": "hammer", "description": "our own"}
    assert [one.name for one in menu_of(replace(study, experiments=(hammer,)))].count("hammer") == 1
    reported = next_experiment(
        replace(study, experiments=(own,)), found(ids, theta, ("contact.stiffness",)), None
    )
    assert "soft and slow" in reported["menu"]


def test_wrong_experiments_of_a_study_are_all_reported():
    problems = []
    entries = [{"name": "a", "mass": "500 kg", "rods": 2}, {"mass": "1 kg"}, {"name": "b", "ticks": 1.5}]
    entries.append({"name": "c", "approach_speed": "3 kg"})
    first, *_ = _experiments(entries, Places("study.yaml"), problems)
    assert first == {"name": "a", "description": "", "mass": 500.0}
    assert [one.place.removeprefix("study.yaml: experiments") for one in problems] == [
        "[0].rods", "[1]", "[2].ticks", "[3].approach_speed"
    ]  # fmt: skip
