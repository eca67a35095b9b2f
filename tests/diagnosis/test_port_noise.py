"""Noise that is larger than specified is reported as such, and is nothing outside the candidates."""

from __future__ import annotations

import numpy as np
import pytest
import yaml
from scipy.signal import lfilter

from orchestrator.diagnosis.ports.noise import lines, structured, understated, white
from orchestrator.diagnosis.ports.reader import load_port_study
from orchestrator.diagnosis.ports.weigh import weigh_ports
from tests.diagnosis.ports_bench import study

NOISE = np.random.default_rng(6).standard_normal(4000)
SWING = np.sin(2.0 * np.pi * np.arange(4000) / 500.0)


@pytest.mark.parametrize("size", [0.5, 1.3, 12.0])
def test_noise_of_any_size_has_no_form(size):
    assert white(size * NOISE) == pytest.approx(size**2, rel=0.1)
    assert structured(size * NOISE) == 0.0


@pytest.mark.parametrize("size", [2.0, 30.0])
def test_what_is_slow_has_one(size):
    """Its mean square is kept but for what its noise may make."""
    assert structured(size * SWING + NOISE) == pytest.approx(0.5 * size**2 - 1.0, abs=0.05 * size + 0.2)
    assert white(size * SWING + NOISE) == pytest.approx(1.0, rel=0.1)


@pytest.mark.parametrize("size", [0.7, 1.4, 5.0])
def test_a_periodic_disturbance_counts_beside_noise_of_any_size(size):
    """Less than the noise it may be, and yet it is none: a line keeps its phase."""
    line = size * np.sin(2.0 * np.pi * 0.0143 * np.arange(4000) + 0.3)
    assert lines(NOISE) == 0.0 and lines(NOISE + line) == pytest.approx(0.5 * size**2, rel=0.15)
    assert structured(NOISE + line) == pytest.approx(0.5 * size**2, rel=0.15)
    assert lines(line[:100]) == 0.0 and lines(np.full(4000, np.nan)) == 0.0


@pytest.mark.parametrize("damping", [0.3, 0.05, 0.02])
def test_a_mode_that_noise_drives_is_no_line(damping):
    turn = 2.0 * np.pi * 0.02
    keep = np.exp(-damping * turn)
    rung = lfilter([1.0], [1.0, -2.0 * keep * np.cos(turn), keep**2], NOISE)
    assert lines(rung / rung.std() + 0.3 * NOISE[::-1]) == 0.0


def test_the_reader_is_told_of_noise_and_of_nothing_else():
    told = understated({"a.noisy": [3.0 * NOISE], "b.right": [NOISE], "c.slow": [9.0 * SWING + NOISE]})
    assert [one.place for one in told] == ["a.noisy"] and "3 times" in told[0].what


def test_logs_noisier_than_specified_do_not_speak_of_something_outside(tmp_path):
    path = study(tmp_path, candidates={"only": ["drive.coulomb", "drive.viscous", "drive.voltage.gain"]})
    data = yaml.safe_load((path / "study.yaml").read_text())
    for name, noise in (("drive.position", "1 um"), ("controller.voltage", "2 mV")):
        data["columns"][name]["noise"] = noise
    (path / "study.yaml").write_text(yaml.safe_dump(data))
    found = weigh_ports(load_port_study(path))
    assert found.finding.effects == () and found.finding.candidates[0].probability > 0.8
    assert {one.place for one in found.warned} == {"drive.position", "controller.voltage"}
