"""What commands tell machines: JSON on the standard output, and exit codes."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import pytest

from orchestrator.cli.main import main

ROOT = Path(__file__).parents[2]
SHORT = ["--set", "run.stop_time=10 ms", "--no-halving"]


def reported(capsys) -> list[dict]:
    """The lines of the standard output, each of which is JSON."""
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_run_prints_one_line_a_system(capsys, tmp_path):
    names = ["docking-1d-uncompensated", "docking-1d"]
    assert main(["run", *names, *SHORT, "--json", "--no-figures", "--out", str(tmp_path)]) == 0
    first, second = reported(capsys)
    assert first["exit_code"] == second["exit_code"] == 0
    assert first["summary"]["title"] == "Uncompensated docking contact, one dimension"
    written = json.loads((tmp_path / names[1] / "summary.json").read_text(encoding="utf-8"))
    assert second["summary"] == written
    assert second["folder"] == str(tmp_path / names[1])
    assert "results.arrow" in second["files"]


def test_problems_of_a_config_are_objects(capsys):
    assert main(["run", "docking-1d", "--set", "robot.tau_m=6", "--set", "robot.tau=1 ms", "--json"]) == 2
    (answer,) = reported(capsys)
    assert answer["exit_code"] == 2
    assert answer["error"]["kind"] == "ConfigError"
    problems = answer["error"]["problems"]
    assert len(problems) == 2
    assert {"place", "what", "allowed", "remedy"} == set(problems[0])
    assert "robot" in problems[0]["place"]


def test_a_run_that_fails_says_where_and_when(capsys):
    changes = ["--set", "satellite.velocity=1e308 m/s", "--set", "run.stop_time=1 s", "--no-halving"]
    assert main(["run", "docking-1d-uncompensated", *changes, "--json"]) == 1
    (answer,) = reported(capsys)
    assert answer["exit_code"] == 1
    assert answer["error"]["kind"] == "StepError"
    assert answer["error"]["status"] == "not finite"
    assert answer["error"]["time"] >= 0.0


def test_an_unknown_system_is_an_object_with_every_command(capsys):
    for command in ("run", "check", "stability"):
        assert main([command, "docking-2d", "--json"]) == 2
        (answer,) = reported(capsys)
        assert "docking-2d" in answer["error"]["problems"][0]["what"]


def test_check_list_stability_and_export_tell_what_they_print(capsys, tmp_path):
    assert main(["check", "docking-1d-uncompensated", "--json"]) == 0
    (answer,) = reported(capsys)
    assert answer["instances"]["robot"] == "DockingHIL.RobotResponse"
    assert answer["order"][0] in answer["instances"]
    assert answer["steps"] == 40_000
    assert main(["list", "--json"]) == 0
    (answer,) = reported(capsys)
    assert "docking-1d" in answer["systems"] and "gauss-seidel" in answer["masters"]
    assert main(["stability", "docking-1d-uncompensated", "--json"]) == 0
    (answer,) = reported(capsys)
    assert answer["verdict"].startswith("unstable: 2 roots")
    assert answer["docking"]["growth_per_contact"] == pytest.approx(1.23555, abs=2e-5)
    out = str(tmp_path / "run")
    assert (
        main(["run", "docking-1d", *SHORT, "--quiet", "--no-figures", "--format", "arrow", "--out", out]) == 0
    )
    assert main(["export-results", out, "--format", "csv", "--json"]) == 0
    (answer,) = reported(capsys)
    assert answer == {"exit_code": 0, "folder": out, "files": ["results.csv"], "rows": 21}


def test_challenge_tells_what_it_made_ran_and_scored(capsys, tmp_path):
    cases, verdicts = tmp_path / "cases", tmp_path / "verdicts"
    assert (
        main(["challenge", "make", str(cases), "--cases", "2", "--seed", "5", "--jobs", "1", "--json"]) == 0
    )
    (answer,) = reported(capsys)
    sealed = (cases / answer["sealed"]).read_bytes()
    assert answer == {
        "exit_code": 0,
        "folder": str(cases),
        "cases": len(list(cases.glob("*/case.yaml"))),
        "sealed": "truth.sealed",
        "sha256": hashlib.sha256(sealed).hexdigest(),
    }
    run = ["challenge", "run", str(cases), "--verdicts", str(verdicts), "--jobs", "1", "--json"]
    assert main([*run, "--by", "os.path:join"]) == 1
    (answer,) = reported(capsys)
    assert (answer["exit_code"], answer["diagnosed"]) == (1, 0)
    assert [one["case"] for one in answer["failed"]] == ["case-0001", "case-0002"]
    assert answer["failed"][0]["message"] == "os.path:join wrote no diagnosis.json"
    score = ["challenge", "score", str(cases), "--verdicts", str(verdicts), "--json"]
    assert main(score) == 2
    (answer,) = reported(capsys)
    assert answer["error"]["kind"] == "ConfigError"
    assert "2 of 2 verdicts are missing" in answer["error"]["problems"][0]["what"]
    assert main([*run, "--by", "orchestrator.nothing:at_all"]) == 2
    (answer,) = reported(capsys)
    assert answer["error"]["problems"][0]["place"] == "--by"


def test_build_tells_what_it_made(capsys, tmp_path):
    pytest.importorskip("pythonfmu", reason="needs the extra build")
    script, fmu = ROOT / "fmus" / "SatellitePair" / "model.py", tmp_path / "x.fmu"
    assert main(["build", str(script), "-o", str(fmu), "--json"]) == 0
    (answer,) = reported(capsys)
    reported_of = {"path": str(fmu), "model": "SatellitePair", "fmi_version": "2.0"}
    assert answer == {"exit_code": 0, "form": "python", **reported_of}
    native = [*("build", str(script), "-o", str(fmu), "--form", "native"), "--platforms", "none", "--json"]
    assert main(native) == 0
    (answer,) = reported(capsys)
    assert {**reported_of, "form": "compiled", "platforms": []}.items() <= answer.items()
    assert answer["counts"]["states"] > 0 and answer["notes"]
    assert main(["build", str(tmp_path / "model.txt"), "--json"]) == 1
    (answer,) = reported(capsys)
    assert answer["exit_code"] == 1 and answer["error"]["kind"] == "BuildError"


def test_without_the_option_nothing_is_json(capsys):
    assert main(["list"]) == 0
    with pytest.raises(json.JSONDecodeError):
        json.loads(capsys.readouterr().out)
