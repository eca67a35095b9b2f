"""Columns in other units than the study says: told before anything is blamed."""

from __future__ import annotations

import math

import pytest
from ports_bench import change_log, study

from orchestrator.diagnosis.ports.given import check_logs
from orchestrator.diagnosis.ports.reader import load_port_study


@pytest.mark.parametrize(
    ("factor", "told"),
    [
        (10.0, "10 times too large, as if logged in mm, not in cm"),
        (0.1, "10 times too small, as if it should be in mm, not in cm"),
        (9.81, "9.81 times too large, as if logged in N, not in kgf"),
        (180.0 / math.pi, "57.3 times too large, as if logged in deg, not in rad"),
        (math.pi / 30.0, "9.549 times too small, as if it should be in rpm, not in rad/s"),
        (2.0 * math.pi, "6.283 times too large, as if logged in rad, not in turns"),
        (6e4, "6e+04 times too large, as if logged in L/min, not in m3/s"),
    ],
)
def test_a_column_in_another_unit_is_told_with_both(tmp_path, factor, told):
    study(tmp_path)
    for number in range(3):
        with change_log(tmp_path / f"run-{number}.csv") as columns:
            columns["drive.position"] *= factor
    (found,) = check_logs(load_port_study(tmp_path))[0]
    assert found.place.endswith("drive.position") and told in found.remedy


@pytest.mark.parametrize("gain", [0.9, 1.1, 1.3])
def test_a_gain_that_no_unit_makes_is_left_to_effects(tmp_path, gain):
    study(tmp_path)
    for number in range(3):
        with change_log(tmp_path / f"run-{number}.csv") as columns:
            columns["drive.position"] *= gain
    assert check_logs(load_port_study(tmp_path))[0] == []
