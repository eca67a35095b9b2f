"""How logs are fed: as signals of other instances are."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from orchestrator.diagnosis.ports import player
from orchestrator.diagnosis.ports.reader import load_port_study
from orchestrator.diagnosis.ports.replay import PortReplay
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
