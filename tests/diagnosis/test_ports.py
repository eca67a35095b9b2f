"""A diagnosis of any system of FMUs: effects hidden in it, none, and one struck out."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
import yaml
from ports_bench import COULOMB, POSITION, VOLTAGE, friction, study

from orchestrator.cli.main import main
from orchestrator.diagnosis.catalogue import in_words
from orchestrator.diagnosis.diagnose import diagnose
from orchestrator.diagnosis.finding import Augmented, Candidate
from orchestrator.diagnosis.headline import headline
from orchestrator.diagnosis.ports.candidates import candidates
from orchestrator.diagnosis.ports.diagnose import diagnose_ports
from orchestrator.diagnosis.ports.page import _figure
from orchestrator.diagnosis.ports.reader import load_port_study
from orchestrator.diagnosis.ports.replay import PortReplay, measure
from orchestrator.diagnosis.ports.seek import carries
from orchestrator.diagnosis.ports.study import Role
from orchestrator.diagnosis.ports.weigh import foremost, weigh_ports
from orchestrator.diagnosis.verdict import read_diagnosis
from orchestrator.simulation.run import run

# Each law is compiled when it is first used, so that fewer of them are quicker.
FEW = {"only": ["drive.coulomb", "drive.stribeck", "drive.viscous", "drive.voltage.*"]}


@pytest.mark.parametrize("width", ["3 mm/s", "0.1 mm/s"])
def test_a_sharp_corner_and_a_round_one_are_coulombs(tmp_path, width):
    """No spring of a micrometre, nor a curve that falls a little."""
    few = {"only": [f"drive.{one}" for one in ("coulomb", "stribeck", "dahl", "maxwell-slip")]}
    path = study(tmp_path, [friction("Coulomb", level="60 N", width=width)], candidates=few)
    first = weigh_ports(load_port_study(path)).finding.candidates[0]
    assert first.effects == ("drive.coulomb",)
    assert first.parameters["drive.coulomb.level"] == pytest.approx(60.0, rel=5e-3)
    assert 1e3 * first.parameters["drive.coulomb.width"] == pytest.approx(float(width.split()[0]), rel=0.3)


def test_a_hidden_friction_is_found(tmp_path):
    path = study(tmp_path / "case", [COULOMB], candidates=FEW)
    made = diagnose(path, tmp_path / "out")
    found = read_diagnosis(tmp_path / "out")
    assert made.diagnosis.verdict.effects == ["drive.coulomb"]
    assert found.verdict.places == ["drive"] and len(found.verdict.effects) == 1
    assert found.which[0].probability > 0.5
    assert found.which[0].parameters[f"{found.verdict.effects[0]}.level"] == pytest.approx(12.0, rel=0.05)
    # The gap on the run that no fit saw goes down to the noise; other masses and dampings do not get there.
    assert found.how_far.closure > 0.97 > found.how_far.recalibration_only
    assert found.how_far.over_recalibration > 100.0
    assert sum(one.share for one in found.ledger) == pytest.approx(1.0, abs=1e-9)
    assert found.calibration["drive.mass"]["fitted"] == pytest.approx(95.1, abs=1.0)
    page = (tmp_path / "out" / "report.html").read_text()
    assert found.verdict.effects[0] in page and page.count("<svg") == 2 and "one contact ahead" not in page
    # What was changed is reported, in words of a system, not of the docking rig.
    assert found.augmented.changed[0].startswith(f"{found.verdict.effects[0]}: level 1")
    assert " N" in found.augmented.changed[0] and "duration of" not in page
    # The system with the effect added runs, and gives what was logged.
    config = yaml.safe_load((tmp_path / "out" / "augmented.yaml").read_text())
    config["instances"]["path"]["start"] = {"stroke": "0.17 m", "frequency": "0.5 Hz"}
    config["run"]["stop_time"] = "2 s"
    results = run(config, halving=False).results
    log = np.genfromtxt(path / "run-2.csv", delimiter=",", names=True)
    left = np.asarray(results["controller.voltage"]) - log["controllervoltage_V"]
    assert np.std(left) < 0.02 < 0.1 < np.std(log["controllervoltage_V"])
    # So it does with the law as an FMU, and can be exported then.
    config = yaml.safe_load((tmp_path / "out" / "augmented-fmus.yaml").read_text())
    assert config["instances"]["friction_drive"]["fmu"] == "FrictionForce"
    config["instances"]["path"]["start"] = {"stroke": "0.17 m", "frequency": "0.5 Hz"}
    config["run"]["stop_time"] = "2 s"
    as_fmu = run(config, halving=False).results
    assert np.std(np.asarray(as_fmu["controller.voltage"]) - log["controllervoltage_V"]) < 0.05
    exported = str(tmp_path / "augmented.fmu")
    assert main(["export", str(tmp_path / "out" / "augmented-fmus.yaml"), "-o", exported]) == 0
    # The gap lies in the drive, and is not the step's own.
    assert found.where[0].place == "drive" and found.where[0].share > 0.95
    assert {one.phase for one in found.ledger} == {"forth", "back", "reversal", "rest"}
    assert 0.0 < found.numerics.fraction < 0.1
    assert "step halving" in page and "Residual energy" in page


def test_a_hidden_effect_on_a_connection_is_found(tmp_path):
    hidden = {"from": "controller.voltage", "to": "drive.voltage", "through": [{"dead-band": "0.2 V"}]}
    weighed = weigh_ports(load_port_study(study(tmp_path, [hidden], candidates=FEW)))
    assert weighed.finding.effects == ("drive.voltage.dead-band",)
    parameters = weighed.finding.candidates[0].parameters
    assert parameters["drive.voltage.dead-band.threshold"] == pytest.approx(0.2, rel=0.05)


def test_two_threads_find_what_one_finds(tmp_path):
    hidden = {"from": "controller.voltage", "to": "drive.voltage", "through": [{"backlash": "0.2 V"}]}
    found = load_port_study(study(tmp_path, [hidden], candidates={"only": ["drive.voltage.*"]}))
    assert PortReplay(found, found.runs).player.parallel
    one, two = (weigh_ports(found, workers=workers) for workers in (1, 2))
    assert one.finding.effects == ("drive.voltage.backlash",)
    assert [(each.effects, each.gain) for each in one.answers] == [
        (each.effects, each.gain) for each in two.answers
    ]


def test_what_counts_most_stands_first(tmp_path):
    found = load_port_study(study(tmp_path, [COULOMB], seed=None))
    replay = PortReplay(found, found.of(Role.TRAIN))
    named = {one.id: one for one in candidates(found, measure(found, replay.runs[0]))}
    viscous, coulomb = named["drive.viscous"], named["drive.coulomb"]
    one = Candidate(
        (viscous.id, coulomb.id),
        0.9,
        {},
        (),
        0.0,
        Augmented({}, (viscous, coulomb), np.array([0.1, 12.0, 1e-3])),
    )
    weights = {POSITION: 1.0, VOLTAGE: 1.0}
    ordered = foremost(replay, weights, one)
    assert ordered.effects == (coulomb.id, viscous.id) and ordered.model is one.model
    alone = replace(one, effects=(viscous.id,), model=None)
    assert foremost(replay, weights, alone) is alone


@pytest.mark.parametrize("seed", [1, 2])
def test_none_is_found_where_nothing_is_hidden(tmp_path, seed):
    weighed = weigh_ports(load_port_study(study(tmp_path, seed=seed, candidates=FEW)))
    assert weighed.finding.effects == ()
    assert weighed.finding.candidates[0].probability > 0.8
    assert not weighed.finding.doubtful_tolerances


def test_outside_is_told_where_the_effect_is_struck(tmp_path):
    strike = {"only": ["controller.reference.*", "controller.voltage.*", "drive.position.*"]}
    found = load_port_study(study(tmp_path, [COULOMB], candidates=strike))
    weighed = weigh_ports(found)
    assert weighed.finding.effects == ("outside",)
    assert weighed.finding.outside_place in ("drive", "controller")


def test_what_stands_unlogged_before_a_port_may_be_outside_as_well(tmp_path):
    path = study(tmp_path, [COULOMB], candidates={"only": ["drive.position.*"]})
    data = yaml.safe_load((path / "study.yaml").read_text())
    del data["columns"]["controller.voltage"]
    (path / "study.yaml").write_text(yaml.safe_dump(data))
    made = diagnose_ports(path, lambda stage: None, report=False)
    assert made.finding.outside_place == "controller+drive"
    assert made.diagnosis.verdict.places == ["controller", "drive"]
    assert "most likely at the controller or the drive" in headline(made.diagnosis)


def test_something_outside_is_placed_where_components_stray_and_not_downstream(tmp_path):
    """A motor with dry friction, whose speed and way are logged: the law is not in the list."""
    path = study(tmp_path, [COULOMB], candidates={"only": ["controller.reference.*", "controller.voltage.*"]})
    made = diagnose_ports(path, lambda stage: None, report=False)
    energies = Counter()
    for row in made.diagnosis.ledger:
        energies[row.component] += row.share
    assert made.finding.effects == ("outside",)
    assert made.finding.outside_place == energies.most_common(1)[0][0] == "drive"
    assert made.diagnosis.verdict.places == ["drive"] and made.diagnosis.outside_place == "drive"


def test_another_parameter_than_configured_is_found(tmp_path):
    path = study(
        tmp_path,
        [],
        candidates={
            "only": [*FEW["only"], "drive.force_per_voltage"],
            "parameters": {"drive.force_per_voltage": "5 N/V"},
        },
    )
    # The study believes in a drive that is 8 % weaker than the one that made the logs.
    text = (path / "study.yaml").read_text().replace(
        "- run.step_size=2 ms", "- run.step_size=2 ms\n- drive.force_per_voltage=32.5 N/V"
    )  # fmt: skip
    (path / "study.yaml").write_text(text)
    weighed = weigh_ports(load_port_study(path))
    best = weighed.finding.candidates[0]
    # More force per volt is as good as more volts.
    assert {"drive.force_per_voltage", "drive.voltage.gain"} & {*best.effects, *best.ties}
    assert best.effects != ()


def test_what_residuals_carry():
    draw = np.random.default_rng(3)
    white = draw.standard_normal(20000)
    assert carries(white) == 1.0
    assert carries(3.0 * white) == pytest.approx(9.0, rel=0.1)
    slow = np.convolve(white, np.ones(50) / np.sqrt(50), "same")
    # The correlation time of a moving average over 50 samples is 50.
    assert carries(slow) == pytest.approx(50.0, rel=0.35)


def test_the_page_counts_an_offset_as_a_gap(noiseless):
    found = load_port_study(noiseless)
    log = found.runs[2].logs[POSITION]
    _, words = _figure(found, found.runs[2], POSITION, log - 0.05, log)
    share = 0.05 / float(log[found.settled :].std())
    assert share > 0.5 and f"is {100 * share:.3g} % of the signal's spread before and 0 % after" in words


def test_a_limit_is_told_in_its_unit(noiseless):
    found = load_port_study(noiseless)
    words = {one.id: in_words(one) for one in candidates(found, measure(found, found.runs[0]))}
    peak = np.abs(found.runs[0].logs[VOLTAGE]).max()
    assert words["controller.voltage.saturate"] == f"|y| at most (1 - cut) of the peak, {peak:.4g} V"
    assert words["drive.position.rate-limit"].endswith(" m per second")


def test_the_command(tmp_path, capsys):
    path = study(tmp_path / "case", candidates={"only": ["controller.voltage.*"]})
    (tmp_path / "out").mkdir()
    for name in ("report.html", "notes.txt"):
        (tmp_path / "out" / name).write_text("old")
    told = ["diagnose", str(path / "study.yaml"), "--effects", "--no-report"]
    assert main([*told, "--out", str(tmp_path / "out")]) == 0
    assert "No unmodelled effect is needed" in capsys.readouterr().out
    names = sorted(one.name for one in (tmp_path / "out").iterdir())
    # The page of an earlier diagnosis would not be this one's; what is not ours stays.
    assert names == ["augmented.yaml", "diagnosis.json", "notes.txt"]
    data = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert data["how_far"]["within_floor"] and set(data["left_out"]) == {"energy", "ledger"}


def test_logs_that_replay_exactly_need_no_effect(noiseless):
    weighed = weigh_ports(load_port_study(noiseless))
    assert weighed.finding.effects == () and weighed.answers[0].effects == ()
