"""What the page and the lines of a diagnosis say beside the verdict, and what it is asked to be made from."""

from __future__ import annotations

import re

import pytest

from orchestrator.diagnosis.rig.catalogue import catalogue
from orchestrator.diagnosis.rig.caveats import caveats
from orchestrator.diagnosis.rig.diagnosed import Diagnosed
from orchestrator.diagnosis.rig.headline import headline
from orchestrator.diagnosis.rig.report import compose
from orchestrator.diagnosis.rig.report_energy import energy
from orchestrator.diagnosis.rig.report_text import text
from orchestrator.diagnosis.rig.verdict import Diagnosis

GAP = {"before": 0.1, "after": 0.01, "noise_floor": 0.008, "closure": 0.978, "interval": None,
       "recalibration_only": 0.2}  # fmt: skip


def made(effects=("drive.coulomb",), ties=(), **other):
    """A diagnosis that names some effects."""
    where = other.pop("where", {"drive": 1.0})
    places = {one.partition(".")[0] for one in effects} - {"outside"}
    places |= {other["outside_place"]} if "outside" in effects else set()
    data = {
        "case": "x",
        "verdict": {"effects": effects, "places": sorted(places)},
        "where": [{"place": place, "share": share} for place, share in where.items()],
        "which": [{"effects": effects, "probability": 1.0, "parameters": {}, "ties": ties}],
        "answer_set": [], "doubtful_tolerances": False, "how_far": GAP, "next_experiment": None,
        "numerics": None, "misfit": {}, "calibration": {}, "data": [], "provenance": {}, **other,
    }  # fmt: skip
    return Diagnosis.model_validate(data)


def test_held_out_runs_that_contradict_an_answer_are_reported_in_the_headline():
    worse = made(how_far=GAP | {"closure": -6.33, "after": 0.7})
    assert headline(worse) == (
        "The fitted runs support drive.coulomb (probability 100 %), but on runs that no fit saw "
        "the gap grows by 633 % of it with it: do not rely on this answer."
    )
    runs_away = made(how_far=GAP | {"closure": None, "after": None})
    assert "the gap grows without bounds with it: do not rely" in headline(runs_away)
    unsure = made(how_far=GAP | {"closure": -0.01, "interval": (-0.2, 0.2)})
    assert "do not rely" not in headline(unsure)
    within = made(how_far=GAP | {"closure": None, "within_floor": True})
    assert headline(within).endswith(
        "; on runs that no fit saw the gap is within the noise, so that they do not confirm it."
    )
    beyond = made(how_far=GAP | {"closure": None, "within_floor": True, "after": 0.2})
    assert "the gap grows beyond the noise with it: do not rely on this answer" in headline(beyond)


def test_energies_of_a_model_that_runs_away_are_left_blank():
    shares = {"interfaces": ["wall"], "measured": {"wall": 1.5}, "nominal": {"wall": None}}
    found = energy(made(energy=shares | {"change": {"measured": 1.5, "nominal": None}}))
    assert "<tr><td>wall</td><td>+1.5000</td><td>-</td></tr>" in found
    assert "<tfoot><tr><td>CoR^2 - 1</td><td>+1.5000</td><td>-</td></tr></tfoot>" in found


def page(diagnosis):
    return compose(diagnosis, {}, [])


@pytest.mark.parametrize(
    ("effects", "doubted", "said"),
    [
        (("drive.coulomb",), True, "drive.mass -4.0 tolerances"),
        (("outside",), True, "drive.mass +5.0, drive.friction +3.5 tolerances"),
        (("drive.coulomb",), False, ""),
        ((), True, ""),  # of which the headline tells
    ],
)
def test_numbers_beyond_their_tolerances_are_named(effects, doubted, said):
    calibration = {
        "drive.mass": {"nominal": 95.0, "tolerance": 2.0, "fitted": 87.0, "recalibrated": 105.0},
        "drive.friction": {"nominal": 200.0, "tolerance": 10.0, "fitted": 229.0, "recalibrated": 235.0},
    }
    diagnosis = made(effects, outside_place="drive", calibration=calibration, doubtful_tolerances=doubted)
    words = "Calibrated numbers moved farther than their tolerances allow"
    assert caveats(diagnosis) == ([f"{words} ({said}): doubt the tolerances."] if said else [])
    for shown in (page(diagnosis), text(Diagnosed(None, None, diagnosis))):
        assert shown.count(words) == (1 if said else 0)


def test_the_place_of_something_outside_is_reported_to_be_one_of_a_chain():
    row = {"component": "structure+contact+sensor", "phase": "flight", "band": "to 10 Hz", "share": 1.0}
    assert caveats(made(("outside",), outside_place="sensor", ledger=[row])) == [
        "Logs drive contact, sensor and structure as one: that it is at the sensor, and not at contact or "
        "structure, follows only from the shape of the residuals."
    ]
    alone = made(("outside",), outside_place="dynamics", ledger=[row | {"component": "dynamics"}])
    assert caveats(alone) == [] == caveats(made(("sensor.gain",), ledger=[row], where={"sensor": 1.0}))


def test_several_numbers_may_tell_together_of_which_none_is_far_off():
    calibration = {
        "drive.mass": {"nominal": 95.0, "tolerance": 2.0, "fitted": 90.0, "recalibrated": 90.0},
        "drive.friction": {"nominal": 200.0, "tolerance": 10.0, "fitted": 228.0, "recalibrated": 228.0},
        "drive.load": {"nominal": 0.0, "tolerance": 1.0, "fitted": 0.5, "recalibrated": 0.5},
    }
    (said,) = caveats(made(calibration=calibration, doubtful_tolerances=True))
    assert "(drive.friction +2.8, drive.mass -2.5 tolerances)" in said


def test_a_gap_that_shows_elsewhere_than_the_effect_acts_is_reported():
    where = {"drive": 0.9, "controller": 0.1}
    (reported,) = caveats(made(("controller.voltage.gain",), where=where))
    assert reported == (
        "The gap shows most at drive (90 %), while controller.voltage.gain acts at controller: "
        "if it is the cause, its error travels on."
    )
    assert reported in page(made(("controller.voltage.gain",), where=where))
    (reported,) = caveats(made(("path.gain", "controller.voltage.gain"), where=where))
    assert "path.gain and controller.voltage.gain act at controller and path" in reported
    # Not where one of those named has it, where no place clearly has, where a tie or the same component has,
    # where all of it is noise, or where nothing is named.
    assert not caveats(made(("controller.voltage.gain", "drive.coulomb"), where=where))
    assert not caveats(made(("controller.gain",), where={"drive": 0.6, "controller": 0.4}))
    assert not caveats(made(("controller.gain",), where={"a": 0.4, "b": 0.35, "controller": 0.25}))
    assert not caveats(made(("controller.gain",), ties=("drive.gain",), where=where))
    row = {"component": "controller+drive", "phase": "all", "band": "all", "share": 1.0}
    assert not caveats(made(("controller.gain",), where=where, ledger=[row]))
    assert not caveats(made(("controller.gain",), where=where, how_far=GAP | {"within_floor": True}))
    assert not caveats(made((), where=where))


def test_of_something_outside_no_other_place_is_named():
    diagnosis = made(("outside",), where={"robot": 1.1, "sensor": -0.1}, outside_place="sensor")
    assert caveats(diagnosis) == []


@pytest.mark.parametrize(
    ("reported_by", "said"),
    [
        ("repeats", "noise: what runs differ by that repeat each other."),
        ("specified", "noise: as specified, since no held-out run was repeated."),
        ("both", "noise: what runs differ by that repeat each other, else as specified."),
        ("", "noise: what does not repeat."),
    ],
)
def test_the_page_tells_where_the_noise_comes_from(reported_by, said):
    assert said in page(made(how_far=GAP | {"noise_floor_from": reported_by}))
    whole = GAP | {"noise_floor_from": "none"}
    words = f"{said[:-1]}; over complete runs none is known."
    assert words in page(made(how_far=GAP | {"noise_floor_from": reported_by, "full_run": whole}))


def test_effects_stand_with_their_numbers_and_names_as_they_are():
    one = {"effects": ["sensor.low-pass"], "probability": 1.0, "ties": []}
    moved = {"nominal": 0.8, "tolerance": 0.01, "fitted": 0.8, "recalibrated": 0.8}
    (parameter,) = (one.name for one in catalogue()["sensor.low-pass"].parameters)
    which = [one | {"parameters": {f"sensor.low-pass.{parameter}": 0.002}}]
    html = page(made(("sensor.low-pass",), which=which, calibration={"damping_ratio": moved}))
    assert f"{parameter} 0.002 s" in html and "damping_ratio" in html and "damping ratio" not in html


def test_phases_stand_over_their_bands():
    rows = [
        {"component": "drive", "phase": phase, "band": band, "share": 0.25}
        for phase in ("forth", "back") for band in ("0-1 Hz", "over 1 Hz")
    ]  # fmt: skip
    html = page(made(ledger=rows))
    assert "<th class=phase colspan=2>forth</th>" in html
    assert re.search(r"\.phase \{[^}]*text-align: center", html)


@pytest.mark.parametrize(
    ("closed", "stray", "said"), [(0.97, 12.0, True), (0.97, 2.0, False), (0.5, 12.0, False)]
)
def test_that_recalibration_closes_as_much_is_reported_beside_the_headline(closed, stray, said):
    numbers = {"nominal": 25.0, "tolerance": 2.5, "fitted": 25.0, "recalibrated": 25.0 + 2.5 * stray}
    gap = {**GAP, "recalibration_only": closed}
    reported = caveats(made(how_far=gap, calibration={"room.vent": numbers}))
    assert bool(reported) == said
    if said:
        assert "room.vent +12.0 tolerances" in reported[0] and "97 %" in reported[0]


def test_what_to_do_where_no_experiment_tells_is_said():
    """Where all of the menu are considered, others must be named."""
    vain = {"name": "log drive.velocity", "description": "x", "expected_evidence": 0.1, "between": []}
    found = made(next_experiment=vain)
    reported = "o experiment that was considered separates these answers; name what else can be run under"
    assert reported in page(found) and f"  next: n{reported}" in text(Diagnosed(None, None, found))
