"""How logs are fed: as signals of other instances are, into sums, and to one reader alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from ports_bench import UNITS, residuals, simulated, study, system

from orchestrator.diagnosis.study import player
from orchestrator.diagnosis.study.checks import check_logs
from orchestrator.diagnosis.study.player import Inserted
from orchestrator.diagnosis.study.reader import load_port_study
from orchestrator.diagnosis.study.replay import player_of
from orchestrator.effects.gain import Gain
from orchestrator.effects.offset import Offset
from orchestrator.simulation.loop import simulate
from orchestrator.simulation.run import run
from orchestrator.system.system import Port
from orchestrator.translate.python_fmu import build_python_fmu

SOURCES = Path(__file__).parents[1] / "fmu_sources"


@pytest.mark.parametrize("loop", ["native", "python"])
@pytest.mark.parametrize(("master", "late"), [("gauss-seidel", 0), ("jacobi", 1)])
def test_a_log_arrives_as_signals_of_instances_do(tmp_path, monkeypatch, master, late, loop):
    """What passes at once to an output is as old there as its log, under Gauss-Seidel."""
    draw = np.random.default_rng(5)
    columns = {name: draw.standard_normal(200) for name in ("reference", "position", "velocity")}
    voltage = 240.0 * (160.0 * (columns["reference"] - columns["position"]) - columns["velocity"])
    units = {"reference": "m", "position": "m", "velocity": "m/s", "voltage": "V"}
    table = np.column_stack([2e-3 * np.arange(200.0), *columns.values(), voltage])
    header = ",".join(["time [s]", *(f"{name} [{unit}]" for name, unit in units.items())])
    rows = "\n".join(",".join(map(repr, row)) for row in table.tolist())
    (tmp_path / "run.csv").write_text(f"{header}\n{rows}\n")
    controller = {
        "fmu": "CascadeControl",
        "start": {
            "position_gain": "160 1/s",
            "velocity_gain": "240 V.s/m",
            "reference": "0 m",
            "position": "0 m",
            "velocity": "0 m/s",
        },
    }
    system = {
        "run": {"master": master, "step_size": "2 ms", "stop_time": "1 s"},
        "instances": {"controller": controller},
        "connections": [],
    }
    (tmp_path / "system.yaml").write_text(yaml.safe_dump(system))
    fed = {f"controller.{name}": {"column": name, "hold": True} for name in columns}
    compared = {"controller.voltage": {"column": "voltage", "noise": "1 mV"}}
    (tmp_path / "study.yaml").write_text(yaml.safe_dump({
        "format": "port-study/1", "system": "system.yaml", "columns": {"time": "time", **fed, **compared},
        "runs": [{"file": "run.csv", "role": "train"}],
    }))  # fmt: skip
    monkeypatch.setattr(player, "simulate", lambda *one, **more: simulate(*one, **more | {"loop": loop}))
    own = load_port_study(tmp_path)
    run = own.runs[0]
    found = player_of(own, own.fed, own.compared).run(run.logs, len(run))[Port("controller", "voltage")]
    assert found[1:] == pytest.approx(voltage[1 - late : 200 - late], rel=1e-12)
    assert found[0] == pytest.approx(voltage[0], rel=1e-12)


VELOCITY = {"port": "path.velocity", "gain": "0.1 kN.s/m"}
OTHER = {"port": "drive.velocity", "gain": "-20 N.s/m"}
LEGS = [[VELOCITY], [VELOCITY, OTHER], [OTHER, VELOCITY]]
LOAD, VOLTAGE = Port("drive", "load"), Port("controller", "voltage")


DAMPER = {"fmu": "CoulombDamper", "start": {"level": "10 N", "width": "1 mm/s"}}


def summed(path, legs, through=(), **columns):
    """A study, and its system, whose load is a sum of velocities, or damper.force; its log is the system's
    own."""
    machine = system(0.2, [{"from": legs, "to": "drive.load", "through": list(through)}])
    if legs == ["damper.force"]:
        machine["instances"]["damper"] = DAMPER
        machine["connections"].append("path.velocity -> damper.velocity")
    (path / "system.yaml").write_text(yaml.safe_dump(machine, sort_keys=False))
    results = run(machine, halving=False).results
    units = UNITS | {"path.velocity": "m/s", "drive.velocity": "m/s"}
    table = {"time [s]": results.time, **{f"{name} [{unit}]": results[name] for name, unit in units.items()}}
    rows = np.column_stack([np.asarray(values) for values in table.values()]).tolist()
    (path / "run.csv").write_text("\n".join([",".join(table), *(",".join(map(repr, row)) for row in rows)]))
    seen = {"column": "controller.voltage", "noise": "5 mV", "feed": False}
    data = {"format": "port-study/1", "system": "system.yaml", "settle": "50 ms",
            "columns": {"time": "time", "controller.voltage": seen, **columns},
            "runs": [{"file": "run.csv", "role": "train"}]}  # fmt: skip
    (path / "study.yaml").write_text(yaml.safe_dump(data))
    return load_port_study(path), results


@pytest.mark.parametrize("loop", ["native", "python"])
@pytest.mark.parametrize("legs", LEGS)
def test_what_is_fed_into_a_sum_has_its_gain(tmp_path, monkeypatch, legs, loop):
    """One source with a gain is a sum, too."""
    own, _ = summed(tmp_path, legs, **{"path.velocity": {"column": "path.velocity"}})
    monkeypatch.setattr(player, "simulate", lambda *one, **more: simulate(*one, **more | {"loop": loop}))
    log = own.runs[0].logs[VOLTAGE]
    assert np.array_equal(simulated(own)[VOLTAGE], log)
    twice = {port: values * (2.0 if port.variable == "velocity" else 1.0)
             for port, values in own.runs[0].logs.items()}  # fmt: skip
    moved = player_of(own, own.fed, own.compared).run(twice, len(log))[VOLTAGE]
    assert np.abs(moved - log).max() > 0.1 * np.std(log)


@pytest.mark.parametrize("legs", LEGS)
def test_effects_act_on_an_output_before_its_gain(tmp_path, legs):
    own, _ = summed(tmp_path, legs)
    made = player_of(own, own.fed, own.compared)

    def given(*inserted):
        return made.run(own.runs[0].logs, len(own.runs[0]), {}, inserted)[VOLTAGE]

    at_output = given(Inserted(Offset(value=0.1), Port("path", "velocity")))
    assert at_output == pytest.approx(given(Inserted(Offset(value=10.0), LOAD)), rel=1e-9, abs=1e-9)
    assert np.abs(at_output - given()).max() > 0.1
    # A gain of the output is one of its leg alone.
    tenth = [leg | ({"gain": "10 N.s/m"} if leg is VELOCITY else {}) for leg in legs]
    (tmp_path / "tenth").mkdir()
    _, results = summed(tmp_path / "tenth", tenth)
    expected = pytest.approx(np.asarray(results["controller.voltage"]), rel=1e-9, abs=1e-9)
    assert given(Inserted(Gain(factor=0.1), Port("path", "velocity"))) == expected


@pytest.mark.parametrize("plain", [True, False])
def test_a_log_may_be_given_to_one_reader_alone(tmp_path, plain):
    """The controller was given a position that is off; the drive, which others read, is not."""
    measured = {"from": "drive.position", "to": "controller.position"}
    folder = study(tmp_path, [{**measured, "through": [{"effect": "offset", "value": "2 mm"}]}], seed=None)
    data = yaml.safe_load((folder / "study.yaml").read_text())
    if not plain:  # whatever the model makes of the position
        config = system(
            0.2, [{"from": [{"port": "drive.position", "gain": 0.5}], "to": "controller.position"}]
        )
        (folder / "plant.yaml").write_text(yaml.safe_dump(config))
        data["system"] = "plant.yaml"
    column = data["columns"]["drive.position"]["column"]
    data["columns"]["controller.position"] = {"column": column, "offset": "2 mm"}
    (folder / "study.yaml").write_text(yaml.safe_dump(data))
    found = load_port_study(folder)
    reader = Port("controller", "position")
    assert reader in found.fed

    def most(study) -> float:
        return max(float(np.abs(r).max()) for r in residuals(study))

    assert most(found) < 1e-6
    # Without that log, the controller reads what the drive gives.
    without = tuple(
        replace(run, logs={p: log for p, log in run.logs.items() if p != reader}) for run in found.runs
    )
    assert most(replace(found, runs=without)) > 1e3


def test_an_output_that_is_fed_for_want_of_a_noise_is_reported(tmp_path):
    """Not a source, of which nothing could be compared, nor what is meant to be fed."""
    file = study(tmp_path) / "study.yaml"
    data = yaml.safe_load(file.read_text())

    def reported(voltage):
        data["columns"]["controller.voltage"] = {"column": "controller.voltage", **voltage}
        file.write_text(yaml.safe_dump(data))
        found = load_port_study(file)
        return [one.place for one in check_logs(found)[1] if "`noise`" in one.what]

    assert reported({}) == ["controller.voltage"]
    for meant in ({"feed": True}, {"noise": "5 mV", "feed": False}):
        assert reported(meant) == []


def test_a_held_input_acts_from_its_sample_on(tmp_path):
    """Also on what holds a state that its FMU does not tell of; under Gauss-Seidel, too."""
    build_python_fmu(SOURCES / "basin.py", tmp_path / "Basin.fmu")
    inflow = np.random.default_rng(2).standard_normal(200)
    level = np.concatenate([[0.0], np.cumsum(inflow)[:-1] * 2e-3])
    rows = np.column_stack([2e-3 * np.arange(200.0), inflow, level])
    text = "\n".join(["time [s],q [m/s],h [m]", *(",".join(map(repr, row)) for row in rows.tolist())])
    (tmp_path / "run.csv").write_text(text + "\n")
    run = {"master": "gauss-seidel", "step_size": "2 ms", "stop_time": "1 s"}
    basin = {"fmu": "Basin.fmu", "start": {"inflow": "0 m/s", "level": "0 m"}}
    (tmp_path / "system.yaml").write_text(
        yaml.safe_dump({"run": run, "instances": {"basin": basin}, "connections": []})
    )
    columns = {
        "time": "time",
        "basin.inflow": {"column": "q", "hold": True},
        "basin.level": {"column": "h", "noise": "1 um", "feed": False},
    }
    (tmp_path / "study.yaml").write_text(yaml.safe_dump({
        "format": "port-study/1", "system": "system.yaml", "columns": columns,
        "runs": [{"file": "run.csv", "role": "train"}],
    }))  # fmt: skip
    own = load_port_study(tmp_path)
    (residual,) = residuals(own)
    assert np.abs(residual).max() < 1e-6
