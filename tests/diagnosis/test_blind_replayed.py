"""Blind checks of given systems that their master simulates."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import orchestrator as orc
from orchestrator.diagnosis.blind.cases import make, write_study
from orchestrator.diagnosis.blind.given import Replayed, given
from orchestrator.diagnosis.blind.hidden import named
from orchestrator.diagnosis.blind.plant import Drive
from orchestrator.diagnosis.blind.run import Order, check
from orchestrator.diagnosis.study.reader import load_port_study
from orchestrator.diagnosis.unknown_input.played import PlayedModel
from orchestrator.simulation.run import prepare
from orchestrator.system.connection import Port


def tanks() -> Any:
    """A bundled system with a delay, which its master simulates."""
    found = given(Path("tank-level"))
    assert isinstance(found, Replayed)
    return found


def test_a_parameter_that_cannot_move_a_little_keeps_its_value() -> None:
    """A sample period counts steps."""
    found = given(Path("docking-1d"))
    try:
        assert "controller.sample_period" not in found.parameters and "contact.stiffness" in found.parameters
        case = make(1, found.draft, "none")
    finally:
        found.close()
    assert "controller.sample_period" not in case.truth["parameters"]


def test_a_system_that_its_master_simulates_gives_what_run_gives() -> None:
    held, count = tanks(), 40
    try:
        level = held.study.prepared.system.start(Port("controller", "reference"))
        drive = Drive(np.full((count, 1), level), True, held.study.interval)
        signals = held.simulate(drive, held.nominal, held.start, [], np.ones(len(held.states)))
        names = [*held.states, *held.inputs, *held.outputs]
        whole = orc.run("tank-level", set={"run.record": "all"})
        step = held.study.parts
        for name in held.compared:
            np.testing.assert_allclose(
                signals[:, names.index(name)], whole[name].values[: count * step : step], rtol=1e-12
            )
    finally:
        held.close()


def test_a_hidden_lag_of_a_sensor_is_that_of_its_equation() -> None:
    """Of a signal in straight lines, a lag has an exact solution for each step."""
    given_tanks, count, time, port = tanks(), 600, 12.0, "tanks.upper"
    study = replace(given_tanks.study, parts=1)
    held = Replayed(study, given_tanks.file, False, PlayedModel(study))
    try:
        drive = Drive(np.linspace(0.25, 0.3, count)[:, None], False, study.interval)
        law = named(held, "lag", port, "output", port, [time])
        assert law is not None
        # Nothing else reads the signal, or both would differ by more than the sensor.
        assert port not in {one for legs in held.legs.values() for one, _ in legs}
        column = len(held.states) + len(held.inputs) + held.outputs.index(port)
        plain, late = (
            held.simulate(drive, held.nominal, held.start, laws, np.ones(len(held.states)))[:, column]
            for laws in ([], [law])
        )
        z, h = plain[0], study.interval
        for k in range(1, count):
            slope, decay = (plain[k] - plain[k - 1]) / h, np.exp(-h / time)
            z = (z - plain[k - 1] + slope * time) * decay + plain[k] - slope * time
            assert late[k] == pytest.approx(z, rel=1e-9)
        assert np.abs(late - plain).max() > 1e-3
    finally:
        held.close()
        given_tanks.close()


@pytest.mark.slow
def test_a_law_is_found_in_a_system_that_its_master_simulates(tmp_path: Path) -> None:
    check(Order(tmp_path, [1], Path("tank-level"), "one"), 1)
    score = json.loads((tmp_path / "case-1" / "score.json").read_text(encoding="utf-8"))
    assert score["right"] and not score["error"], score
    study = yaml.safe_load((tmp_path / "case-1" / "study.yaml").read_text(encoding="utf-8"))
    assert study["columns"]["tanks.upper"]["start"] is True


def test_runs_of_a_study_keep_the_parameters_that_they_set(tmp_path: Path) -> None:
    """A case of a study whose runs differ by a parameter is read and searched."""
    interval, count = float(prepare("tank-level").grid.step_size), 200
    header = "time [s],r [m],h [m]"
    for name, level in (("a", 0.25), ("b", 0.3)):
        table = np.column_stack([np.arange(count) * interval, np.full(count, level), np.arange(count)])
        np.savetxt(tmp_path / f"{name}.csv", table, delimiter=",", header=header, comments="")
    (tmp_path / "study.yaml").write_text(
        yaml.safe_dump({
            "format": "port-study/1", "system": "tank-level",
            "columns": {
                "time": "time", "controller.reference": {"column": "r"},
                "tanks.upper": {"column": "h", "noise": "1 mm", "feed": False},
            },
            "runs": [
                {"file": "a.csv", "role": "train", "set": {"tanks.upper": "20 mm"}},
                {"file": "b.csv", "role": "held-out", "set": {"tanks.upper": "50 mm"}},
            ],
        }),
        encoding="utf-8",
    )  # fmt: skip
    held = given(tmp_path / "study.yaml")
    try:
        case = make(3, held.draft, "none")
        first = len(held.states) + len(held.inputs) + held.outputs.index("tanks.upper")
        assert [round(one[0, first], 12) for one in case.signals] == [0.02, 0.05]
        out = tmp_path / "case"
        out.mkdir()
        held.write_system(out)
        write_study(case, out)
    finally:
        held.close()
    written = load_port_study(out / "study.yaml")
    assert [dict(one.values) for one in written.runs] == [
        {Port("tanks", "upper"): 0.02}, {Port("tanks", "upper"): 0.05}
    ]  # fmt: skip
