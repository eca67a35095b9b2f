"""From config to files, and the command line: what is written, printed and returned."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import fmpy
import numpy as np
import pytest
from archives import repack

from orchestrator.base.errors import ConfigError, OrchestratorError, StepError
from orchestrator.cli.main import main
from orchestrator.results.measures import changes, signal_changes
from orchestrator.results.recorders import Results, read_results
from orchestrator.simulation.run import prepare, run


@pytest.fixture
def config(tmp_path, python_fmu) -> Path:
    """Two integrators in a chain, the first fed by a constant; with the ways to fail of misbehaving.py."""
    path = tmp_path / "tanks.yaml"
    fmu = python_fmu("misbehaving")
    path.write_text(
        f"""
title: Two tanks
run: {{master: jacobi, step_size: 10 ms, stop_time: 0.5 s}}
instances:
  one: {{fmu: {fmu}, start: {{rate: 1.0}}, feedthrough: {{level: []}}}}
  two: {{fmu: {fmu}}}
connections:
  - one.level -> two.rate
"""
    )
    return path


def command(*arguments, **options) -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, "-m", "orchestrator", *map(str, arguments)],
        capture_output=True, text=True, timeout=120, cwd=Path(__file__).parents[2], **options,
    )  # fmt: skip


def loads_strictly(path: Path) -> dict:
    def refuse(name):
        raise AssertionError(f"{name} is no JSON")

    return json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)


def test_a_run_writes_everything_that_it_returns(config, tmp_path):
    out = tmp_path / "out"
    result = run(config, out=out, overrides=["one.rate=2.0"], formats=("csv", "parquet", "mat"))
    assert sorted(path.name for path in out.iterdir()) == sorted(result.files)
    assert set(result.files) == {
        "config.yaml", "results.arrow", "results.csv", "results.parquet", "results.mat", "summary.json",
        "signals.png",
    }  # fmt: skip
    summary = loads_strictly(out / "summary.json")
    assert summary == json.loads(json.dumps(result.summary))
    assert {"title", "config", "run", "notes", "numerics", "parameters", "provenance"} == set(summary)
    assert summary["run"]["master"] == "jacobi"
    assert summary["run"]["steps"] == 50 and summary["run"]["step_size"] == 0.01
    assert summary["run"]["simulated_time"] == 0.5 and summary["run"]["wall_time"] > 0.0
    assert set(summary["run"]["instance_time"]) == {"one", "two"}
    assert summary["parameters"]["one.rate"] == 2.0
    provenance = summary["provenance"]
    assert provenance["fmus"]["one"]["checksum"].startswith("sha256:")
    assert provenance["packages"]["fmpy"] and provenance["python"]
    for suffix in ("arrow", "csv", "parquet", "mat"):
        again = read_results(out / f"results.{suffix}")
        for name in result.results.signals:
            assert again[name].tobytes() == result.results[name].tobytes()
    assert read_results(out).parameters["one.rate"] == 2.0


def test_the_written_config_runs_to_the_same_numbers(config, tmp_path):
    first = run(config, out=tmp_path / "a", overrides=["one.rate=2.0"], halving=False, figures=False)
    again = run(tmp_path / "a" / "config.yaml", halving=False)
    assert prepare(tmp_path / "a" / "config.yaml").config.model == first.prepared.config.model
    for name in first.results.signals:
        assert again.results[name].tobytes() == first.results[name].tobytes()


def test_the_written_config_runs_where_it_lies(config, tmp_path, python_fmu):
    """A path that is relative to the config is rewritten for the folder of the results."""
    (tmp_path / "parts").mkdir()
    shutil.copy(python_fmu("misbehaving"), tmp_path / "parts" / "tank.fmu")
    overrides = ["one.fmu=parts/tank.fmu", "two.fmu=parts/tank.fmu"]
    run(config, out=tmp_path / "deep" / "out", overrides=overrides, halving=False, figures=False)
    assert "fmu: ../../parts/tank.fmu" in (tmp_path / "deep" / "out" / "config.yaml").read_text()
    assert len(run(tmp_path / "deep" / "out" / "config.yaml", halving=False).results) == 51


def test_files_in_overrides_are_where_those_are_written(config, tmp_path, python_fmu, monkeypatch):
    """In the working directory or the folder that is given and, where they are not, in the config's."""
    study, away = tmp_path / "study", tmp_path / "away"
    for folder in (study, away, tmp_path):
        folder.mkdir(exist_ok=True)
        shutil.copy(python_fmu("misbehaving"), folder / "tank.fmu")
    monkeypatch.chdir(away)
    overrides = ["one.fmu=tank.fmu"]

    def file(*folder):
        return prepare(config, overrides, *folder).system.instances[0].fmu.path

    assert file() == away / "tank.fmu"
    assert file(study) == study / "tank.fmu"
    assert main(["check", str(config), "--set", "one.fmu=./tank.fmu"]) == 0
    run(
        "docking-1d-uncompensated", overrides=["run.stop_time=1 ms", "robot.fmu=RobotResponse"], halving=False
    )
    (study / "tank.fmu").unlink()
    assert file(study) == tmp_path / "tank.fmu"
    (tmp_path / "tank.fmu").unlink()
    with pytest.raises(ConfigError) as caught:
        file(study)
    assert str(caught.value).startswith(
        f"--set one.fmu=tank.fmu: instances.one.fmu: no file {study}/tank.fmu\n  bundled FMUs: "
    )


def test_effects_in_overrides_are_from_where_those_are_written(config, tmp_path, monkeypatch):
    effect = "from orchestrator.effects import Effect\n\n\nclass Nothing(Effect):\n    pass\n"
    (tmp_path / "away").mkdir()
    (tmp_path / "away" / "mine.py").write_text(effect)
    monkeypatch.chdir(tmp_path / "away")
    prepare(config, ["connections[two.rate].through=[{effect: 'mine.py:Nothing'}]"])
    with pytest.raises(ConfigError) as caught:
        prepare(config, ["connections[two.rate].through=[{effect: 'mine.py:Other'}]"])
    place = (
        "--set connections[two.rate].through=[{effect: 'mine.py:Other'}]: connections[0].through[0].effect"
    )
    assert str(caught.value) == (f"{place}: {tmp_path}/away/mine.py has no 'Other'\n  effects in it: Nothing")


def test_numerics_are_what_half_the_step_changes(config):
    result = run(config)
    halved = run(config, overrides=["run.step_size=5 ms"], halving=False)
    assert result.summary["numerics"]["step_size"] == 0.005
    apart = np.abs(halved.results["two.level"][::2] - result.results["two.level"])
    found = result.summary["numerics"]["signals"]["two.level"]
    assert found["max_change"] == apart.max() > 0.0
    assert found["relative"] == pytest.approx(apart.max() / np.ptp(result.results["two.level"]))
    # Jacobi's explicit Euler: two.level = (t^2 - h t)/2, so half the step changes it by h t/4.
    assert found["max_change"] == pytest.approx(0.01 * 0.5 / 4)
    assert "numerics" not in run(config, halving=False).summary


def test_numerics_hold_for_thinned_recordings(config):
    result = run(config, overrides=["run.record_every=5", "run.record=[two.level]"])
    assert len(result.results) == 11
    assert list(result.summary["numerics"]["signals"]) == ["two.level"]
    assert result.summary["numerics"]["signals"]["two.level"]["max_change"] == pytest.approx(0.01 * 0.5 / 4)


def test_changes_keep_the_measures_shape():
    before = {"a": 1.0, "b": [{"x": 1, "side": "front"}, {"x": 2}], "c": None, "d": True, "e": {"f": 3.0}}
    after = {"a": 1.5, "b": [{"x": 4, "side": "rear"}], "c": 2.0, "d": False, "e": {"f": None}}
    assert changes(before, after) == {
        "a": 0.5,
        "b": [{"x": 3, "side": None}, {"x": None}],
        "c": None,
        "d": None,
        "e": {"f": None},
    }


def test_signal_changes_of_a_constant_have_no_range():
    one = Results(np.array([0.0, 1.0]), {"a": np.array([2.0, 2.0])})
    two = Results(np.array([0.0, 0.5, 1.0]), {"a": np.array([2.0, 9.0, 3.0])})
    assert signal_changes(one, two) == {"a": {"max_change": 1.0, "relative": None}}


# Failures.


def test_an_fmu_that_fails_within_a_run_leaves_readable_results(config, tmp_path):
    out = tmp_path / "out"
    with pytest.raises(StepError) as caught:
        run(config, out=out, overrides=["one.way=error", "one.at=0.3"])
    error = caught.value
    assert str(error).splitlines()[0] == "one at time 0.3 s: fmi2DoStep returned fatal"
    assert any("the tank is empty" in line or "nothing left to integrate" in line for line in error.log)
    results = read_results(out)
    assert results.time.tolist() == [n / 100 for n in range(31)]
    assert results["one.level"][-1] == pytest.approx(0.3)
    summary = loads_strictly(out / "summary.json")
    assert summary["error"]["message"] == str(error)
    assert (summary["error"]["instance"], summary["error"]["time"]) == ("one", 0.3)
    assert error.result.results.time.tolist() == results.time.tolist()


def test_a_nan_from_an_fmu_stops_the_run_by_name(config, tmp_path):
    with pytest.raises(StepError) as caught:
        run(config, out=tmp_path / "out", overrides=["one.way=nan", "one.at=0.3"])
    assert str(caught.value) == (
        "one at time 0.31 s: level (no unit) is nan\n"
        "  Check the values that it is given, or take a smaller step size."
    )
    assert read_results(tmp_path / "out").time[-1] == 0.3


def test_an_fmu_that_ends_the_simulation(config):
    made = run(config, overrides=["one.way=terminate", "one.at=0.3"])
    assert made.summary["run"]["ended"] == {"instance": "one", "time": 0.3}
    assert made.results.time[-1] == 0.3


def test_a_failing_second_run_is_reported_and_keeps_the_first(config, capsys):
    # Only the run with half the step has an instant after 0.5 s - 10 ms.
    overrides = ["one.way=nan", "one.at=0.494"]
    result = run(config, overrides=overrides)
    assert result.summary["numerics"]["error"]["status"] == "not finite"
    assert result.summary["numerics"]["step_size"] == 0.005
    assert len(result.results) == 51
    assert main(["run", str(config), "--set", overrides[0], "--set", overrides[1]]) == 0
    assert "The run with half the step size failed" in capsys.readouterr().out


def test_an_fmu_of_another_platform_is_refused_before_anything_is_simulated(config, tmp_path, python_fmu):
    other = repack(
        python_fmu("misbehaving"),
        tmp_path / "Other.fmu",
        lambda name, data: None if name.startswith("binaries/") else (name, data),
    )
    with pytest.raises(ConfigError) as caught:
        prepare(config, [f"one.fmu={other}"])
    assert str(caught.value).splitlines() == [
        f"--set one.fmu={other}: instances.one.fmu: {other}: no binary for this platform, "
        f"{fmpy.platform}; it has binaries for: none",
        f"  Export it for {fmpy.platform}, or run it on a platform that it has.",
        "Not checked because of these problems: ports and start values of one.",
    ]


def test_all_kinds_of_problems_are_reported_together(config):
    with pytest.raises(ConfigError) as caught:
        prepare(config, ["run.master=jacoby", "run.stop_time=5.005 s", "one.rat=1"])
    assert [problem.what for problem in caught.value.problems] == [
        "no master 'jacoby'",
        "one has no variable 'rat'",
        "stop_time 5.005 s is 500.5 steps of 10 ms away",
    ]


def test_measures_are_refused_with_the_rest(tmp_path, config):
    config.write_text(
        config.read_text() + "measures:\n  docking: {satellite: one, robots: two}\n  dockin: {}\n"
    )
    with pytest.raises(ConfigError) as caught:
        prepare(config)
    assert str(caught.value).splitlines() == [
        "tanks.yaml:10: measures.docking: contact is missing",
        "  it has no default",
        "tanks.yaml:10: measures.docking.robots: unknown key 'robots'",
        "  allowed: satellite, robot, contact, controller. Did you mean robot?",
        "tanks.yaml:11: measures.dockin: no measure 'dockin'",
        "  measures: docking, docking-space. Did you mean docking or docking-space?",
        "Not checked because of these problems: signals of measures.docking.",
    ]


# The command line.


def test_exit_codes_and_messages(config, tmp_path, capsys):
    assert main(["run", str(config), "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")
    assert main(["run", str(config), "--set", "run.master=x"]) == 2
    assert capsys.readouterr().err == (
        "orchestrator: --set run.master=x: run.master: no master 'x'\n"
        "  masters: jacobi, gauss-seidel, iterative, adaptive\n"
    )
    assert main(["run", str(config), "--set", "one.way=nan", "--set", "one.at=0.1"]) == 1
    assert capsys.readouterr().err.startswith("orchestrator: one at time 0.11 s: level (no unit) is nan\n")
    with pytest.raises(SystemExit) as caught:
        main(["walk"])
    assert caught.value.code == 2


def test_the_command_prints_a_table_and_where_it_wrote(config, tmp_path):
    done = command("run", config, "--out", tmp_path / "out", "--format", "csv,mat")
    assert done.returncode == 0 and done.stderr == ""
    lines = done.stdout.splitlines()
    assert lines[0] == "Two tanks" and lines[1].startswith("50 steps of 0.01 s, jacobi, in ")
    assert any("two.level" in line and "0.00125" in line for line in lines)
    assert lines[-1] == (
        f"Written to {tmp_path / 'out'}: config.yaml, results.arrow, summary.json, results.csv, results.mat, "
        "signals.png"
    )


def test_check_tells_order_conversions_and_notes(config, capsys):
    assert main(["check", str(config)]) == 0
    printed = capsys.readouterr().out
    assert "tanks: 2 instances, 1 connections" in printed
    assert "order of direct feedthrough: one, two" in printed
    assert main(["check", str(config), "--set", "two.rate=1.0"]) == 2
    assert "two.rate has two sources, one.level and a start value" in capsys.readouterr().err


def test_a_run_tells_its_notes_once(config, tmp_path, capsys):
    """The FMUs, by pythonfmu, declare no dependencies: each passes its level to the other's rate."""
    looped = tmp_path / "loop.yaml"
    text = config.read_text().replace("start: {rate: 1.0}, feedthrough: {level: []}", "feedthrough: {}")
    looped.write_text(text + "  - two.level -> one.rate\n")
    out = tmp_path / "out"
    assert main(["run", str(looped), "--out", str(out), "--no-figures"]) == 0
    notes = loads_strictly(out / "summary.json")["notes"]
    assert len(notes) == 1 and "an algebraic loop that is only assumed" in notes[0]
    assert capsys.readouterr().err == f"note: {notes[0]}\n"
    assert main(["check", str(looped), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["notes"] == notes
    assert main(["run", str(looped), "--quiet"]) == 0
    assert capsys.readouterr().err == ""
    # Notes of a run that fails are printed, too, each with the name of its config.
    assert main(["run", str(looped), str(config), "--set", "two.way=nan", "--set", "two.at=0.1"]) == 1
    assert capsys.readouterr().err.startswith(f"loop: note: {notes[0]}\norchestrator: two at time 0.11 s: ")


def test_schema_and_list(capsys):
    assert main(["schema"]) == 0
    assert json.loads(capsys.readouterr().out)["properties"]["run"]
    assert main(["list"]) == 0
    printed = capsys.readouterr().out
    assert "docking-1d" in printed and "gauss-seidel" in printed


@pytest.mark.skipif(sys.platform == "win32", reason="sends a POSIX signal")
def test_a_folder_that_cannot_be_written_to_is_refused_before_the_run(config, tmp_path, capsys):
    out = tmp_path / "out"
    (out / "summary.json").mkdir(parents=True)
    assert main(["run", str(config), "--out", str(out)]) == 2
    assert f"orchestrator: cannot write to the folder {out} (" in capsys.readouterr().err
    assert not (out / "results.arrow").exists()


def test_what_an_earlier_run_left_is_not_taken_for_this_ones(config, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out/coupling.csv").write_text("of an earlier run")
    run(config, out=tmp_path / "out", figures=False)
    assert not (tmp_path / "out/coupling.csv").exists()


@pytest.mark.parametrize("fails", [False, True])
def test_a_full_disk_at_the_end_is_reported_beside_what_went_wrong(config, tmp_path, monkeypatch, fails):
    def refuse(self, path):
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr(Results, "write", refuse)
    overrides = ["one.way=error", "one.at=0.2"] if fails else []
    with pytest.raises(OrchestratorError) as caught:
        run(config, out=tmp_path / "out", overrides=overrides)
    assert isinstance(caught.value, StepError) == fails
    assert f"{tmp_path / 'out'}: not all files could be written ([Errno 28] No space" in str(caught.value)
    assert len(read_results(tmp_path / "out/results.arrow")) == (21 if fails else 51)
    assert json.loads((tmp_path / "out/summary.json").read_text())["title"] == "Two tanks"
    assert caught.value.result.summary["run"]["steps"] == 50


def test_an_interrupted_run_keeps_its_results(config, tmp_path):
    out = tmp_path / "out"
    process = subprocess.Popen(
        [sys.executable, "-m", "orchestrator", "run", str(config), "--out", str(out),
         "--set", "run.stop_time=1 h"],
        stderr=subprocess.PIPE, text=True, cwd=Path(__file__).parents[2], env={**os.environ},
    )  # fmt: skip
    rows = 0
    deadline = time.monotonic() + 60.0
    while rows < 1000 and time.monotonic() < deadline:
        time.sleep(0.2)
        file = out / "results.arrow"
        rows = len(read_results(file)) if file.is_file() and file.stat().st_size > 4096 else 0
    process.send_signal(signal.SIGINT)
    _, printed = process.communicate(timeout=30)
    assert process.returncode == 130
    assert "interrupted; what was recorded until then is kept" in printed
    assert len(read_results(out)) >= rows >= 1000
    assert loads_strictly(out / "summary.json")["error"]["kind"] == "Interrupted"


def test_several_systems_are_run_and_compared(tmp_path):
    from orchestrator.cli.main import main

    out = tmp_path / "out"
    names = ["docking-1d-uncompensated", "docking-1d"]
    common = ["--out", str(out), "--no-halving", "--quiet", "--set", "run.stop_time=0.6 s"]
    assert main(["run", *names, *common]) == 0
    assert sorted(entry.name for entry in out.iterdir()) == ["comparison.png", *sorted(names)]
    for name in names:
        assert (out / name / "summary.json").is_file()


def test_figures_of_an_earlier_run_do_not_stand_beside_a_new_one(tmp_path):
    from orchestrator.results.measures import COMPARISONS, FIGURES
    from orchestrator.simulation.comparison import run_each

    for system, stop in (("docking-1d", "0.6 s"), ("docking-6d", "0.1 s")):
        out = tmp_path / system
        first = run(system, out=out, overrides=[f"run.stop_time={stop}"], halving=False)
        drawn = {one for one in first.files if one.endswith(".png")}
        assert drawn - {"signals.png", "coupling.png"} <= {f"{one}.png" for one in FIGURES}
        (out / "mine.png").write_bytes(b"mine")
        (out / "realtime.png").write_bytes(b"of a paced run")
        run(system, out=out, overrides=["run.stop_time=0.1 s"], halving=False, figures=False)
        assert {one.name for one in out.glob("*.png")} == {"mine.png"}
    whole = tmp_path / "several"
    whole.mkdir()
    for name in COMPARISONS:
        (whole / f"{name}.png").write_bytes(b"of earlier runs")
    pair = ["docking-1d", "docking-1d-osaki"]
    list(run_each(pair, out=whole, overrides=["run.stop_time=0.1 s"], halving=False, figures=False))
    assert not list(whole.glob("*.png"))


def test_results_of_a_folder_that_is_not_there(tmp_path, capsys):
    assert main(["export-results", str(tmp_path / "nope")]) == 2
    reported = f"orchestrator: {tmp_path / 'nope'}: no such folder\n  what `run --out` wrote to\n"
    assert capsys.readouterr().err == reported


def test_energies_beyond_the_range_of_numbers_warn_of_nothing_before_the_error(tmp_path):
    overrides = ["robot.tau_m=20 ms", "run.step_size=1 ms", "run.stop_time=70 s"]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(StepError, match=r"satellite at time .* is inf"):
            run("docking-1d-uncompensated", overrides=overrides, out=tmp_path / "out")


def test_problems_of_all_systems_are_reported_before_any_runs(tmp_path, capsys):
    from orchestrator.cli.main import main

    out = tmp_path / "out"
    assert main(["run", "docking-1d", "docking-2d", "docking-3d", "--out", str(out)]) == 2
    reported = capsys.readouterr().err
    assert "docking-2d" in reported and "docking-3d" in reported
    assert not out.exists()


def test_two_systems_of_one_name_need_two_folders(tmp_path, capsys):
    from orchestrator.cli.main import main

    assert main(["run", "docking-1d", "docking-1d", "--out", str(tmp_path / "out")]) == 2
    assert "several systems are called docking-1d" in capsys.readouterr().err
