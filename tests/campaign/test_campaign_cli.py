"""The commands `sweep` and `store`."""

from __future__ import annotations

import csv
import json

import pyarrow.parquet as pq
import pytest

from orchestrator.cli.main import main

STUDY = """
format: sweep/1
system: docking-1d-uncompensated
set: {run.stop_time: 0.8 s, run.step_size: 8 ms, run.loop: python, satellite.form: native}
design:
  grid: {robot.tau_m: [4 ms, 8 ms, 12 ms]}
derived: {peak: max(abs(contact.force))}
record: {every: 10, signals: [contact.force]}
"""


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sweeps")
    (folder / "delays.yaml").write_text(STUDY)
    assert main(["sweep", str(folder / "delays.yaml"), "--store", str(folder / "store"), "--quiet"]) == 0
    return folder / "store"


def test_a_sweep_tells_what_it_came_to(store, capsys):
    study = str(store.parent / "delays.yaml")
    assert main(["sweep", study, "--store", str(store)]) == 0
    reported = capsys.readouterr()
    assert reported.out.startswith("3 points: 0 runs made, 3 found in the store, 0 failed; ")
    assert reported.err == ""  # no bar where there is no terminal
    assert main(["sweep", study, "--store", str(store), "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert (data["points"], data["made"], data["reused"], data["failed"]) == (3, 0, 3, {})
    assert main(["sweep", study, "--check"]) == 0
    assert capsys.readouterr().out == "delays: 3 points over robot.tau_m\n"


def test_the_store_is_listed_shown_queried_and_exported(store, capsys, tmp_path):
    assert main(["store", "list", str(store), "--json"]) == 0
    (study,) = json.loads(capsys.readouterr().out)
    assert (study["title"], study["points"], study["done"], study["failed"]) == ("delays", 3, 3, 0)
    assert main(["store", "show", str(store)]) == 0
    shown = capsys.readouterr().out
    assert "units: robot.tau_m [s]" in shown and "peak.change" in shown
    assert main(["store", "query", str(store), "select null as nothing, point from sweep order by 2"]) == 0
    assert [one.split() for one in capsys.readouterr().out.splitlines()] == [
        ["nothing", "point"], *(["-", str(n)] for n in range(3))
    ]  # fmt: skip
    assert (
        main(["store", "query", str(store), "select point, run, peak from sweep order by point", "--json"])
        == 0
    )
    rows = json.loads(capsys.readouterr().out)
    assert [row["point"] for row in rows] == [0, 1, 2]
    assert rows[0]["peak"] < rows[1]["peak"] < rows[2]["peak"]
    assert main(["store", "show", str(store), rows[1]["run"][:10]]) == 0
    assert "contacts[0].cor" in capsys.readouterr().out
    assert main(["store", "query", str(store), "select count(*) as n from trajectories", "--csv"]) == 0
    assert capsys.readouterr().out.split() == ['"n"', "33"]
    out = tmp_path / "out"
    assert main(["store", "export", str(store), "--out", str(out), "--format", "csv,parquet"]) == 0
    assert capsys.readouterr().out == f"3 rows of sweep written to {out}: sweep.csv, sweep.parquet\n"
    with (out / "sweep.csv").open() as file:
        written = {int(row["point"]): float(row["peak"]) for row in csv.DictReader(file)}
    assert written == {row["point"]: row["peak"] for row in rows}
    table = pq.read_table(out / "sweep.parquet").to_pylist()
    assert {row["point"]: row["peak"] for row in table} == written


def test_bad_commands_are_refused_with_all_that_is_wrong(tmp_path, capsys, store):
    path = tmp_path / "bad.yaml"
    path.write_text(STUDY.replace("4 ms", "4 N"))
    assert main(["sweep", str(path), "--jobs", "0"]) == 2
    reported = capsys.readouterr().err
    assert (
        "--jobs: got 0" in reported and "--store: is missing" in reported and "cannot take '4 N'" in reported
    )
    assert main(["sweep", str(path), "--out", "here"]) == 2
    reported = capsys.readouterr().err
    assert "--out: is no option of sweep" in reported and "Did you mean --store here?" in reported
    assert main(["store", "query", str(store), "select nothing from nowhere"]) == 2
    assert "nowhere" in capsys.readouterr().err
    assert main(["store", "show", str(store), "zzz"]) == 2
    assert "no study 'zzz'" in capsys.readouterr().err
    assert (
        main(["store", "export", str(store), "--out", str(tmp_path / "x"), "--format", "xls", "--views", "y"])
        == 2
    )
    reported = capsys.readouterr().err
    assert "no format 'xls'" in reported and "no view 'y'" in reported
    assert main(["store", "list", str(tmp_path)]) == 2
    assert "is not a store of runs" in capsys.readouterr().err


def test_a_sweep_whose_runs_all_fail_ends_with_one(tmp_path, capsys):
    path = tmp_path / "short.yaml"
    path.write_text(STUDY + "time_limit: 1 ms\n")
    assert main(["sweep", str(path), "--store", str(tmp_path / "store"), "--jobs", "1"]) == 1
    reported = capsys.readouterr().out
    assert "3 failed" in reported
    assert "  time limit: 3, for example: took longer than 0.001 s, and was ended" in reported


def test_a_store_that_is_a_file_is_refused_before_anything_runs(tmp_path, capsys, store):
    study, file = str(store.parent / "delays.yaml"), tmp_path / "file"
    file.write_text("mine")
    assert main(["sweep", study, "--store", str(file), "--quiet"]) == 2
    reported = f"orchestrator: {file}: is a file\n  a folder, which is made if need be\n"
    assert capsys.readouterr().err == reported
    assert main(["sweep", study, "--store", str(file / "in"), "--quiet"]) == 2
    assert f"cannot make the folder {file / 'in'} (" in capsys.readouterr().err
    assert file.read_text() == "mine"
