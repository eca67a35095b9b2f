"""Loops that are cut at a connection, from Python."""

from __future__ import annotations

import control
import numpy as np
import pytest

import orchestrator as orc
from orchestrator.base.errors import ConfigError
from orchestrator.cli.main import main

LATE = {"connections[3].through": [{"delay": "1 ms"}]}


def test_a_loop_is_opened_by_its_ends_its_name_or_its_target():
    linear = orc.linearise("emps", set=LATE)
    loop = linear.open("controller.voltage -> drive.voltage")
    assert loop == linear.open("drive.voltage") == linear.open(loop.connection)
    assert linear.open().connection == next(iter(linear.margins()))
    with pytest.raises(ConfigError, match=r"no connection 'drive.voltag'"):
        linear.open("drive.voltag")


def test_a_loop_agrees_with_python_control():
    loop = orc.linearise("emps", set=LATE).open("drive.voltage")
    gain, phase, *_ = control.stability_margins(loop.to_control(8))
    assert loop.margins().phase_margin == pytest.approx(phase, rel=1e-6)
    assert loop.margins().gain_margin[1] == pytest.approx(gain, rel=1e-6)
    omega = np.array([10.0, 80.0])
    np.testing.assert_allclose(loop(omega), loop.to_response(omega).frdata[0, 0], rtol=1e-12)
    np.testing.assert_allclose(loop(omega), loop.to_control(8)(1j * omega), rtol=1e-9)
    assert f"phase margin {phase:.4g} deg" in repr(loop.margins()) in repr(loop)


def test_roots_are_those_of_the_modes_and_their_conjugates():
    linear = orc.linearise("emps", set=LATE)
    roots = linear.roots()
    assert all(np.min(abs(roots - mode.root)) == 0.0 for mode in linear.modes().modes)
    assert sum(roots).imag == 0.0
    assert [line.partition(" 1/s: ")[0] for line in repr(linear.modes()).splitlines()] == [
        f"{mode.root:.6g}".removesuffix("+0j") for mode in linear.modes().modes
    ]


def test_a_chart_is_around_the_operating_point_of_the_system():
    linear = orc.linearise("emps", set=LATE, at="trim", fix=["path.turned"])
    drawn = linear.chart(
        "controller.velocity_gain=100..500 V.s/m", "connections[3].through[0].delay=0.1..12 ms", 30
    )
    (line,) = drawn.border
    delay = 1e-3 + linear.open("drive.voltage").margins().delay_margin
    assert 1e-3 * np.interp(243.45, line[:, 0], line[:, 1]) == pytest.approx(delay, rel=1e-3)


def test_filters_of_connections_are_no_places_to_open(capsys):
    filtered = "connections[3].through=[{low-pass: 200 Hz}]"
    assert main(["stability", "emps", "--set", filtered, "--open", "drive.nothing"]) == 2
    printed = capsys.readouterr().err
    assert "nothing is connected to drive.nothing" in printed and "drive.voltage" in printed
    assert "filter" not in printed
