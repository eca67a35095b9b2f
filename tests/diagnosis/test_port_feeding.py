"""How logs are fed, as signals of other instances are, and how candidates are made from all of them."""

from __future__ import annotations

import numpy as np
import pytest
import yaml
from ports_bench import change_log, study

from orchestrator.diagnosis.finding import NOMINAL, Augmented
from orchestrator.diagnosis.ports import player
from orchestrator.diagnosis.ports.reader import load_port_study
from orchestrator.diagnosis.ports.replay import PortReplay, candidates_of
from orchestrator.diagnosis.ports.study import Role
from orchestrator.simulate import simulate
from orchestrator.system import Port


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
    found = PortReplay(own, [run]).player.run(run.logs, len(run))[Port("controller", "voltage")]
    assert found[1:] == pytest.approx(voltage[1 - late : 200 - late], rel=1e-12)
    assert found[0] == pytest.approx(voltage[0], rel=1e-12)


@pytest.fixture(scope="module")
def moving(tmp_path_factory):
    """Logs of the system itself, the second of a shorter stroke, and one of it at rest."""
    path = study(tmp_path_factory.mktemp("moving"), seed=None)
    (path / "rest.csv").write_text((path / "run-0.csv").read_text())
    with change_log(path / "rest.csv") as columns:
        for name, values in columns.items():
            if name != "time":
                values[:] = 0.0
    return path


def trained(path, *files):
    """The study with these train runs, in this order."""
    data = yaml.safe_load((path / "study.yaml").read_text())
    data["runs"] = [{"file": f"{name}.csv", "role": "train"} for name in files]
    (path / "trained.yaml").write_text(yaml.safe_dump(data))
    return load_port_study(path / "trained.yaml")


@pytest.mark.parametrize("files", [("run-1", "run-0"), ("rest", "run-0", "run-1")])
def test_candidates_do_not_depend_on_which_run_stands_first(moving, files):
    first, second = (candidates_of(trained(moving, *order)) for order in (files, files[::-1]))
    assert [(one.id, one.equation) for one in first] == [(one.id, one.equation) for one in second]
    for one, other in zip(first, second, strict=True):
        for a, b in zip(one.parameters, other.parameters, strict=True):
            assert (a.scale, *a.starts) == pytest.approx((b.scale, *b.starts), rel=1e-9), one.id
    assert {"drive.voltage.saturate", "drive.coulomb", "drive.load.offset"} <= {one.id for one in first}


def test_limits_that_cut_nothing_are_absent_from_all_train_runs(moving):
    """Those of a run with a smaller peak would cut off what is larger in another."""
    own = trained(moving, "run-1", "run-0")
    replay = PortReplay(own, own.of(Role.TRAIN))
    before = replay.of(NOMINAL)
    limits = [one for one in candidates_of(own) if one.id.endswith((".saturate", ".rate-limit"))]
    assert len(limits) >= 8
    for effect in limits:
        after = replay.of(Augmented({}, (effect,), np.zeros(1)))
        assert all(np.array_equal(a, b) for a, b in zip(before, after, strict=True)), effect.id
