"""From a study to diagnosis.json and the page, with analyses made by hand and, where installed, with all."""

from __future__ import annotations

import json
import os
import re
from dataclasses import replace

import numpy as np
import pytest
import yaml
from logged import logged_study, with_column, write_case

from orchestrator.base.digests import file_digest
from orchestrator.base.errors import ConfigError, OrchestratorError
from orchestrator.cli.main import main
from orchestrator.diagnosis.rig.catalogue import catalogue
from orchestrator.diagnosis.rig.diagnose import diagnose
from orchestrator.diagnosis.rig.finding import Augmented, Candidate, Finding
from orchestrator.diagnosis.rig.headline import headline, nats, percent
from orchestrator.diagnosis.rig.report_text import text as in_lines
from orchestrator.diagnosis.rig.study import Role
from orchestrator.diagnosis.rig.verdict import Diagnosis
from orchestrator.report.make import report

HERTZ = catalogue()["contact.hertz"]
THETA = np.array([(one.starts or (0.2,))[0] for one in HERTZ.parameters])
NONE = Augmented({}, (), np.zeros(0))


def finding(effects=("contact.hertz",), ties=("contact.cubic",), probability=0.9, **other):
    model = Augmented({"force_bias": 0.01}, (HERTZ,), THETA) if effects == ("contact.hertz",) else None
    parameters = {f"contact.hertz.{one.name}": 0.4 for one in HERTZ.parameters} if model else {}
    candidates = (
        Candidate(tuple(effects), probability, parameters, tuple(ties), 120.0, model),
        Candidate(("sensor.gain",), 1.0 - probability, {"sensor.gain.relative": 0.1}, (), 90.0),
    )
    places = tuple(dict.fromkeys(one.partition(".")[0] for one in effects if one != "outside"))
    return Finding(
        candidates, tuple(effects), places, other.pop("outside_place", ""), tuple(effects), NONE, **other
    )


def how_far(study, found):
    gap = {"before": 0.1, "after": 0.01, "noise_floor": 0.008, "closure": 0.978, "interval": [0.95, 0.99],
           "recalibration_only": 0.2, "within_floor": False}  # fmt: skip
    return {**gap, "full_run": gap}


def parts(found=None, **other):
    seen = []

    def weigh(study):
        seen.append({run.role for run in study.runs})
        return found or finding()

    made = {
        "where": lambda study, found: {"contact": 0.97, "sensor": 0.05, "robot": -0.02},
        "ledger": lambda study, found: [
            {"component": one, "phase": "compression", "band": "0-5 Hz", "share": share}
            for one, share in (("rig", 1.25), ("controller", -0.25))
        ],
        "how_far": how_far,
        "next_experiment": lambda study, found: {
            "name": "slow approach", "description": "Run at 5 mm/s.", "expected_evidence": 31.0,
            "between": ["contact.hertz", "contact.cubic"]},
        "numerics": lambda study, found: {"fraction": 0.002},
    } | other  # fmt: skip
    return {name: one for name, one in ({"weigh": weigh} | made).items() if one is not None}, seen


@pytest.fixture(scope="module")
def study():
    return logged_study((HERTZ,), THETA, ticks=1200)


def test_what_is_written(study, tmp_path):
    case = write_case(study, tmp_path / "case-x")
    (case / "truth.json").write_text("{}")
    chosen, seen = parts()
    stages = []
    made = diagnose(case, tmp_path / "out", parts=chosen, progress=stages.append)
    assert stages == ["read", "check", "weigh", "where", "how far", "what next", "numerics", "write"]
    assert seen == [set(Role)], "what answers leave is judged on all runs"
    names = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert names == ["augmented.yaml", "diagnosis.json", "report.html"]
    found = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert found["case"] == "case-x"
    assert found["verdict"] == {"effects": ["contact.hertz"], "places": ["contact"]}
    assert [one["place"] for one in found["where"]] == ["contact", "sensor", "robot"]
    assert found["which"][0]["probability"] == pytest.approx(0.9)
    assert found["which"][0]["ties"] == ["contact.cubic"]
    assert found["how_far"]["full_run"]["closure"] == 0.978
    assert found["next_experiment"]["expected_evidence"] == 31.0
    assert found["numerics"]["fraction"] == 0.002
    assert found["augmented"]["file"] == "augmented.yaml" and found["augmented"]["run"] == "heldout-1"
    assert found["augmented"]["left_out"] == {}
    assert any(one.startswith("contact: hertz_exponent") for one in found["augmented"]["changed"])
    assert found["calibration"]["force_bias"]["fitted"] == 0.01
    assert found["calibration"]["force_bias"]["recalibrated"] == 0.0
    # The truth may lie beside the logs; it is not even opened.
    assert set(found["provenance"]["sha256"]) == {"case.yaml", *(f"{run.name}.csv.gz" for run in study.runs)}
    written = (tmp_path / "out" / "diagnosis.json").read_bytes()
    assert Diagnosis.model_validate_json(written) == made.diagnosis


def test_logs_have_checksums_wherever_they_stand(study, tmp_path):
    """In a folder of the case, elsewhere, or as a link; what else is called like them is not one."""
    case = write_case(study, tmp_path / "case-x")
    data = yaml.safe_load((case / "case.yaml").read_text())
    (case / "logs").mkdir()
    (tmp_path / "links").mkdir()
    names = [one["file"] for one in data["runs"]]
    places = [f"logs/{names[0]}", str(tmp_path / names[1]), *names[2:]]
    for entry, name, place in zip(data["runs"], names, places, strict=True):
        (case / name).rename(case / place)
        entry["file"] = place
    (case / names[2]).rename(tmp_path / "links" / "kept.gz")
    (case / names[2]).symlink_to(tmp_path / "links" / "kept.gz")
    (case / "case.yaml").write_text(yaml.safe_dump(data))
    (case / f"{names[3].partition('.')[0]}.truth.json").write_text("{}")
    chosen, _ = parts()
    kept = diagnose(case, parts=chosen).diagnosis.provenance["sha256"]
    assert set(kept) == {"case.yaml", *places}
    assert kept[places[1]] == file_digest(tmp_path / names[1])
    assert kept[names[2]] == file_digest(tmp_path / "links" / "kept.gz")


def test_every_effect_is_reported_in_words():
    reported = {one.words for one in catalogue().values()}
    assert len(reported) == len(catalogue()) and not reported & {one.equation for one in catalogue().values()}


def test_the_page_stands_alone_and_tells_all(study, tmp_path):
    diagnose(study, tmp_path, parts=parts()[0])
    text = (tmp_path / "report.html").read_text()
    assert not re.search(r"(?:src|href)\s*=\s*[\"'](?!#)", text), "nothing is loaded from elsewhere"
    assert not re.search(r"@import|url\((?!#)", text)
    for part in (
        "contact.hertz causes the gap (probability 90 %); adding it closes 98 % of the gap on runs that no "
        "fit saw. These logs cannot separate it from contact.cubic.",
        "slow approach", "31 nats of evidence expected", "Residual energy", "125.0", "-25.0",
        "What was assumed", "Power-law stiffness (exponent",
    ):  # fmt: skip
        assert part in text
    assert report([tmp_path]) == text
    # The effect that made the logs leaves nothing but noise.
    before, after = map(
        float, re.search(r"residual is ([\d.]+) times the noise before and ([\d.]+)", text).groups()
    )
    assert before > 5.0
    assert after < 1.2


def test_what_an_experiment_leaves_tied_is_reported(study, tmp_path):
    reported = {
        "name": "dead weights", "description": "Hang weights.", "expected_evidence": 40.0,
        "between": ["sensor.gain", "contact.stiffness", "structure.compliance"],
        "leaves": [["contact.stiffness", "structure.compliance"]], "then": "tip tracker",
    }  # fmt: skip
    made = diagnose(study, tmp_path, parts=parts(next_experiment=lambda study, found: reported)[0])
    words = "It does not separate contact.stiffness from structure.compliance: tip tracker does."
    assert words in (tmp_path / "report.html").read_text() and words in in_lines(made)
    made = diagnose(study, parts=parts(next_experiment=lambda study, found: reported | {"then": ""})[0])
    assert "from structure.compliance." in in_lines(made)


def test_the_same_study_gives_the_same_page(study, tmp_path):
    pages = []
    for name in ("a", "b"):
        diagnose(study, tmp_path / name, parts=parts()[0])
        text = (tmp_path / name / "report.html").read_text()
        pages.append(text[: text.index("<summary>Provenance")])
    assert pages[0] == pages[1]


def test_evidence_that_only_tells_of_digits_is_not_reported_as_a_number():
    assert nats(31.04) == "31 nats" and nats(1000.0) == "1000 nats" and nats(5e12) == "over 1000 nats"


def test_headlines():
    def reported(found, **other):
        return headline(diagnose(LOGGED, parts=parts(found, **other)[0]).diagnosis)

    assert reported(finding((), ())) == (
        "No unmodelled effect is needed: the calibrated model explains the logs (probability 90 %)."
    )
    strayed = {
        "before": 1.19, "after": 1.19, "noise_floor": 0.22, "closure": 0.0, "interval": [-0.01, 0.01],
        "recalibration_only": 0.0,
    }  # fmt: skip
    assert reported(finding((), ()), how_far=lambda study, found: strayed).startswith(
        "The runs that were fitted show no effect (probability 90 %), but on runs that no fit saw the error "
        "is 5.4 times the noise:"
    )
    hinted = finding(("sensor.dropout",), (), 0.52)
    hint, other = hinted.candidates
    assert reported(replace(hinted, effects=(), candidates=(hint, replace(other, effects=())))) == (
        "No effect is named: the logs hint at sensor.dropout (52 %), but by less than a nat over none (48 %)."
    )
    hidden = finding(("sensor.drift",), (), 0.7)
    drift, other = hidden.candidates
    assert reported(
        replace(hidden, candidates=(drift, replace(other, effects=("outside",)))), how_far=None
    ) == (
        "sensor.drift causes the gap (probability 70 %). "
        "It may be something outside the catalogue instead (30 %)."
    )
    assert reported(finding((), (), doubtful_tolerances=True)).startswith(
        "The calibration is farther off than its tolerances allow, and no effect explains it"
    )
    assert reported(finding(("outside",), (), outside_place="sensor")).startswith(
        "An effect outside the catalogue acts (probability 90 %), most likely at the sensor."
    )
    assert reported(finding(("sensor.delay",), ("sensor.gain",), 0.6), how_far=None) == (
        "One of sensor.delay or sensor.gain causes the gap (together 100 %; these logs cannot separate them)."
    )
    assert reported(finding(("robot.delay", "sensor.gain"), ()), how_far=None) == (
        "robot.delay and sensor.gain cause the gap (probability 90 %)."
    )


@pytest.mark.parametrize(
    ("value", "text"),
    [(1.0, "100 %"), (0.9995, "over 99.9 %"), (0.991, "99.1 %"), (0.5, "50 %"), (0.012, "1.2 %"),
     (-1e-9, "0 %"), (0.0, "0 %"), (1e-9, "0 %"), (5e-5, "under 0.1 %"), (-0.2, "-20 %"), (1.03, "103 %")],
)  # fmt: skip
def test_percent(value, text):
    assert percent(value) == text


def test_what_is_missing_is_reported(study, tmp_path):
    runs = tuple(run for run in study.runs if run.role is Role.TRAIN)
    made = diagnose(replace(study, runs=runs), tmp_path, parts=parts()[0])
    assert made.diagnosis.left_out == {
        "where": "no run has the role heldout",
        "how_far": "no run has the role heldout",
    }
    assert "Left out: no run has the role heldout" in (tmp_path / "report.html").read_text()


@pytest.mark.parametrize(
    ("other", "said"),
    [
        ({"where": lambda study, found: {"contact": np.nan}}, "share: Value error, got nan; a finite number"),
        (
            {"numerics": lambda study, found: {"fraction": "much"}},
            "numerics.fraction: Input should be a valid number",
        ),
    ],
)
def test_contradictions_are_refused(study, other, said):
    with pytest.raises(OrchestratorError) as caught:
        diagnose(study, parts=parts(**other)[0])
    assert said in str(caught.value)
    assert not isinstance(caught.value, ConfigError)


def test_bad_data_is_refused_before_anything_is_fitted(study):
    chosen, seen = parts()
    with pytest.raises(ConfigError, match="its sign is reversed"):
        diagnose(with_column(study, "sensor_force", np.negative), parts=chosen)
    assert seen == []


def test_a_verdict_that_cannot_be_written_leaves_nothing_behind(study, tmp_path, monkeypatch):
    def fail(*arguments):
        raise OSError("disk full")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(OSError, match="disk full"):
        diagnose(study, tmp_path, parts=parts()[0])
    assert list(tmp_path.iterdir()) == []


LOGGED = logged_study(ticks=900)


def test_command(study, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("orchestrator.diagnosis.rig.diagnose._analyses", lambda: parts()[0])
    good = write_case(study, tmp_path / "good")
    bad = write_case(with_column(study, "sensor_force", np.negative), tmp_path / "bad")
    assert main(["diagnose", str(good), "--out", str(tmp_path / "one")]) == 0
    assert "good: contact.hertz causes the gap" in capsys.readouterr().out
    assert (tmp_path / "one" / "diagnosis.json").is_file()
    assert (
        main(["diagnose", str(good), str(bad), "--out", str(tmp_path / "two"), "--no-report", "--json"]) == 1
    )
    out, err = capsys.readouterr()
    assert [json.loads(line)["case"] for line in out.splitlines()] == ["good"]
    assert "its sign is reversed" in err
    names = sorted(path.name for path in (tmp_path / "two" / "good").iterdir())
    assert names == ["augmented.yaml", "diagnosis.json"]
    assert not (tmp_path / "two" / "bad").exists()
    assert main(["diagnose", str(bad)]) == 2
    assert main(["diagnose", str(tmp_path / "nowhere")]) == 2
    assert "nowhere: no such file or folder" in capsys.readouterr().err
    (tmp_path / "other").mkdir()
    twin = write_case(study, tmp_path / "other" / "good")
    assert main(["diagnose", str(good), str(twin), "--out", str(tmp_path / "three")]) == 2
    assert "several cases are called good" in capsys.readouterr().err
