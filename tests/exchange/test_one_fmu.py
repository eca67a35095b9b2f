"""FMUs without a config: `run X.fmu`, files of signals for inputs, `new`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from unruly import unruly_fmu

from orchestrator.cli.main import main
from orchestrator.exchange.single_fmu import instance_name, times_of
from orchestrator.fmi import bundled, load_fmu
from orchestrator.results.recorders import read_results
from orchestrator.simulation.run import run
from orchestrator.system.external.playback import read_header


@pytest.fixture
def fmu():
    """An integrator of `rate` with the outputs level, through and count."""
    return str(unruly_fmu(2))


def signals(path, text):
    path.write_text(text)
    return str(path)


def test_an_fmu_runs_with_its_default_experiment_or_a_stated_one(fmu, tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["run", fmu, "--out", str(out)]) == 0
    said = capsys.readouterr()
    assert "no default experiment names a stop time: 1 s, unless another is given" in said.err
    assert "no default experiment names a step size: 0.002 s, unless another is given" in said.err
    assert (out / "signals.png").is_file() and (out / "results.csv").is_file()
    results = read_results(out)
    assert list(results.signals) == ["Unruly.level", "Unruly.through", "Unruly.count"]
    assert len(results) == 501
    found = times_of([load_fmu(bundled.find_fmu("RobotResponse")).description])
    assert found.stop > found.start


def test_times_start_values_and_recorded_variables_are_set_on_the_command_line(fmu, tmp_path):
    out = tmp_path / "out"
    command = ["run", fmu, "--stop-time", "2", "--step-size", "100 ms", "--set", "start.rate=3 m"]
    assert main([*command, "--record", "at", "--out", str(out), "--no-figures", "--quiet"]) == 0
    results = read_results(out)
    assert results.time[-1] == 2.0 and len(results) == 21
    assert results["Unruly.level"][-1] == pytest.approx(6.0)
    assert (results["Unruly.at"] == 1e9).all()


def test_a_pattern_that_names_nothing_is_refused_with_what_is_near(fmu, capsys):
    assert main(["run", fmu, "--record", "levle"]) == 2
    said = capsys.readouterr().err
    assert "no variable 'levle' of a number" in said and "Did you mean level" in said


def test_inputs_come_from_a_file_in_its_units(fmu, tmp_path):
    path = signals(tmp_path / "s.csv", "time [ms],rate [mm]\n0,0\n1000,1000\n1000,0\n3000,0\n")
    out = tmp_path / "out"
    command = ["run", fmu, "--input", path, "--stop-time", "2", "--step-size", "1 ms", "--out", str(out)]
    assert main([*command, "--no-figures", "--quiet"]) == 0
    results = read_results(out)
    # A ramp over 1 s, then a jump to zero.
    expected = np.where(results.time < 1.0 - 1e-9, results.time, 0.0)
    assert np.allclose(results["Unruly.through"], expected, rtol=0.0, atol=1e-9)
    assert results["Unruly.level"][-1] == pytest.approx(0.5, abs=2e-3)


@pytest.mark.parametrize("header", ["time,rate (mm)", "time / s;rate / mm", "t [s],Unruly.rate [mm]"])
def test_units_and_names_of_columns(header, fmu, tmp_path):
    line = "0;1000" if ";" in header else "0,1000"
    path = signals(tmp_path / "s.csv", f"{header}\n{line}\n")
    out = tmp_path / "out"
    assert main(["run", fmu, "--input", path, "--out", str(out), "--no-figures", "--quiet"]) == 0
    assert read_results(out)["Unruly.level"][-1] == pytest.approx(1.0)


@pytest.mark.parametrize("header", ["gain [1]", "gain (1)", "gain [-]", "gain[1]", "gain"])
def test_a_column_without_dimension_is_no_element(header, tmp_path):
    (column,) = read_header(Path(signals(tmp_path / "s.csv", f"time,{header}\n0,1\n")))
    assert column == (("gain[1]", "") if header == "gain[1]" else ("gain", header[6:-1]))


def test_a_file_that_ends_early_holds_its_last_values_and_says_so(fmu, tmp_path, capsys):
    path = signals(tmp_path / "s.csv", "time,rate\n0,1\n0.5,1\n")
    assert main(["run", fmu, "--input", path]) == 0
    assert "s.csv ends at 0.5 s; its last values are held" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no header in the first line"),
        ("rate,time\n1,2\n", "the first column is called 'rate'"),
        ("time,rate,rate\n0,1,1\n", "several columns are called rate"),
        ("time,rate\n", "no row of values"),
        ("time,rate\n0,1\n1,x\n2,nan\n3\n", "s.csv:3: rate: 'x' is no number"),
        ("time,rate\n0,1\n1,x\n2,nan\n3\n", "s.csv:4: rate: 'nan' is not finite"),
        ("time,rate\n0,1\n1,x\n2,nan\n3\n", "s.csv:5: 1 values under a header of 2 columns"),
        ("time,rate\n0,1\n2,1\n1,1\n", "the time goes back at 1 s, row 3 of the values"),
        ("time [m],rate\n0,1\n", "m is no unit of time"),
        ("time,rate [wumm]\n0,1\n", "column 'rate'"),
        ("time,rate [N]\n0,1\n", "units differ"),
        ("time,rtae\n0,1\n", "column 'rtae' names no input"),
    ],
)
def test_what_is_wrong_in_a_file_is_reported_with_its_place(text, said, fmu, tmp_path, capsys):
    path = signals(tmp_path / "s.csv", text)
    assert main(["run", fmu, "--input", path]) == 2
    assert said in capsys.readouterr().err


def test_a_file_of_signals_is_an_instance_of_any_system(fmu, tmp_path):
    signals(tmp_path / "drive.csv", "time,v [m]\n0,0\n10,10\n")
    config = {
        "run": {"master": {"name": "adaptive", "tolerance": 1e-3}, "step_size": "0.1 s", "stop_time": "1 s"},
        "instances": {"drive": {"fmu": "drive.csv"}, "one": {"fmu": fmu}},
        "connections": [{"from": "drive.v", "to": "one.rate", "through": [{"gain": 2}]}],
    }
    config["run"]["master"] = "jacobi"
    (tmp_path / "c.yaml").write_text(yaml.safe_dump(config))
    made = run(tmp_path / "c.yaml", halving=False)
    assert made.results["drive.v"] == pytest.approx(made.results.time)
    assert made.results["one.through"][1:] == pytest.approx(2.0 * made.results.time[:-1])
    assert made.summary["provenance"]["fmus"]["drive"]["checksum"].startswith("sha256:")


def test_a_package_runs_and_is_checked_in_the_same_way(fmu, tmp_path, capsys):
    config = {
        "run": {"master": "gauss-seidel", "step_size": "10 ms", "stop_time": "1 s"},
        "instances": {"one": {"fmu": fmu}},
    }
    (tmp_path / "c.yaml").write_text(yaml.safe_dump(config))
    assert main(["export", str(tmp_path / "c.yaml"), "-o", str(tmp_path / "c.ssp")]) == 0
    path = signals(tmp_path / "s.csv", "time,one.rate\n0,1\n")
    capsys.readouterr()
    command = [str(tmp_path / "c.ssp"), "--input", path, "--stop-time", "2 s"]
    assert main(["check", *command, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["steps"] == 200
    out = tmp_path / "out"
    assert main(["run", *command, "--out", str(out), "--no-figures", "--quiet"]) == 0
    assert read_results(out)["one.level"][-1] == pytest.approx(2.0)


def test_a_file_that_is_no_fmu_is_refused(tmp_path, capsys):
    (tmp_path / "x.fmu").write_bytes(b"no archive")
    assert main(["run", str(tmp_path / "x.fmu")]) == 2
    assert "x.fmu" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "name"), [("a.b.Robot", "Robot"), ("2 wheels", "_2_wheels"), ("é", "fmu"), ("Taken", "Taken2")]
)
def test_names_of_instances(text, name):
    assert instance_name(text, ["taken"]) == name


def test_a_config_to_start_from_connects_what_fits_in_one_way_only(tmp_path, capsys):
    fmus = [str(bundled.find_fmu(name)) for name in ("SatelliteDynamics", "RobotResponse", "DockingContact")]
    path = tmp_path / "mine.yaml"
    assert main(["new", *fmus, "-o", str(path)]) == 0
    data = yaml.safe_load(path.read_text())
    assert data["connections"] == ["DockingContact.force -> SatelliteDynamics.force"]
    text = path.read_text()
    assert "#   force [N], Real" in text and "# outputs:" in text
    capsys.readouterr()
    assert main(["check", str(path)]) == 0
    before = path.read_bytes()
    assert main(["new", *fmus, "-o", str(path)]) == 2
    assert "exists" in capsys.readouterr().err and path.read_bytes() == before
    assert main(["new", *fmus[:1], "-o", str(path), "--overwrite"]) == 0
    assert yaml.safe_load(path.read_text())["connections"] == []


def test_bundled_fmus_run_by_name_and_go_into_a_config(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["run", "RobotResponse", "--stop-time", "0.1", "--no-figures", "--quiet"]) == 0
    assert main(["new", "RobotResponse", "DockingContact", "-o", "mine.yaml"]) == 0
    made = yaml.safe_load((tmp_path / "mine.yaml").read_text())
    assert [one["fmu"] for one in made["instances"].values()] == ["RobotResponse", "DockingContact"]
    assert main(["check", "mine.yaml"]) == 0
    capsys.readouterr()
    assert main(["run", "RobotRespons"]) == 2
    assert "Did you mean RobotResponse" in capsys.readouterr().err
