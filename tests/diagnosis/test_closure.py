"""How far the gap shrinks: near 1 with the right effect, near 0 with a wrong one, null without a gap."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from orchestrator.diagnosis.rig.closure import MEASURES, closure_of, how_far, one_contact_ahead
from orchestrator.diagnosis.rig.finding import Augmented
from orchestrator.diagnosis.rig.model import RigModel
from orchestrator.diagnosis.rig.motion import contacts
from orchestrator.diagnosis.rig.numerics import numerics
from orchestrator.diagnosis.rig.report import remarks
from orchestrator.diagnosis.rig.rig import SUBSTEPS
from orchestrator.diagnosis.rig.software import ControllerReplay, DynamicsReplay
from orchestrator.diagnosis.rig.study import Role
from orchestrator.diagnosis.rig.verdict import Gap, Numerics
from tests.diagnosis.labs import NONE, found, lab

CAUSES = [
    (("robot.delay",), (0.002,)),
    (("contact.hertz",), (0.3, 5e-4)),
    (("sensor.gain",), (0.15,)),
    (("controller.lead",), (0.001,)),
    (("dynamics.drag",), (80.0,)),
]
KEYS = {"before", "after", "recalibrated", "noise_floor", "closure", "interval", "recalibration_only"}


@pytest.mark.parametrize(("ids", "theta"), CAUSES, ids=str)
def test_the_right_effect_closes_the_gap(ids, theta):
    reported = how_far(lab(ids, theta), found(ids, theta))
    assert set(reported) >= KEYS and set(reported["full_run"]) >= KEYS
    assert 0.95 < reported["closure"] < 1.05
    assert reported["interval"][0] <= reported["closure"] <= reported["interval"][1]
    assert reported["after"] == pytest.approx(reported["noise_floor"], rel=0.15)
    assert not reported["within_floor"]
    # The lab is calibrated: without the effect nothing is gained.
    assert reported["recalibration_only"] == 0.0
    if ids != ("robot.delay",):  # which two runs of the same rig hide: they fall apart by as much
        assert reported["full_run"]["closure"] > 0.8
    assert set(reported["measures"]) == set(reported["full_run"]["measures"]) == set(MEASURES)
    assert reported["measures"]["nrmse"]["closure"] == reported["closure"]


@pytest.mark.parametrize(
    ("wrong", "theta"), [(("sensor.bias",), (0.05,)), (("robot.bandwidth",), (3.0,))], ids=str
)
def test_a_wrong_effect_closes_nothing(wrong, theta):
    reported = how_far(lab(("contact.hertz",), (0.3, 5e-4)), found(wrong, theta))
    assert abs(reported["closure"]) < 0.1


def test_an_effect_of_half_its_size_closes_half():
    reported = how_far(lab(("sensor.gain",), (0.16,)), found(("sensor.gain",), (0.08,)))
    assert 0.4 < reported["closure"] < 0.65


def test_recalibration_is_reported_beside_the_effect():
    bent = Augmented({"contact_stiffness": 176000.0 * 1.15}, (), np.zeros(0))
    reported = how_far(lab(("sensor.gain",), (0.15,)), found(("sensor.gain",), (0.15,), recalibrated=bent))
    # A gain of the sensor and a stiffer contact look alike.
    assert reported["recalibration_only"] > 0.9 and reported["closure"] > 0.95


def test_a_gap_within_the_noise_has_no_closure():
    reported = how_far(lab(), found())
    assert reported["within_floor"] and reported["closure"] is None and reported["interval"] is None
    assert reported["before"] == pytest.approx(reported["noise_floor"], rel=0.15)


def test_without_repeats_the_noise_of_the_sensor_is_the_floor():
    study = lab(("sensor.gain",), (0.15,))
    alone = replace(study, runs=tuple(run for run in study.runs if run.role is not Role.REPEAT))
    full, reported = (how_far(one, found(("sensor.gain",), (0.15,))) for one in (study, alone))
    assert reported["noise_floor"] == pytest.approx(full["noise_floor"], rel=0.3)
    assert reported["closure"] > 0.95


def test_without_held_out_runs_nothing_is_reported():
    study = lab()
    alone = replace(study, runs=study.of(Role.TRAIN))
    reported = how_far(alone, found())
    assert (
        reported["closure"] is None and reported["before"] is None and reported["full_run"]["before"] is None
    )


def test_the_interval_is_the_same_every_time():
    study, finding = lab(("contact.hertz",), (0.3, 5e-4)), found(("contact.hertz",), (0.3, 5e-4))
    assert how_far(study, finding) == how_far(study, finding)


def test_a_model_that_runs_away_is_held_at_the_stop():
    runaway = found(("controller.stiffness-gain",), (-0.9,))
    reported = how_far(lab(), runaway)
    assert all(np.isfinite(reported["full_run"][key]) for key in ("before", "after", "noise_floor"))


def replay_error(study, run):
    """Largest departure of the nominal model's replays from a log, of any signal, SI."""
    rig = RigModel(study, [run]).replay(0, {})
    controller, _ = ControllerReplay(study, [run]).replay(0, (), np.zeros(0))
    dynamics = DynamicsReplay(study, [run])
    strayed = (
        run["encoder_position"] - rig[2],
        run["sensor_force"] - rig[3],
        run["compensated_force"] - controller[0],
        dynamics.residuals({}, (), np.zeros(0))[0] * dynamics.noise[0],
    )
    return max(float(np.abs(one).max()) for one in strayed)


def test_a_log_of_the_nominal_system_replays_exactly():
    study = lab(noise=0.0)
    for run in study.runs:
        assert replay_error(study, run) <= 1e-9


@pytest.mark.parametrize("column", ["sensor_force", "encoder_position", "desired_position"])
def test_an_input_taken_a_tick_late_shows_in_the_replay(column):
    study = lab(noise=0.0)
    run = study.runs[0]
    late = replace(run, columns={**run.columns, column: np.roll(run[column], 1)})
    assert replay_error(study, late) > 1e-3


def test_numerical_error_is_a_small_part_of_the_gap_and_falls_with_the_step():
    ids, theta = ("contact.hertz",), (0.3, 5e-4)
    study = lab(ids, theta)
    reported = numerics(study, found(ids, theta))
    assert reported["substeps"] == SUBSTEPS
    assert 0.0 < reported["error"] and reported["fraction"] == reported["error"] / reported["gap"] < 0.02
    run = study.of(Role.HELDOUT)[0]
    among = contacts(study, run)
    traces = [one_contact_ahead(study, run, NONE, among, SUBSTEPS * factor).traces for factor in (1, 2, 4)]
    changes = [
        sum(np.sum((a - b) ** 2) for (a, _), (b, _) in zip(one, other, strict=True))
        for one, other in pairwise(traces)
    ]
    assert changes[1] < 0.5 * changes[0]


def test_a_model_that_goes_another_way_in_finer_steps_says_so():
    for limit, astray in ((0.08, True), (50.0, False)):
        effect = ("robot.acceleration-limit",), (limit,)
        reported = numerics(lab(*effect, ticks=3000), found(*effect))
        assert (reported["replay_change"] > reported["replay_noise"] > 1e-6) == astray
        said = " ".join(remarks(SimpleNamespace(numerics=Numerics(**reported), left_out={})))
        assert ("goes another way" in said) == astray


def test_numerics_of_a_study_without_contacts():
    assert numerics(lab(ticks=100), found())["fraction"] is None


def test_runs_without_contacts_are_taken_whole():
    reported = how_far(lab(("structure.offset",), (1e-4,), ticks=150), found(("structure.offset",), (1e-4,)))
    assert reported["contacts"] == 2 and np.isfinite(reported["before"])


def test_a_model_that_runs_away_on_held_out_runs_has_no_gap():
    """It is reported as None, whatever the others do: JSON has no infinite numbers."""
    fine, lost = np.full(40, 4.0), np.full(40, np.nan)
    reported = closure_of({"before": fine, "after": lost, "recalibrated": fine / 4.0}, 0.1, 2)
    assert (reported["before"], reported["after"], reported["closure"], reported["interval"]) == (
        2.0,
        None,
        None,
        None,
    )
    assert reported["recalibration_only"] == pytest.approx(1.0 / 1.9) and not reported["within_floor"]
    reported = closure_of({"before": np.full(40, np.inf), "after": fine, "recalibrated": fine}, 0.1, 2)
    assert (reported["before"], reported["closure"], reported["within_floor"]) == (None, None, False)
    Gap.model_validate(reported)


def test_that_a_model_goes_another_way_is_said_of_runs_without_contacts_too():
    numbers = Numerics(fraction=None, replay_change=1e-2, replay_noise=1e-6)
    assert "goes another way" in " ".join(remarks(SimpleNamespace(numerics=numbers, left_out={})))
