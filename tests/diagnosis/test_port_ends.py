"""FMUs that end the simulation, or fail, before the log of a diagnosis ends."""

from __future__ import annotations

import re

import numpy as np
import pytest
import yaml
from unruly import WAYS, unruly_fmu

from orchestrator.diagnosis.study.checks import check_logs
from orchestrator.diagnosis.study.reader import load_port_study

STEP, SAMPLES, GAIN = 0.01, 201, 1.3


@pytest.fixture
def made(tmp_path):
    """A study of an integrator whose machine integrates 1.3 times as much, by how its FMU stops at 1 s."""

    def study(way: str, **of_runs):
        fmu = str(unruly_fmu(2))
        ender = {"fmu": fmu, "start": {"way": WAYS.index(way), "at": 1.0}}
        system = {
            "run": {"master": "gauss-seidel", "step_size": f"{STEP} s", "stop_time": "2 s"},
            "instances": {"source": {"fmu": fmu, "start": {"rate": "1 m"}}, "ender": ender},
            "connections": ["source.level -> ender.rate"],
        }
        draw, time, runs = np.random.default_rng(1), STEP * np.arange(SAMPLES), []
        for number, role in enumerate(("train", "validation", "held-out")):
            fed = np.sin((2 + number) * time)
            level = GAIN * STEP * np.concatenate([[0.0], np.cumsum(fed)[:-1]])
            rows = np.column_stack([time, fed, level + 1e-4 * draw.standard_normal(SAMPLES)])
            path = tmp_path / f"run-{number}.csv"
            np.savetxt(path, rows, fmt="%.17g", delimiter=",", header="t [s],u [m],y [m]", comments="")
            runs.append({"file": path.name, "role": role, **of_runs})
        data = {
            "format": "port-study/1",
            "system": "system.yaml",
            "columns": {
                "time": "t",
                "source.level": {"column": "u", "hold": True},
                "ender.level": {"column": "y", "noise": "0.1 mm", "feed": False},
            },
            "runs": runs,
        }
        (tmp_path / "system.yaml").write_text(yaml.safe_dump(system))
        (tmp_path / "study.yaml").write_text(yaml.safe_dump(data))
        return tmp_path / "study.yaml"

    return study


@pytest.mark.parametrize(
    ("way", "said"),
    [
        ("ends", "ends before the log: ender asks to end the simulation at 1.01 s of 2 s"),
        ("terminates", "ends before the log: ender asks to end the simulation at 1 s of 2 s"),
        ("fails", "fails before the log: ender fmi2DoStep returned error at 1 s of 2 s"),
    ],
)
def test_a_model_that_stops_before_the_log_is_no_runaway(made, way, said):
    problems, _ = check_logs(load_port_study(made(way)))
    assert [one.place for one in problems] == ["run-0", "run-1", "run-2"]
    assert {one.what for one in problems} == {f"the model as configured {said}"}
    cut = re.search(r"`to`, (\S+ s) after", problems[0].remedy)[1]
    assert check_logs(load_port_study(made(way, to=cut)))[0] == []
