"""The noise floor of held-out runs: what repeats differ by that the model does not make of what it is fed;
noise of one port, which hides no gap of others; and a port that an answer leaves as it was."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from ports_bench import change_log, study
from test_report import GAP, made

from orchestrator.diagnosis.answers import Answer
from orchestrator.diagnosis.finding import NOMINAL, Candidate, Finding
from orchestrator.diagnosis.headline import headline
from orchestrator.diagnosis.ports.closure import how_far
from orchestrator.diagnosis.ports.reader import load_port_study
from orchestrator.diagnosis.ports.tempering import Tempering
from orchestrator.diagnosis.ports.weigh import _left
from orchestrator.system.system import Port

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


def test_what_an_answer_explains_at_one_port_does_not_explain_another():
    """A position far off is explained; a swing of an angle, of 17 times its noise, is not."""
    draw, time = np.random.default_rng(5), np.linspace(0.0, 6.0, 1200)
    noise, swing = draw.standard_normal((2, 1200)), 17.0 * np.sin(2.0 * np.pi * 0.9 * time)
    channels = [(None, Port("crane", "position")), (None, Port("crane", "angle"))]
    left = {"answer": [noise[0], noise[1] + swing], "none": [noise[0] + 1300.0 * time, noise[1] + swing]}
    by_port, share = _left([SimpleNamespace(channels=channels, of=left.get)], "answer", "none")
    assert by_port["crane.position"] < 1e-3 and by_port["crane.angle"] == 1.0
    assert share == 1.0
    answers = [Answer((), 0.0, 0.0), Answer(("crane.push.offset",), 5e3, 0.0)]
    explained = Tempering().probabilities(answers, 90, share)
    assert explained[-1] > 0.99


def test_an_answer_that_leaves_much_is_said_to_cause_part_of_the_gap():
    gap = GAP | {"closure": 0.25, "within_floor": False}
    assert " causes part of the gap (" in headline(made(how_far=gap, misfit={"drive.position": 1900.0}))
    assert " causes the gap (" in headline(made(how_far=gap, misfit={"drive.position": 1.1}))
    assert " causes the gap (" in headline(made(how_far=gap | {"closure": 0.98}, misfit={"a.b": 9.0}))
