"""Residual evidence of answers in held-out runs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orchestrator.diagnosis.rig.calibration import calibration
from orchestrator.diagnosis.rig.catalogue import catalogue
from orchestrator.diagnosis.rig.challenge.draw import Plan
from orchestrator.diagnosis.rig.challenge.hidden import HIDDEN
from orchestrator.diagnosis.rig.coloured_noise import WHITE
from orchestrator.diagnosis.rig.descent import cost_of
from orchestrator.diagnosis.rig.diagnose import diagnose
from orchestrator.diagnosis.rig.fit import Fitter
from orchestrator.diagnosis.rig.hardware import weigh_rig
from orchestrator.diagnosis.rig.held_out import Judge
from orchestrator.diagnosis.rig.model import RigModel
from orchestrator.diagnosis.rig.nuisance import Weighing, force_weights
from orchestrator.diagnosis.rig.report_text import text
from orchestrator.diagnosis.rig.residual_evidence import ResidualEvidence
from orchestrator.diagnosis.rig.search import search
from orchestrator.diagnosis.rig.study import Role
from orchestrator.diagnosis.rig.weigh import conclude
from tests.benchmarks.rig_calibration.simulated_cases import bare_study, simulated_study

HALF = len(ResidualEvidence._fields)


@pytest.fixture(scope="module")
def bare():
    return bare_study(31, 2)


def pulled(study, size, roles):
    """A cable pulls at the sensor, in proportion to the position [N/m], in runs of some roles."""
    runs = [
        replace(
            run, columns=dict(run.columns, sensor_force=run["sensor_force"] - size * run["encoder_position"])
        )
        if run.role in roles
        else run
        for run in study.runs
    ]
    return replace(study, runs=tuple(runs))


def judged(study, runs):
    """A judge of a study's train runs, and of others."""
    model = RigModel(study, study.of(Role.TRAIN))
    weighing = Weighing.of(model, [catalogue()["sensor.gain"]], {})
    fitter = weighing.fitter()
    none = fitter.fit(())
    return Judge(weighing, fitter, WHITE).over(runs, none, 1.0, False), none


def outside(group):
    return calibration().probabilities(group.answers, group.outside)[-1]


def test_runs_that_no_fit_saw_tell_of_what_train_runs_hardly_show(bare):
    everywhere = pulled(bare, 15.0, Role)
    alone = replace(everywhere, runs=everywhere.of(Role.TRAIN))
    some, every = weigh_rig(alone), weigh_rig(everywhere)
    pushed = ResidualEvidence._fields.index("pushed")
    here = every.answers[0].parts
    assert here[HALF + pushed] > 1.5 * max(here[pushed], some.answers[0].parts[pushed]) + 5.0
    assert outside(every) > max(outside(some), 0.5)
    # Where there are no others, all runs are those that were seen.
    assert some.answers[0].parts[:HALF] == some.answers[0].parts[HALF:]


def test_nothing_is_fitted_to_them(bare):
    plain, other = (weigh_rig(pulled(bare, size, (Role.HELDOUT, Role.REPEAT))) for size in (0.0, 300.0))
    gains = [{one.effects: one.gain for one in group.answers} for group in (plain, other)]
    assert gains[0] == gains[1]
    for one, two in zip(plain.answers, other.answers, strict=True):
        assert (one.fit is None) == (two.fit is None)
        if one.fit is not None:
            assert np.array_equal(one.fit.theta, two.fit.theta) and one.fit.calibrated == two.fit.calibrated
    assert plain.answers[0].parts[:HALF] == pytest.approx(other.answers[0].parts[:HALF], abs=0.5)
    assert outside(other) > 0.9 > outside(plain)


def test_an_effect_that_was_fitted_foresees_them():
    study, _ = simulated_study(31, 3, plan=Plan("single", (HIDDEN["contact.hertz"],), 0.8))
    model = RigModel(study, study.of(Role.TRAIN))
    weighing = Weighing.of(model, [], {})
    fitter = weighing.fitter()
    none, right = fitter.fit(()), fitter.fit((catalogue()["contact.hertz"],))
    judge = Judge(weighing, fitter, WHITE).over(study.runs, right, 1.0, False)
    lacking, foreseen = judge.leaves(none).total, judge.leaves(right).total
    assert lacking > 300.0 and foreseen < 0.1 * lacking


def test_a_model_carried_to_other_runs_goes_one_step_and_strays_as_before(bare):
    train, every = (Fitter(RigModel(bare, runs)) for runs in (bare.of(Role.TRAIN), bare.runs))
    fit = train.fit((catalogue()["sensor.gain"],))
    here, derivatives = every.carried(fit, train)
    r = every.stacked(fit.effects, fit.z)
    assert derivatives.shape == (r.size, len(fit.z))
    assert here.cost < r @ r + fit.z @ fit.z and len(here.residuals) == 2 * len(bare.runs)
    assert here.deviation == fit.deviation and np.abs(here.z - fit.z).max() > 0.0
    # What is best already stays: but for the noise of derivatives, there is no step to take.
    again, _ = train.carried(fit, train)
    assert again.cost == pytest.approx(fit.cost, abs=0.3)


def test_what_no_derivative_tells_moves_within_what_the_train_runs_leave_open():
    """Of the phase of rounded commands runs tell a range, within which others are rounded otherwise."""
    study, _ = simulated_study(6, 3, plan=Plan("single", (HIDDEN["robot.command-quantisation"],), 0.9))
    train, every = (Fitter(RigModel(study, runs)) for runs in (study.of(Role.TRAIN), study.runs))
    fit = search(train, [catalogue()["robot.command-quantisation"]], longest=1).best
    count = len(fit.deviation)
    here, _ = every.carried(fit, train)

    def cost(fitter, z):
        return cost_of(fitter.stacked(fit.effects, z), z)

    moved = np.concatenate([fit.z[:count], here.z[count:]])
    assert 0.0 < np.abs(moved - fit.z).max() < 0.1
    assert cost(every, moved) < cost(every, fit.z) - 20.0
    assert cost(train, moved) < fit.cost + 2.0


def test_what_a_fit_leaves_is_looked_at_once(bare, monkeypatch):
    judge, none = judged(bare, bare.runs)
    first = judge.leaves(none)
    monkeypatch.setattr(Fitter, "carried", lambda *_: pytest.fail("again"))
    assert judge.leaves(none) is first
    changed = first.changed(rough=7.0)
    assert changed.seen.rough == changed.every.rough == 7.0 and changed.parts[:2] == first.parts[:2]


def test_samples_that_were_lost_tell_nothing_and_louder_ones_less(bare):
    run = bare.runs[0]
    force = run["sensor_force"].copy()
    force[100] = force[99]
    run = replace(run, columns=dict(run.columns, sensor_force=force))
    (moves, plain), (_, weights) = (force_weights([run], *one) for one in ((1.0, False), (2.0, True)))
    assert weights[100] == 0.0 and plain[100] == moves[100] == 1.0
    kept = np.diff(force, prepend=np.nan) != 0.0
    assert np.array_equal(weights[kept], 0.5 * plain[kept])


@pytest.mark.parametrize(("seed", "number", "size", "seen"), [(31, 3, 0.12, False), (991, 101, 0.6, True)])
def test_runs_that_alone_reach_a_limit_judge_nothing_and_the_diagnosis_says_so(seed, number, size, seen):
    """Nor do such as reach one far deeper than those that it was fitted to: it is not known so well."""
    study, _ = simulated_study(seed, number, plan=Plan("single", (HIDDEN["robot.rate-limit"],), size))
    group = weigh_rig(study)
    assert any(one.effects == ("robot.rate-limit",) and one.gain > 100.0 for one in group.answers) == seen
    assert group.unjudged.startswith("they reach a limit that the train runs do not, or hardly do")
    assert all(one.parts[:HALF] == one.parts[HALF:] for one in group.answers if one.fit is not None)
    alone = replace(study, runs=study.of(Role.TRAIN))
    assert weigh_rig(alone).unjudged == ""
    reported = diagnose(study, parts={"weigh": lambda _: conclude([group], calibration())})
    assert f"left out: judging by held out runs: {group.unjudged}" in text(reported)
