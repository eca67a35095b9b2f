"""Results: exact numbers in every format, streamed so that a killed run can be read."""

from __future__ import annotations

import json
import math
import sys
from fractions import Fraction

import numpy as np
import pytest
from assembled import assemble
from doubles import mass, spring
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.base.errors import ConfigError, OrchestratorError
from orchestrator.cli.main import main
from orchestrator.diagnosis.study.logs import LogError, read_log
from orchestrator.master import create_master
from orchestrator.results import file_formats as formats
from orchestrator.results.recorders import Recorder, Results, parameters_of, read_results
from orchestrator.simulation.grid import Grid
from orchestrator.simulation.loop import simulate
from orchestrator.system.assembly import Part

SAMPLE = Results(
    time=np.array([0.0, 0.1, 0.2]),
    signals={
        "robot.position": np.array([1 / 3, -0.0, 1e-300]),
        "robot.x[1,2]": np.array([1.0, 2.0, 3.0]),
        "a-b.count": np.array([1, 2, 3]),
        "a_b.count": np.array([4, 5, 6]),
        "contact.touching": np.array([True, False, True]),
    },
    units={
        "robot.position": "m",
        "robot.x[1,2]": "N.s/m",
        "a-b.count": "",
        "a_b.count": "",
        "contact.touching": "",
    },
    parameters={"robot.mass": 2.5, "robot.mode": "active", "robot.on": True},
    provenance={"fmus": {"robot": {"checksum": "x"}}},
)


@pytest.mark.parametrize("suffix", formats.FORMATS)
def test_every_format_reads_back_the_same(suffix, tmp_path):
    path = tmp_path / f"results.{suffix}"
    SAMPLE.write(path)
    again = read_results(path)
    assert again.time.tobytes() == SAMPLE.time.tobytes()
    assert list(again.signals) == list(SAMPLE.signals)
    for name, column in SAMPLE.signals.items():
        assert again[name].tolist() == column.tolist()
    assert again.units == SAMPLE.units
    if suffix != "csv":
        assert again.parameters == SAMPLE.parameters and again.provenance == SAMPLE.provenance


def test_csv_as_text(tmp_path):
    SAMPLE.to_csv(tmp_path / "x.csv")
    assert (tmp_path / "x.csv").read_text() == (
        'time [s],robot.position [m],"robot.x[1,2] [N.s/m]",a-b.count,a_b.count,contact.touching\n'
        "0,0.3333333333333333,1,1,4,1\n"
        "0.1,-0,2,2,5,0\n"
        "0.2,1e-300,3,3,6,1\n"
    )


def test_mat_holds_a_struct_per_instance(tmp_path):
    from scipy.io import loadmat

    SAMPLE.to_mat(tmp_path / "x.mat")
    content = loadmat(tmp_path / "x.mat", simplify_cells=True)
    assert content["robot"]["position"].tolist() == SAMPLE["robot.position"].tolist()
    assert content["units"]["robot"]["x_1_2_"] == "N.s/m"


def test_hdf5_holds_a_group_per_instance_and_is_a_log(tmp_path):
    import h5py

    names = ("time.a", "a/b.c", "a_b.c", "a_b")
    awkward = {name: np.arange(3.0) + at for at, name in enumerate(names)}
    Results(np.arange(3.0), {**SAMPLE.signals, **awkward}, SAMPLE.units).to_hdf5(tmp_path / "x.h5")
    with h5py.File(tmp_path / "x.h5") as file:
        assert file["robot/position"][()].tolist() == SAMPLE["robot.position"].tolist()
        assert file["robot/position"].attrs["unit"] == "m" and file["time"].attrs["unit"] == "s"
    again = read_results(tmp_path / "x.h5")
    assert list(again.signals) == [*SAMPLE.signals, *awkward]
    assert all(again[name].tolist() == values.tolist() for name, values in awkward.items())
    log = read_log(tmp_path / "x.h5")
    assert log["robot.position"].unit == "m" and log["time"].unit == "s"


def test_hdf5_without_its_package_is_refused_before_a_run(monkeypatch):
    monkeypatch.setattr(formats, "find_spec", lambda name: None)
    with pytest.raises(ConfigError) as caught:
        formats.check_formats(["csv", "h5"])
    assert str(caught.value) == "format h5 needs the package h5py: pip install 'orchestrator[logs]'"


def test_hdf5_without_its_package_says_what_to_install(tmp_path, monkeypatch, capsys):
    SAMPLE.to_hdf5(tmp_path / "x.h5")
    monkeypatch.setitem(sys.modules, "h5py", None)
    needed = "HDF5 needs the package h5py: pip install 'orchestrator[logs]'"
    for call in (SAMPLE.write, SAMPLE.to_hdf5):
        with pytest.raises(OrchestratorError) as caught:
            call(tmp_path / "y.h5")
        assert str(caught.value) == needed
    with pytest.raises(OrchestratorError) as caught:
        read_results(tmp_path / "x.h5")
    assert str(caught.value) == f"{tmp_path}/x.h5: no results can be read from it ({needed})"
    assert main(["export-results", str(tmp_path / "x.h5"), "--format", "csv"]) == 1
    assert capsys.readouterr().err == f"orchestrator: {caught.value}\n"
    with pytest.raises(LogError) as caught:
        read_log(tmp_path / "x.h5")
    assert str(caught.value) == "needs the package h5py: pip install 'orchestrator[logs]'"


@pytest.mark.parametrize("suffix", ["arrow", "csv"])
@given(values=st.lists(st.floats(allow_nan=False), min_size=1, max_size=600))
def test_numbers_are_exact(tmp_path_factory, suffix, values):
    path = tmp_path_factory.mktemp("exact") / f"x.{suffix}"
    Results(np.zeros(len(values)), {"a": np.array(values)}).write(path)
    assert read_results(path)["a"].tobytes() == np.array(values).tobytes()


def test_what_is_not_there_is_named_with_what_is():
    with pytest.raises(KeyError) as caught:
        SAMPLE["robot.positon"]
    assert caught.value.args[0] == (
        "no 'robot.positon'; there are robot.position, robot.x[1,2], a-b.count, a_b.count, contact.touching. "
        "Did you mean robot.position?"
    )
    with pytest.raises(KeyError, match=r"no 'robot\.masss'; there are robot\.mass, robot\.mode, robot\.on"):
        SAMPLE.parameters["robot.masss"]


def test_files_that_hold_no_results(tmp_path):
    with pytest.raises(
        OrchestratorError, match=r"^.*x\.csv: no results can be read from it \(.*No such file"
    ):
        read_results(tmp_path / "x.csv")
    (tmp_path / "y.csv").write_text("a,b\n1,2,3\n")
    with pytest.raises(OrchestratorError, match=r"3 columns under 2 names"):
        read_results(tmp_path / "y.csv")
    with pytest.raises(OrchestratorError, match=r"no format '\.txt'; formats: arrow, csv, parquet, mat, h5"):
        read_results(tmp_path / "z.txt")


def oscillator():
    return assemble(
        [Part("mass", mass(), {"position": "1 m"}), Part("spring", spring())],
        ["mass.position -> spring.position", "spring.force -> mass.force"],
    )


def test_a_recorder_streams_what_it_keeps(tmp_path):
    path = tmp_path / "results.arrow"
    recorder, in_memory = Recorder(oscillator(), path=path), Recorder(oscillator())
    observers = [recorder, in_memory]
    simulate(oscillator(), create_master("jacobi"), Grid(Fraction(0), Fraction(1, 1000), 2500), observers)
    recorder.close()
    kept, read = in_memory.results(), read_results(path)
    assert len(kept) == 2501 == len(recorder.results())
    assert read.time.tobytes() == kept.time.tobytes()
    for name in kept.signals:
        assert read[name].tobytes() == kept[name].tobytes()
    assert kept.units == {"mass.position": "m", "mass.velocity": "m/s", "spring.force": "N"}


def test_what_a_killed_run_left_is_readable(tmp_path):
    path = tmp_path / "results.arrow"
    recorder = Recorder(oscillator(), path=path)
    simulate(oscillator(), create_master("jacobi"), Grid(Fraction(0), Fraction(1, 1000), 2500), [recorder])
    # Not closed: two blocks of 1024 rows are on disk. One that was cut while it was written is left out.
    assert len(read_results(path)) == 2048
    with path.open("ab") as file:
        file.truncate(path.stat().st_size - 5)
    assert len(read_results(path)) == 1024
    recorder.close()


def test_an_empty_file_with_a_header_is_an_empty_run(tmp_path):
    recorder = Recorder(oscillator(), path=tmp_path / "results.arrow")
    recorder.close()
    assert len(read_results(tmp_path / "results.arrow")) == 0
    assert len(recorder.results()) == 0


def test_every_nth_point_is_kept():
    recorder = Recorder(oscillator(), every=4)
    simulate(oscillator(), create_master("jacobi"), Grid(Fraction(0), Fraction(1, 10), 10), [recorder])
    assert recorder.results().time.tolist() == [0.0, 0.4, 0.8]


def test_parameters_are_the_configs_over_the_fmus():
    from doubles import FakeFmu

    fmu = FakeFmu(parameters={"a": "N", "b": "N"}, inputs={"u": "N"})
    system = assemble([Part("one", fmu, {"a": "2 kN", "u": "3 N"})])
    assert parameters_of(system) == {"one.a": 2000.0, "one.b": 0.0, "one.u": 3.0}


def test_strict_json():
    value = {"a": np.float64(1.5), "b": [math.nan, math.inf, 1], 3: np.arange(2), "c": (np.True_, None, "x")}
    assert formats.strict(value) == {"a": 1.5, "b": [None, None, 1], "3": [0, 1], "c": [True, None, "x"]}
    json.dumps(formats.strict(value), allow_nan=False)
