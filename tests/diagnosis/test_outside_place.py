"""Where something outside the catalogue is placed, by what none of the effects leaves."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.diagnosis.rig.challenge.draw import Plan
from orchestrator.diagnosis.rig.hardware import weigh_rig
from orchestrator.diagnosis.rig.outside_place import part_of_chain, wrong_times
from orchestrator.diagnosis.rig.residual_evidence import ResidualEvidence
from tests.benchmarks.rig_calibration.simulated_cases import ODDITIES, simulated_study

N = 3000
T = 1e-3 * np.arange(N)
WAY = 5e-3 * np.sin(2.0 * np.pi * T)
NOTHING = ResidualEvidence(*(0.0,) * len(ResidualEvidence._fields))


def noise(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(N)


def test_wrong_times_of_commands_show_in_proportion_to_the_speed():
    speed = np.gradient(WAY)
    assert wrong_times([noise(1) + 5.0 * noise(2) * speed / speed.max()], [WAY]) > 100.0


@pytest.mark.parametrize("walk", [6.0 * np.sin(14.0 * T), np.cumsum(0.2 * noise(3)), 4.0 * noise(4)])
def test_what_goes_on_where_the_robot_turns_is_not_of_commands_at_wrong_times(walk):
    assert wrong_times([noise(1) + walk], [WAY]) < -100.0


def test_noise_alone_tells_nothing_of_wrong_times():
    assert abs(wrong_times([noise(1)], [WAY])) < 5.0


def placed(force: np.ndarray, **rest: float) -> str:
    touching = (T % 0.5) > 0.4
    other = {name: value for name, value in rest.items() if name != "sensor_only"}
    return part_of_chain(NOTHING._replace(**other), [force], [touching], rest.get("sensor_only", 0.0))


def test_a_force_that_strays_beside_contacts_is_the_sensors():
    assert placed(noise(1) + np.where((T % 0.5) > 0.4, 0.0, 1.0)) == "sensor"
    assert placed(noise(1) + np.where((T % 0.5) > 0.42, 1.0, 0.0)) == "contact"


def test_the_part_that_strays_more_is_the_place():
    assert placed(noise(1), moved=30.0) == "robot"
    assert placed(noise(1), moved=30.0, pushed=31.0) == "contact"
    assert placed(noise(1), moved=30.0, pushed=25.0, sensor_only=25.0) == "sensor"


@pytest.mark.parametrize(
    ("kind", "place"),
    [("robot.vibration", "robot"), ("robot.encoder-walk", "robot"), ("sensor.tether", "sensor")],
)
def test_oddities_are_found_where_they_act(kind, place):
    hidden = next(one for one in ODDITIES if one.id == kind)
    study, _ = simulated_study(11, 7, plan=Plan("outside", (hidden,), 0.5))
    assert weigh_rig(study).place == place
