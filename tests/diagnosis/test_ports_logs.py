"""Studies and logs of any system that are not what they are said to be."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from ports_bench import COULOMB, change_log, checked, study

from orchestrator.base.errors import ConfigError
from orchestrator.cli.main import main
from orchestrator.diagnosis.study.channels import clipped
from orchestrator.diagnosis.study.reader import load_port_study
from orchestrator.diagnosis.unknown_input.diagnose import diagnose_system
from orchestrator.diagnosis.unknown_input.model import StateModel
from orchestrator.diagnosis.unknown_input.thinning import without_outliers


def test_all_that_is_wrong_with_a_study_is_reported_at_once(noiseless, capsys):
    data = yaml.safe_load((noiseless / "study.yaml").read_text())
    data["columns"]["drive.positon"] = data["columns"].pop("drive.position")
    data["columns"]["drive.voltage"] = {"column": "controller.voltage", "unit": "V", "noise": "1 V"}
    data["calibrated"] = {"drive.mass": {"tolerance": "2 N"}, "drive.masss": {"tolerance": "2 kg"}}
    data["settle"] = "2 m"
    (noiseless / "wrong.yaml").write_text(yaml.safe_dump(data))
    with pytest.raises(ConfigError) as caught:
        load_port_study(noiseless / "wrong.yaml")
    places = [one.place.partition(": ")[2] for one in caught.value.problems]
    assert places == ["calibrated.drive.mass.tolerance", "calibrated.drive.masss.tolerance",
                      "columns.drive.positon", "columns.drive.voltage", "settle"]  # fmt: skip
    reported = str(caught.value)
    assert (
        "Did you mean drive.position" in reported
        and "drive.voltage: an input is fed what was logged" in reported
    )
    assert main(["diagnose", str(noiseless / "wrong.yaml")]) == 2
    assert "drive.positon" in capsys.readouterr().err


def test_refused_runs(noiseless):
    data = yaml.safe_load((noiseless / "study.yaml").read_text())
    data["set"] = ["run.step_size=1 ms"]
    (noiseless / "step.yaml").write_text(yaml.safe_dump(data))
    with pytest.raises(ConfigError, match=r"samples are 0\.002 s apart"):
        load_port_study(noiseless / "step.yaml")
    data["set"] = ["run.step_size=2 ms"]
    data["runs"][0] |= {"from": "1 s", "to": "0.5 s"}
    (noiseless / "empty.yaml").write_text(yaml.safe_dump(data))
    with pytest.raises(ConfigError, match="holds no samples"):
        load_port_study(noiseless / "empty.yaml")
    data["runs"][0] |= {"from": "0 s", "to": "1 s"}
    data["runs"][0]["rolle"] = "train"
    (noiseless / "key.yaml").write_text(yaml.safe_dump(data))
    with pytest.raises(
        ConfigError, match=r"(?s)key\.yaml:\d+: runs\[0\]\.rolle: unknown key .*allowed: file, role"
    ):
        load_port_study(noiseless / "key.yaml")


def test_a_compared_log_may_have_gaps_which_are_not_compared(noiseless, tmp_path):
    folder = tmp_path / "gaps"
    shutil.copytree(noiseless, folder)

    def emptied(column: str, rows: range) -> Path:
        path = folder / "run-0.csv"
        lines = (noiseless / "run-0.csv").read_text().splitlines()
        at = [name.partition(" ")[0] for name in lines[0].split(",")].index(column)
        for row in rows:
            cells = lines[1 + row].split(",")
            lines[1 + row] = ",".join("" if k == at else cell for k, cell in enumerate(cells))
        path.write_text("\n".join(lines) + "\n")
        return folder

    taken = load_port_study(emptied("drive.position", range(100, 110)))
    port = next(iter(taken.runs[0].gaps))
    assert str(port) == "drive.position" and np.isfinite(taken.runs[0].logs[port]).all()
    with StateModel(taken) as model:
        cleaned, remarks = without_outliers(model)
    assert np.flatnonzero(np.isnan(cleaned.runs[0].logs[port])).tolist() == list(range(100, 110))
    assert remarks == [
        "run-0: drive.position: 10 of 1001 rows hold nothing, first row 100. They are not compared."
    ]
    for column, rows, more in (
        ("path.position", range(100, 110), "by `from` and `to`."),
        ("drive.position", range(1), "but not the first or last."),
        ("drive.position", range(100, 300), "Up to 10 % of its rows may be empty"),
    ):
        with pytest.raises(ConfigError, match=rf"(?s)row {rows[0]} of column {column} holds nothing.*{more}"):
            load_port_study(emptied(column, rows))


def test_logs_that_break_off_or_stand_twice_are_refused(noiseless):
    data = yaml.safe_load((noiseless / "study.yaml").read_text())
    lines = (noiseless / data["runs"][0]["file"]).read_text().splitlines(keepends=True)
    (noiseless / "gap.csv").write_text("".join([*lines[:301], *lines[331:]]))
    (noiseless / "copy.csv").write_text("".join(lines))
    changed = [data["runs"][0] | {"file": "gap.csv"}, *data["runs"][1:]]
    for name, runs, said in (
        ("gap", changed, r"gap.csv: time: row 300 comes 0\.062 s after the one before; 1 such in all"),
        ("copy", [*data["runs"], data["runs"][0] | {"file": "copy.csv"}], "hold the same log"),
        ("repeat", [*data["runs"], data["runs"][1] | {"repeats": "r9", "name": "again", "to": "1 s"}],
         "again repeats r9, which is no run"),
        ("short", [data["runs"][0] | {"to": "0.1 s"}, *data["runs"][1:]], "has 50 samples"),
    ):  # fmt: skip
        (noiseless / f"{name}.yaml").write_text(yaml.safe_dump(data | {"runs": runs}))
        with pytest.raises(ConfigError, match=said) as caught:
            load_port_study(noiseless / f"{name}.yaml")
        # A run of training that cannot be read is one all the same.
        assert "no run has the role train" not in str(caught.value)


def test_a_sign_or_unit_that_the_study_gives_is_to_be_corrected_there(tmp_path):
    folder = study(tmp_path)
    data = yaml.safe_load((folder / "study.yaml").read_text())
    data["columns"]["drive.position"] |= {"sign": -1}
    (folder / "study.yaml").write_text(yaml.safe_dump(data))
    (problem,) = checked(load_port_study(folder))[0]
    assert problem.remedy.endswith("The study file says `sign: -1`: take that out.")
    data["columns"]["drive.position"] |= {"sign": 1, "unit": "mm"}
    (folder / "study.yaml").write_text(yaml.safe_dump(data))
    (problem,) = checked(load_port_study(folder))[0]
    assert problem.remedy.endswith("The study file says `unit: mm`: correct that.")


def test_a_tolerance_as_large_as_its_value_is_reported(tmp_path):
    folder = study(tmp_path)
    data = yaml.safe_load((folder / "study.yaml").read_text())

    def reported(**tolerances: str) -> list[str]:
        data["calibrated"] = {f"drive.{name}": {"tolerance": one} for name, one in tolerances.items()}
        (folder / "study.yaml").write_text(yaml.safe_dump(data, sort_keys=False))
        warned = checked(load_port_study(folder))[1]
        return [f"{one.place}: {one.what}. {one.remedy}" for one in warned if "calibrated" in one.place]

    assert reported(mass="90 kg", viscous_friction="200 N.s/m") == []
    (said,) = reported(mass="2 kg", viscous_friction="407 N.s/m")
    assert said.endswith(
        "calibrated.drive.viscous_friction.tolerance: 407 N.s/m is 200 % of the value and leaves its sign "
        "open; expected, as one standard deviation: below 203.5 N.s/m. Give what the calibration is known "
        "to: the search moves a number by up to three tolerances without a reason."
    )
    assert len(reported(mass="100 kg", viscous_friction="407 N.s/m")) == 2


def test_runs_that_were_driven_otherwise_repeat_nothing(tmp_path):
    folder = study(tmp_path)
    data = yaml.safe_load((folder / "study.yaml").read_text())
    first, second = (one["file"].partition(".")[0] for one in data["runs"][:2])
    again = folder / "again.csv"
    again.write_text((folder / f"{second}.csv").read_text())
    with change_log(again) as columns:
        columns["drive.position"] += 1e-6
    data["runs"].append({"file": again.name, "role": "repeat", "repeats": first})
    (folder / "study.yaml").write_text(yaml.safe_dump(data))
    own = load_port_study(folder)
    (found,) = [one for one in checked(own)[1] if one.place == "again"]
    said = f"path.position differs from that of {first}, which it is said to repeat, by "
    assert found.what.startswith(said)
    assert found.what.endswith("; the noise is estimated without this run")
    alike = [replace(run, repeats=second) if run.name == "again" else run for run in own.runs]
    assert not [one for one in checked(replace(own, runs=tuple(alike)))[1] if one.place == "again"]


def test_noise_that_is_fed_is_warned_of(tmp_path):
    """The voltage drives the drive by as much noise as the log has, where it is fed."""
    folder = study(tmp_path)
    data = yaml.safe_load((folder / "study.yaml").read_text())

    def reported(noise: str) -> list[str]:
        data["columns"]["controller.voltage"] |= {"feed": True, "noise": noise}
        (folder / "study.yaml").write_text(yaml.safe_dump(data))
        return [one.what for one in checked(load_port_study(folder))[1] if "is fed" in one.what]

    assert reported("0.05 mV") == []
    (what,) = reported("5 mV")
    assert "which moves drive.position by" in what


@pytest.mark.parametrize(
    ("column", "factor", "said"),
    [
        ("drive.position", -1.0, "(?s)drive.position: .*All fits if its sign is reversed"),
        ("path.position", 1e3, "(?s)path.position: .*1000 times too large"),
        ("controller.voltage", 1e-3, "(?s)controller.voltage: .*1000 times too small"),
    ],
)
def test_a_wrong_sign_or_unit_is_named_although_something_is_hidden(tmp_path, column, factor, said):
    path = study(tmp_path, [COULOMB])
    assert checked(load_port_study(path)) == ([], [])
    for log in tmp_path.glob("run-*.csv"):
        with change_log(log) as columns:
            columns[column] *= factor
    with pytest.raises(ConfigError, match=said):
        diagnose_system(path)


def test_exchanged_and_stuck_columns_are_named(tmp_path):
    path = study(tmp_path, [COULOMB])
    with change_log(tmp_path / "run-0.csv") as columns:
        columns["controller.voltage"][400:471] = columns["controller.voltage"][400]
    refused, warned = checked(load_port_study(path))
    assert refused == []
    assert [(one.place, one.what.partition(": ")[2]) for one in warned] == [
        ("run-0: controller.voltage", "frozen for 71 rows")
    ]
    with change_log(tmp_path / "run-0.csv") as columns:
        columns["controller.voltage"], columns["drive.position"] = (
            columns["drive.position"],
            columns["controller.voltage"],
        )
    refused, _ = checked(load_port_study(path))
    assert [one.place for one in refused] == ["run-0: controller.voltage, drive.position"]
    assert "exchanged" in refused[0].remedy


def test_logs_in_which_nothing_moves_are_refused(tmp_path, capsys):
    path = study(tmp_path)
    data = yaml.safe_load((path / "study.yaml").read_text())
    del data["columns"]["controller.voltage"]
    with change_log(tmp_path / "run-0.csv") as columns:
        columns["drive.position"][20:] = 0.25
    (path / "study.yaml").write_text(yaml.safe_dump(data))
    assert main(["diagnose", str(path), "--quiet"]) == 2
    assert capsys.readouterr().err.partition("study.yaml:")[2].partition(" ")[2] == (
        "columns: the logs of all compared ports are constant in the runs of the role train "
        "(drive.position: 0.25 m)\n  one that moves. Check the columns, or take runs in which something "
        "moves; settle less.\n"
    )


def test_an_axis_at_rest_is_not_frozen(tmp_path):
    """Its encoder tells one value for as long; of a channel that stopped, the model moves on."""
    path = study(tmp_path, seed=None)
    rest = 200
    with change_log(tmp_path / "run-0.csv") as columns:
        for name, values in columns.items():
            if name != "time":
                values[rest:] = values[:-rest].copy()
                values[:rest] = 0.0
        position = columns["drive.position"]
        position[:] = np.round(position / 5e-6) * 5e-6
        (one,) = clipped(position)
    assert one.first == 0 and rest <= one.end < rest + 50 and "the lowest" in one.what
    assert checked(load_port_study(path)) == ([], [])
    # A sensor at the end of its range is reported.
    with change_log(tmp_path / "run-1.csv") as columns:
        columns["drive.position"][:] = np.minimum(columns["drive.position"], 0.1)
    assert ["clipped" in one.what for one in checked(load_port_study(path))[1]] == [True]
    with change_log(tmp_path / "run-0.csv") as columns:
        columns["drive.position"][500:700] = columns["drive.position"][500]
    refused, warned = checked(load_port_study(path))
    assert refused == [] and any(one.what.endswith("frozen for 200 rows") for one in warned)
