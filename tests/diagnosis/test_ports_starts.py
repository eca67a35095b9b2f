"""Where runs begin: first samples as noisy as all others, and what held samples act over."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from ports_bench import change_log, study

from orchestrator.diagnosis.finding import NOMINAL
from orchestrator.diagnosis.ports.reader import load_port_study
from orchestrator.diagnosis.ports.replay import PortReplay
from orchestrator.diagnosis.ports.starts import Begun
from orchestrator.diagnosis.ports.study import Role
from orchestrator.diagnosis.ports.weigh import weigh_ports
from orchestrator.translate.python_fmu import build_python_fmu

SOURCES = Path(__file__).parents[1] / "fmu_sources"


def begun(path, off):
    """A study whose runs begin at the position's first sample, off by so many times its noise."""
    study(path, candidates={"only": ["drive.position.offset", "drive.position.gain", "drive.coulomb"]})
    data = yaml.safe_load((path / "study.yaml").read_text())
    # The drive goes by measured voltages alone, and so forgets nothing of where it began.
    data["columns"]["controller.voltage"] |= {"feed": True, "noise": "1 uV"}
    data["columns"]["drive.position"] |= {"start": True, "noise": "20 um"}
    # Voltages without noise: what a noisy one makes of a position is another matter.
    noiseless = study(path / "noiseless", seed=None)
    draw = np.random.default_rng(3)
    for number, times in enumerate(off):
        (path / f"run-{number}.csv").write_text((noiseless / f"run-{number}.csv").read_text())
        with change_log(path / f"run-{number}.csv") as columns:
            columns["drive.position"] += 20e-6 * draw.standard_normal(len(columns["drive.position"]))
            columns["drive.position"][0] = 20e-6 * times
    (path / "study.yaml").write_text(yaml.safe_dump(data))
    return load_port_study(path)


def test_noise_of_the_sample_at_which_a_run_begins_is_no_effect(tmp_path):
    """All that follows is off by it, more clearly than any effect would be."""
    own = begun(tmp_path, (1.8, 1.5, -2.0))
    found = weigh_ports(own).finding
    assert found.answer.effects == () and found.candidates[0].probability > 0.9
    assert not found.doubtful_tolerances
    assert all(0.5 < square < 1.5 for port, square in found.misfit.items() if port == "drive.position")


def test_a_begin_that_noise_does_not_make_stays_a_gap(tmp_path):
    own = begun(tmp_path, (40.0, 0.0, 0.0))
    train = PortReplay(own, own.of(Role.TRAIN))
    left = dict(zip((port for _, port in train.channels), train.of(NOMINAL), strict=True))
    position = next(r for port, r in left.items() if str(port) == "drive.position")
    assert abs(float(np.mean(position))) == pytest.approx(37.0, abs=0.5)


def test_what_noise_of_the_begin_makes_is_marginalised():
    """Residuals are weighed by the covariance that noise and it make together."""
    draw = np.random.default_rng(1)
    columns = [draw.standard_normal(30), np.linspace(1.0, 2.0, 30)]
    r = draw.standard_normal(30)
    kept = np.concatenate(Begun(columns).less([r[:10], r[10:]]))
    j = np.column_stack(columns)
    assert float(kept @ kept) == pytest.approx(float(r @ np.linalg.solve(np.eye(30) + j @ j.T, r)), rel=1e-9)
    assert np.array_equal(np.concatenate(Begun([np.full(30, np.nan)]).less([r])), r)


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
    (left,) = PortReplay(own, own.runs).of(NOMINAL)
    assert np.abs(left).max() < 1e-6
