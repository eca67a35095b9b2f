"""The noise floor of held-out runs: what repeats differ by that the model does not make of what it is fed;
and noise of one port, which hides no gap of others."""

from __future__ import annotations

import numpy as np
import pytest
import yaml
from ports_bench import change_log, study

from orchestrator.diagnosis.finding import NOMINAL, Candidate, Finding
from orchestrator.diagnosis.ports.closure import how_far
from orchestrator.diagnosis.ports.reader import load_port_study

NOTHING = Finding((Candidate((), 1.0, {}, (), 0.0, NOMINAL),), (), (), "", (), NOMINAL)


def test_what_fed_noise_makes_of_an_output_is_not_noise_of_it(tmp_path):
    """The controller was given the sensor's noise, as the model is, which then gives the same voltages."""
    study(tmp_path, seed=None)
    data = yaml.safe_load((tmp_path / "study.yaml").read_text())
    (tmp_path / "again.csv").write_text((tmp_path / "run-2.csv").read_text())
    data["runs"].append({"file": "again.csv", "role": "repeat", "repeats": "run-2"})
    data["columns"]["controller.position"] = {"column": "drive.position"}
    del data["columns"]["drive.position"]
    (tmp_path / "study.yaml").write_text(yaml.safe_dump(data))
    draw = np.random.default_rng(4)
    for name in ("run-2", "again"):
        with change_log(tmp_path / f"{name}.csv") as columns:
            noise = 2e-6 * draw.standard_normal(len(columns["time"]))
            columns["drive.position"] += noise
            # The controller stands behind the drive: it has the position of the same sample.
            columns["controller.voltage"] -= 243.45 * 160.18 * noise
            columns["controller.voltage"] += 5e-3 * draw.standard_normal(len(noise))
            spread = np.std(columns["controller.voltage"][25:])
    far = how_far(load_port_study(tmp_path), NOTHING)
    assert far["noise_floor_from"] == "repeats" and far["within_floor"]
    # What it makes of the drive's velocity, which was not logged, is in it, too; logs differ by 78 mV each.
    assert 5e-3 < far["noise_floor"] * spread < 30e-3


def test_a_gap_at_a_precise_port_does_not_drown_in_the_noise_of_another(tmp_path):
    study(tmp_path)
    data = yaml.safe_load((tmp_path / "study.yaml").read_text())
    data["columns"]["controller.voltage"]["noise"] = "5 V"
    (tmp_path / "study.yaml").write_text(yaml.safe_dump(data))
    with change_log(tmp_path / "run-2.csv") as columns:
        columns["controller.voltage"] += 5.0 * np.random.default_rng(4).standard_normal(1001)
        columns["drive.position"] += 40e-6
        spread = np.std(columns["drive.position"][25:])
    far = how_far(load_port_study(tmp_path), NOTHING)
    assert not far["within_floor"] and set(far["outputs"]) == {"drive.position", "controller.voltage"}
    assert far["before"] == pytest.approx(40e-6 / spread, rel=0.02)
    assert far["noise_floor"] == pytest.approx(2e-6 / spread, rel=0.02)
