"""Ledgers, Shapley shares and energy balances add up exactly and point at the faulty component."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orchestrator.diagnosis.rig.components import COMPONENTS, component_of, residuals_of, significant
from orchestrator.diagnosis.rig.energy import INTERFACES, balances, energy
from orchestrator.diagnosis.rig.finding import Augmented
from orchestrator.diagnosis.rig.motion import Phase, contacts, phases
from orchestrator.diagnosis.rig.residual_ledger import energies, ledger
from orchestrator.diagnosis.rig.restart import Restart
from orchestrator.diagnosis.rig.shapley import shapley_shares, shapley_values, where
from orchestrator.diagnosis.rig.study import Role, load_study
from tests.diagnosis.labs import NONE, found, lab, model

GAP = Path(__file__).parents[3] / "shared" / "gap"

# One fault of each place, as large as in the labelled cases, and what it is called.
FAULTS = [
    (("link.sample-and-hold",), (4.0,)),
    (("robot.delay",), (0.002,)),
    (("robot.rate-limit",), (0.018,)),
    (("structure.offset",), (-0.0002,)),
    (("contact.plasticity",), (0.05,)),
    (("sensor.delay",), (0.001,)),
    (("controller.stiffness-gain",), (0.15,)),
    (("dynamics.drag",), (80.0,)),
]


def test_contacts_alternate_and_windows_do_not_overlap():
    study = lab()
    for run in study.runs:
        ones = contacts(study, run)
        assert len(ones) >= 2
        sides = [np.sign(run["sensor_force"][one.peak]) for one in ones]
        assert sides == [(-1.0) ** (number + 1) for number in range(len(ones))]
        for one in ones:
            assert 0 <= one.begin < one.first < one.peak < one.last < one.end <= len(run)
            assert abs(run["desired_velocity"][one.begin]) == pytest.approx(run.approach_speed, rel=0.1)
        assert all(one.end <= other.begin for one, other in pairwise(ones))


def test_contacts_are_found_in_a_run_that_is_mostly_contact():
    study = lab()
    run = study.runs[0]
    force = np.zeros(len(run))
    force[100:900] = -400.0 * np.sin(np.linspace(0.0, np.pi, 800))
    force[1100:1900] = -900.0 * np.sin(np.linspace(0.0, np.pi, 800))
    columns = {**run.columns, "sensor_force": force + 3.0}
    ones = contacts(study, type(run)(run.name, run.role, run.mass, run.approach_speed, columns))
    assert [abs(one.first - begin) < 5 for one, begin in zip(ones, (100, 1100), strict=True)] == [True, True]


def test_phases_follow_one_another():
    study = lab()
    labels = phases(study, study.runs[0])
    order = [Phase(value) for value in labels[np.flatnonzero(np.diff(labels, prepend=-1))]]
    count = len(contacts(study, study.runs[0]))
    assert order[: 4 * count] == list(Phase) * count


def test_no_contact_leaves_everything_in_flight():
    study = lab(ticks=100)
    assert contacts(study, study.runs[0]) == []
    assert not phases(study, study.runs[0]).any()


def test_a_filter_keeps_what_is_more_than_noise():
    random = np.random.default_rng(1)
    signal, noise = 5.0 * np.sin(np.arange(2000) / 30.0), random.normal(size=2000)
    kept = significant(signal + noise, 1.0)
    assert np.std(kept - signal) < 0.3
    assert np.std(significant(noise, 1.0)) < 0.3


def test_components_hold_all_places():
    assert component_of("structure") == component_of("sensor") == "structure+contact+sensor"
    with pytest.raises(ValueError, match=r"no component holds the place 'moon'; places: \('link', 'robot'"):
        component_of("moon")


@pytest.mark.parametrize(
    ("ids", "theta"),
    [
        ((), ()),
        (("contact.viscoelastic",), (0.4, 0.02)),
        (("contact.plasticity",), (0.05,)),
        (("dynamics.slosh",), (0.2, 0.44)),
        (("robot.backlash",), (2e-4,)),
        (("controller.lead", "sensor.low-pass"), (0.001, 0.001)),
    ],
    ids=str,
)
def test_a_model_taken_up_from_its_own_log_goes_on_as_the_log_does(ids, theta):
    study = lab(ids, theta, noise=0.0)
    run = study.of(Role.HELDOUT)[0]
    restart = Restart(study, run, model(ids, theta))
    for one in contacts(study, run):
        span = slice(one.begin, one.end)
        out = restart.ahead(one.begin, one.end - one.begin)
        assert np.abs(out[1] - run["desired_velocity"][span]).max() < 1e-9
        assert np.abs(out[3] - run["sensor_force"][span]).max() < 1e-6


def test_with_all_residuals_injected_the_loop_follows_the_log():
    ids, theta = ("robot.rate-limit", "dynamics.drag"), (0.02, 50.0)
    study = lab(ids, theta)
    shares = shapley_shares(study, study.of(Role.HELDOUT), NONE)
    assert shares.windows >= 4
    assert shares.left < 1e-3 * shares.gap


@given(gaps=st.lists(st.floats(0.0, 1e3), min_size=16, max_size=16))
@settings(max_examples=50, deadline=None)
def test_shapley_values_add_up(gaps):
    values = shapley_values(gaps)
    assert values.sum() == pytest.approx(gaps[0] - gaps[-1], abs=1e-9)


def test_a_component_that_changes_nothing_has_no_share():
    # Only the second player lessens the gap; coalitions in the order of `combinations`.
    gaps = [1.0, 1.0, 0.2, 1.0, 1.0, 0.2, 1.0, 1.0, 0.2, 0.2, 1.0, 0.2, 0.2, 1.0, 0.2, 0.2]
    assert shapley_values(gaps) == pytest.approx([0.0, 0.8, 0.0, 0.0], abs=1e-12)


@pytest.mark.parametrize(("ids", "theta"), FAULTS, ids=str)
def test_the_faulty_component_is_reported(ids, theta):
    study, finding = lab(ids, theta), found(ids, theta)
    shares = where(study, finding)
    assert sum(shares.values()) == pytest.approx(1.0, abs=1e-9)
    place = ids[0].partition(".")[0]
    assert shares[place] > 0.9
    rows = ledger(study, finding)
    assert sum(row["share"] for row in rows) == pytest.approx(1.0, abs=1e-9)
    faulty = sum(row["share"] for row in rows if row["component"] == component_of(place))
    assert faulty > 0.9


def test_two_faults_share_the_gap():
    ids, theta = ("robot.delay", "controller.stiffness-gain"), (0.002, 0.1)
    shares = where(lab(ids, theta), found(ids, theta))
    assert shares["robot"] > 0.1 and shares["controller"] > 0.1
    assert shares["robot"] + shares["controller"] > 0.9


def test_ledger_cells_add_up_to_the_energy_of_each_residual():
    study = lab(("contact.hertz",), (0.3, 5e-4))
    run = study.runs[0]
    cells, noise = energies(study, run, NONE)
    signals = residuals_of(study, run, NONE)
    whole = study.tick * np.sum(signals.force**2, axis=1)
    assert np.abs(cells.sum(axis=(1, 2)) - whole).max() <= 1e-9 * whole.max()
    expected = study.tick * len(run) * signals.force_noise**2
    assert noise.sum(axis=(1, 2)) == pytest.approx(expected, rel=1e-9)
    contact = list(COMPONENTS).index("structure+contact+sensor")
    assert cells[contact, Phase.COMPRESSION].sum() > 10.0 * cells[contact, Phase.FLIGHT].sum()


def test_a_bent_calibration_is_not_believed():
    study = lab()
    bent = Augmented({"natural_frequency": -200.0}, (), np.zeros(0))
    near = Augmented({"natural_frequency": 472.0}, (), np.zeros(0))
    assert found(recalibrated=bent).faultless(study.nominal).calibrated == {}
    assert found(recalibrated=near).faultless(study.nominal).calibrated == near.calibrated


@pytest.mark.parametrize(("ids", "theta"), FAULTS, ids=str)
def test_energy_balances_add_up(ids, theta):
    study = lab(ids, theta)
    for run in study.of(Role.HELDOUT):
        for one in balances(study, run, NONE):
            assert one.measured.sum() == pytest.approx(one.change[0], abs=1e-9)
            assert one.modelled.sum() == pytest.approx(one.change[1], abs=1e-9)
    reported = energy(study, found(ids, theta))
    for name in ("measured", "nominal", "excess", "answer"):
        assert sum(reported[name].values()) == pytest.approx(reported["change"][name], abs=1e-9)
    assert reported["change"]["answer"] == pytest.approx(reported["change"]["measured"], abs=0.02)
    assert list(reported["measured"]) == list(INTERFACES)


def test_a_delayed_robot_pumps_energy_and_drag_takes_it():
    excess = energy(lab(("robot.delay",), (0.002,)), found(("robot.delay",), (0.002,)))["excess"]
    assert excess["link+robot"] > 0.05
    excess = energy(lab(("dynamics.drag",), (80.0,)), found(("dynamics.drag",), (80.0,)))["excess"]
    assert excess["dynamics"] < -0.02 and abs(excess["dynamics"]) > 3.0 * abs(excess["link+robot"])


def test_without_contacts_there_is_nothing_to_tell():
    study = lab(ticks=100)
    assert energy(study, found()) == {}
    assert sum(where(study, found()).values()) == pytest.approx(1.0)


@pytest.mark.skipif(not GAP.is_dir(), reason="the labelled cases are not beside the checkout")
@pytest.mark.parametrize("case", ["case-003", "case-008", "case-016", "case-041", "case-047", "case-059"])
def test_the_component_of_labelled_cases_is_reported(case):
    place = json.loads((GAP / "cases" / "truth.json").read_text())[case]["places"][0]
    study = load_study(GAP / "cases" / case)
    shares = shapley_shares(study, study.of(Role.HELDOUT), NONE)
    # Errors of calibration within their tolerances have their share, too.
    assert shares.shares[list(COMPONENTS).index(component_of(place))] > 0.6


@given(
    fault=st.sampled_from(
        [
            ((), ()),
            (("robot.delay",), (0.002,)),
            (("contact.hertz",), (0.3, 5e-4)),
            (("dynamics.mass",), (0.1,)),
            (("controller.lead",), (0.002,)),
            (("sensor.bias",), (1.5,)),
            (("robot.friction",), (0.8, 0.3)),
        ]
    ),
    # From runs that are over before the first contact to such with several.
    cuts=st.lists(st.integers(20, 1600), min_size=6, max_size=6),
    noise=st.sampled_from([0.0, 1.0, 5.0]),
    seed=st.integers(0, 5),
)
@settings(max_examples=20, deadline=None, derandomize=True)
def test_both_ledgers_add_up_whatever_the_runs_are(fault, cuts, noise, seed):
    whole = lab(*fault, noise=noise, ticks=1600, seed=seed)
    runs = [
        replace(run, columns={name: values[:cut] for name, values in run.columns.items()})
        for run, cut in zip(whole.runs, cuts, strict=True)
    ]
    study = replace(whole, runs=tuple(runs))
    for finding in (found(*fault), found()):
        rows = [row["share"] for row in ledger(study, finding)]
        assert not rows or sum(rows) == pytest.approx(1.0, abs=1e-9)
        assert sum(where(study, finding).values()) == pytest.approx(1.0, abs=1e-9)
        shares = shapley_shares(study, study.of(Role.HELDOUT), finding.answer)
        assert shares.values.sum() == pytest.approx(shares.gap - shares.left, abs=1e-9)
        reported = energy(study, finding)
        for name in ("measured", "nominal", "excess", "answer") if reported else ():
            assert sum(reported[name].values()) == pytest.approx(reported["change"][name], abs=1e-9)
        for one in reported.get("contacts", ()):
            assert sum(one["by_interface"].values()) == pytest.approx(one["excess"], abs=1e-9)


def test_contacts_of_a_sensor_that_does_not_come_back_to_rest():
    own = lab()
    run = own.runs[0]
    force, played = np.zeros(len(run)), 0.0
    for n, value in enumerate(run["sensor_force"]):
        played = min(max(played, value - 20.0), value + 20.0)
        force[n] = value + 0.3 * (played - value)
    assert np.abs(force[np.abs(run["sensor_force"]) < 0.01]).max() > 5.5
    stuck = replace(run, columns={**run.columns, "sensor_force": force})
    plain, found = contacts(own, run), contacts(own, stuck)
    assert len(found) == len(plain) > 1
    for one, other in zip(found, plain, strict=True):
        assert abs(one.first - other.first) <= 10 and abs(one.peak - other.peak) <= 10
