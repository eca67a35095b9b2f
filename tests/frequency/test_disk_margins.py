"""Disk margins: against python-control, published cases, and systems at the edge of the disk."""

from __future__ import annotations

import json

import control
import numpy as np
import pytest

from orchestrator.cli.main import main
from orchestrator.frequency.delay_equation import Link
from orchestrator.frequency.delay_system import DelaySystem
from orchestrator.frequency.disk import disk_margin, sensitivity


def loop(numerator, denominator, delay=0.0):
    """A single loop of negative feedback."""
    made = control.tf2ss(control.tf(numerator, denominator))
    a, b, c, d = (np.atleast_2d(np.asarray(one, float)) for one in (made.A, made.B, made.C, made.D))
    names = tuple(f"x{index}" for index in range(len(a)))
    link = Link("loop", 0, 0, -1.0, delay)
    return DelaySystem(a, b, c, d, names, ("p.u",), ("p.y",), (link,))


def coupled(a, b, c, gains, delays):
    """Two loops through one plant."""
    links = tuple(Link(f"loop {k}", k, k, -gains[k], delays[k]) for k in (0, 1))
    names = tuple(f"x{index}" for index in range(len(a)))
    return DelaySystem(a, b, c, np.zeros((2, 2)), names, ("p.u", "q.u"), ("p.y", "q.y"), links)


def satellite():
    """Rates of a spinning satellite under static feedback: an example of MathWorks."""
    k = np.array([[1.0, -2.0], [0.0, 1.0]])
    a, c = np.array([[0.0, 10.0], [-10.0, 0.0]]), np.array([[1.0, 10.0], [-10.0, 1.0]])
    names = ("x", "y"), ("p.u", "q.u"), ("p.y", "q.y")
    links = tuple(Link(f"loop {i}", j, i, -k[i, j]) for i in (0, 1) for j in (0, 1) if k[i, j])
    return DelaySystem(a, np.eye(2), c, np.zeros((2, 2)), *names, links)


def test_the_example_of_the_lecture_notes():
    """Seiler, Packard, Gahinet (2020): 0.46 at 1.94 rad/s, gains 0.63 to 1.59."""
    found = disk_margin(loop([25.0], [1.0, 10.0, 10.0, 10.0]), ["loop"])
    assert found.margin == pytest.approx(0.46, abs=0.005)
    assert found.omega == pytest.approx(1.94, abs=0.02)
    assert found.gain == pytest.approx((0.63, 1.59), abs=0.005)
    omega = np.linspace(1.8, 2.1, 3001)
    margin, gain, phase = control.disk_margins(control.tf([25.0], [1.0, 10.0, 10.0, 10.0]), omega)
    assert found.margin == pytest.approx(margin, rel=1e-6)
    assert 20.0 * np.log10(found.gain[1]) == pytest.approx(gain, rel=1e-6)
    assert found.phase == pytest.approx(phase, rel=1e-6)


def test_two_loops_of_the_satellite_at_once():
    """0.3754 and 21.26 degrees by mu with the slack of that program; each loop alone bears everything."""
    system = satellite()
    found = disk_margin(system, ["loop 0", "loop 1"])
    assert found.margin == pytest.approx(0.3754, rel=4e-3)
    assert found.phase == pytest.approx(21.26, rel=4e-3)
    assert all(disk_margin(system, [one]).margin > 1.999 for one in found.connections)


@pytest.mark.parametrize("seed", range(6))
def test_the_bound_is_reached_by_some_turn_of_the_loops(seed):
    """mu = max over phases of the spectral radius, of which for two loops there is one phase."""
    draw = np.random.default_rng(seed)
    n = 4
    a = draw.normal(size=(n, n)) - 3.0 * np.eye(n)
    b, c = draw.normal(size=(n, 2)), draw.normal(size=(2, n))
    system = coupled(a, b, c, draw.uniform(0.2, 1.0, 2), draw.uniform(0.05, 0.5, 2))
    modes = system.modes()
    if modes.unstable:
        pytest.skip("unstable")
    names = ["loop 0", "loop 1"]
    found = disk_margin(system, names, modes)
    omega = np.unique([found.omega, *np.geomspace(1e-2, 1e2, 200)])
    matrices = sensitivity(system, names, omega) - 0.5 * np.eye(2)
    turns = np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 721))
    lower = max(
        np.max(abs(np.linalg.eigvals(one * np.stack([np.ones_like(turns), turns], axis=1)[:, None, :])))
        for one in matrices
    )
    assert 1.0 / found.margin == pytest.approx(lower, rel=1e-4)
    # All corners of the gains that it allows are stable, and it is never above that of a single loop.
    for first in found.gain:
        for second in found.gain:
            if np.isfinite(first) and np.isfinite(second):
                changed = system.scaled(names[0], 0.999 * first + 0.001).scaled(
                    names[1], 0.999 * second + 0.001
                )
                assert changed.modes().unstable == 0
    assert all(found.margin <= disk_margin(system, [one], modes).margin * (1 + 1e-6) for one in names)


def test_a_delay_takes_from_the_disk():
    """Of L = exp(-0.3 s)/s: |S - 1/2| from its formula."""
    found = disk_margin(loop([1.0], [1.0, 0.0], 0.3), ["loop"])
    s = 1j * np.linspace(0.1, 20.0, 400_001)
    response = np.exp(-0.3 * s) / s
    assert found.margin == pytest.approx(1.0 / np.max(abs(1.0 / (1.0 + response) - 0.5)), rel=1e-8)


def test_unstable_loops_have_no_disk():
    found = disk_margin(loop([1.0], [1.0, -2.0]), ["loop"])
    assert np.isnan(found.margin) and np.isfinite(found.sensitivity_peak)


def test_the_command_opens_several_loops_at_once(tmp_path, capsys):
    command = ["stability", "emps", "--open", "drive.voltage", "--open", "controller.position"]
    assert main([*command, "--out", str(tmp_path)]) == 0
    assert "2 loops opened at once: disk 0.371" in capsys.readouterr().out
    report = json.loads((tmp_path / "stability.json").read_text(encoding="utf-8"))
    alone = [one["disk_margin"] for one in report["margins"].values()]
    assert report["together"]["disk_margin"] < min(alone) == pytest.approx(0.7164, abs=1e-3)
    assert (tmp_path / "sigma.png").stat().st_size > 10_000
