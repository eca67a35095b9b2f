"""Columns in other units than the study says: reported before anything is blamed."""

from __future__ import annotations

import math

import pytest
import yaml
from ports_bench import change_log, checked, study

from orchestrator.diagnosis.study.mistakes import wrong_factors
from orchestrator.diagnosis.study.reader import load_port_study


def fed_too(folder, column):
    """Map what the controller was given, as well."""
    data = yaml.safe_load((folder / "study.yaml").read_text())
    data["columns"]["controller.position"] = column
    (folder / "study.yaml").write_text(yaml.safe_dump(data))


@pytest.mark.parametrize(
    ("factor", "reported"),
    [
        (10.0, "10 times too large, as if logged in mm, not in cm"),
        (0.1, "10 times too small, as if it should be in mm, not in cm"),
    ],
)
def test_a_column_in_another_unit_is_reported_with_both(tmp_path, factor, reported):
    study(tmp_path)
    for number in range(3):
        with change_log(tmp_path / f"run-{number}.csv") as columns:
            columns["drive.position"] *= factor
    (found,) = checked(load_port_study(tmp_path))[0]
    assert found.place.endswith("drive.position") and reported in found.remedy


@pytest.mark.parametrize(
    ("unit", "factor", "reported"),
    [
        ("N", 9.81, "9.81 times too large, as if logged in N, not in kgf"),
        ("rad", 180.0 / math.pi, "57.3 times too large, as if logged in deg, not in rad"),
        ("rad/s", math.pi / 30.0, "9.549 times too small, as if it should be in rpm, not in rad/s"),
        ("rad", 2.0 * math.pi, "6.283 times too large, as if logged in rad, not in turns"),
        ("m3/s", 6e4, "6e+04 times too large, as if logged in L/min, not in m3/s"),
        ("Pa", 1e5, "1e+05 times too large, as if logged in Pa, not in bar"),
    ],
)
def test_a_unit_is_taken_for_others_of_its_dimension_only(unit, factor, reported):
    """A speed that friction makes 4.45 times smaller is not logged in pounds-force."""
    assert reported in dict(wrong_factors(own=unit))[factor]
    # A number without a unit may be anything.
    assert factor in dict(wrong_factors(own="1")) and factor not in dict(wrong_factors(own="K"))
    assert not any("pounds" in remedy for _, remedy in wrong_factors(own="rad/s"))


@pytest.mark.parametrize(
    ("change", "place", "reported"),
    [
        (
            lambda columns: {"drive.position": 1e3 * columns["drive.position"]},
            "controller.position and drive.position",
            "All fits if it is 1000 times too large, as if logged in thousandths of its unit. "
            "Correct the unit in its header, or give `unit` in a study file.",
        ),
        (
            lambda columns: {"drive.position": -columns["drive.position"]},
            "controller.position and drive.position",
            "All fits if its sign is reversed. Correct its values, or give `sign: -1` in a study file.",
        ),
        (
            lambda columns: {
                "drive.position": columns["controller.voltage"],
                "controller.voltage": columns["drive.position"],
            },
            "controller.voltage, controller.position and drive.position",
            "All fits if the two are exchanged. Exchange their columns.",
        ),
    ],
)
def test_a_mistake_in_a_column_of_two_ports_is_reported_of_both(tmp_path, change, place, reported):
    """What the controller was given is also what the drive is compared with."""
    study(tmp_path, seed=None)
    fed_too(tmp_path, {"column": "drive.position"})
    assert checked(load_port_study(tmp_path)) == ([], [])
    for number in range(3):
        with change_log(tmp_path / f"run-{number}.csv") as columns:
            columns |= {name: values.copy() for name, values in change(columns).items()}
    (found,) = checked(load_port_study(tmp_path))[0]
    assert (found.place, found.remedy) == (f"run-0: {place}", reported)


def test_a_mistake_at_one_of_two_ports_of_a_column_is_reported_of_that(tmp_path):
    study(tmp_path, seed=None)
    fed_too(tmp_path, {"column": "drive.position", "unit": "mm"})
    (found,) = checked(load_port_study(tmp_path))[0]
    assert found.place == "run-0: controller.position"
    assert found.remedy.endswith("The study file says `unit: mm`: correct that.")


@pytest.mark.parametrize("gain", [0.9, 1.1, 1.3])
def test_a_gain_that_no_unit_makes_is_left_to_effects(tmp_path, gain):
    study(tmp_path)
    for number in range(3):
        with change_log(tmp_path / f"run-{number}.csv") as columns:
            columns["drive.position"] *= gain
    assert checked(load_port_study(tmp_path))[0] == []
