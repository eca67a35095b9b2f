"""An FMU that asks to end the simulation ends the run regularly, whatever runs it."""

from __future__ import annotations

import json
import math
from fractions import Fraction

import foreign
import pytest
import yaml
from assembled import assemble
from doubles import FakeFmu, gain, variable
from unruly import WAYS, unruly_fmu

from orchestrator.base.errors import StepError
from orchestrator.cli.main import main
from orchestrator.fmi import Causality, Initial, StepStatus
from orchestrator.frequency.excite import sweep_system
from orchestrator.master import create_master, master_names
from orchestrator.results.recorders import Recorder
from orchestrator.simulation.grid import Grid
from orchestrator.simulation.loop import Report, simulate
from orchestrator.simulation.run import run
from orchestrator.system.assembly import Part

MASTERS = {
    "jacobi": "jacobi",
    "gauss-seidel": "gauss-seidel",
    "iterative": {"name": "iterative", "tolerance": 1e-9},
    "adaptive": {"name": "adaptive", "tolerance": 1e-3},
}


def config(way: str, at: float, version: int = 2, **instance):
    """An integrator that feeds another one, which ends the simulation in a way of unruly.c."""
    path = str(unruly_fmu(version))
    start = {"way": WAYS.index(way), "at": at}
    return {
        "run": {"master": "gauss-seidel", "step_size": "0.1 s", "stop_time": "2 s"},
        "instances": {
            "source": {"fmu": path, "start": {"rate": "1 m"}},
            "ender": {"fmu": path, "start": start, **instance},
        },
        "connections": ["source.level -> ender.rate"],
    }


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("instance", [{}, {"isolate": "process"}])
@pytest.mark.parametrize(("way", "last"), [("ends", 1.1), ("terminates", 1.0)])
def test_a_run_ends_with_the_last_point_kept(way, last, instance, version, tmp_path):
    made = run(config(way, 1.0, version, **instance), out=tmp_path / "out", figures=False)
    assert made.results.time[-1] == pytest.approx(last)
    assert made.results["source.level"] == pytest.approx(made.results.time)
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["run"]["ended"] == {"instance": "ender", "time": pytest.approx(last)}
    assert summary["run"]["simulated_time"] == pytest.approx(last)
    assert "error" not in summary and "error" not in summary["numerics"]
    # The run with half the step size ends half a step earlier: what both have is compared.
    assert all(math.isfinite(one["max_change"]) for one in summary["numerics"]["signals"].values())


def test_the_command_succeeds_and_says_who_ended_the_run(tmp_path, capsys):
    (tmp_path / "ends.yaml").write_text(yaml.safe_dump(config("ends", 1.0)))
    assert main(["run", str(tmp_path / "ends.yaml"), "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    assert "ender ended the simulation at 1.1 s, before the stop time of 2 s." in said
    assert (tmp_path / "out" / "results.csv").is_file()


def test_an_end_at_the_stop_time_is_no_early_end():
    made = run(config("ends", 1.9), halving=False)
    assert "ended" not in made.summary["run"] and made.results.time[-1] == 2.0


def asking(at: float, complete: bool):
    """An integrator that asks to end the simulation in the step from `at`, before its end or there."""

    def step(values, time, h):
        values["level"] += h
        fmu.reached = time + (h if complete else 0.0)
        return StepStatus.TERMINATED if time + h > at + 1e-9 else None

    level = variable("level", Causality.OUTPUT, "m", initial=Initial.EXACT)
    fmu = FakeFmu(name="Asking", inputs={"u": "m"}, extra=[level], step=step)
    return fmu


def test_every_master_is_tried():
    assert MASTERS.keys() == set(master_names())


@pytest.mark.parametrize("complete", [False, True])
@pytest.mark.parametrize("name", MASTERS)
def test_every_master_keeps_the_last_point(name, complete):
    fmu, other = asking(0.5, complete), gain(unit_in="m", unit_out="m")
    system = assemble([Part("asks", fmu, {"u": "0 m"}), Part("other", other)], ["asks.level -> other.u"])
    recorder, report = Recorder(system), Report()
    simulate(system, create_master(MASTERS[name]), Grid(Fraction(0), Fraction(1, 10), 20), [recorder], report)
    assert report.ended.instance == "asks" and not fmu.alive and not other.alive
    assert ("asks", "terminate") in fmu.calls and ("other", "terminate") in other.calls
    kept = recorder.results()
    assert kept.time[-1] == pytest.approx(0.6 if complete else 0.5)
    assert kept["other.y"][-1] == pytest.approx(kept.time[-1] if name != "jacobi" else kept.time[-2])


@pytest.mark.parametrize("version", [1, 2, 3])
@pytest.mark.parametrize(("step", "last"), [("0.25 s", 0.75), ("0.1 s", 0.7)])
def test_a_model_exchange_fmu_ends_the_run_at_its_event(step, last, version, tmp_path):
    fmu = foreign.bounce(tmp_path / "Bounce.fmu", version)
    made = run(
        {
            "run": {"master": "jacobi", "step_size": step, "stop_time": "2 s"},
            "instances": {"ball": {"fmu": str(fmu), "start": {"fail": 2}, "tolerance": 1e-6}},
        },
        halving=False,
    )
    assert made.summary["run"]["ended"] == {"instance": "ball", "time": 0.75}
    assert made.results.time[-1] == pytest.approx(last)


def test_a_sweep_counts_such_runs_as_finished_and_tells_when_they_ended(tmp_path, capsys):
    (tmp_path / "base.yaml").write_text(yaml.safe_dump(config("ends", 1.0)))
    study = {
        "format": "sweep/1",
        "system": "base.yaml",
        "design": {"grid": {"ender.at": [1.0, 5.0]}},
        "derived": {"end": "final(source.level)"},
    }
    path, store = tmp_path / "study.yaml", str(tmp_path / "store")
    path.write_text(yaml.safe_dump(study))
    assert main(["sweep", str(path), "--store", store, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["failed"] == {}
    assert main(["store", "query", store, "select name, value from numbers", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [row for row in rows if row["name"].startswith("ended")] == [
        {"name": "ended.time", "value": pytest.approx(1.1)}
    ]


def test_a_response_is_not_measured_on_a_run_that_ended():
    with pytest.raises(StepError, match=r"ender.*asks to end the simulation"):
        sweep_system(config("terminates", 0.5), "source.rate", "ender.level", [0.5, 1.0], amplitude=0.1)
