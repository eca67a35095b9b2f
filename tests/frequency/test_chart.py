"""Charts over two values of a config."""

from __future__ import annotations

import json

import control
import numpy as np
import pytest

from orchestrator.base.errors import ConfigError
from orchestrator.cli.main import main
from orchestrator.frequency import (
    DelaySystem,
    Link,
    chart_figure,
    chart_of,
    config_chart,
    linearise,
    parameter_range,
)

LATE = "connections[3].through=[{delay: 1 ms}]"


def test_the_border_is_the_delay_margin():
    """Over gain and delay of the positioning drive, at 200 x 200 points."""
    drawn = config_chart(
        "emps",
        parameter_range("controller.velocity_gain=100..500 V.s/m"),
        parameter_range("connections[3].through[0].delay=0.1..12 ms"),
        [LATE],
    )
    assert drawn.unstable.shape == (201, 201) and drawn.evaluations < 40
    (line,) = drawn.border
    for gain in (100.0, 243.45, 480.0):
        (name,) = (key for key in linearise("emps").margins() if key.endswith("drive.voltage"))
        found = linearise("emps", [f"controller.velocity_gain={gain} V.s/m"]).margins(names=[name])[name]
        delay = np.interp(gain, line[:, 0], line[:, 1])
        assert 1e-3 * delay == pytest.approx(found.delay_margin, rel=1e-3)
    assert drawn.here is None  # a delay on a connection is no start value
    assert chart_figure(drawn).axes


def test_a_border_that_closes_and_one_through_zero():
    """L = k (s + 1)/(s^2 - s + 1)..., stable between two gains; a real root crosses at k = 1."""

    def real(gain, delay):
        return DelaySystem.loop(control.tf([gain], [1.0, -1.0]), delay)

    drawn = chart_of(real, (0.5, 4.0), (0.01, 0.6), 100)
    for place in np.random.default_rng(3).integers(len(drawn.x), size=(30, 2)):
        system = real(drawn.x[place[1]], drawn.y[place[0]])
        assert drawn.unstable[place[0], place[1]] == system.count_right_of(0.0)
    lines = np.concatenate(drawn.border)
    static = lines[lines[:, 2] < 1e-3]
    assert len(static) > 10 and static[:, 0] == pytest.approx(1.0, rel=1e-3)
    # x' = x - k x(t - tau): cos(w tau) = 1/k, w = sqrt(k^2 - 1).
    moving = lines[lines[:, 2] > 1e-2]
    expected = np.arccos(1.0 / moving[:, 0]) / np.sqrt(moving[:, 0] ** 2 - 1.0)
    np.testing.assert_allclose(moving[:, 1], expected, atol=1e-3 * 0.6)


@pytest.mark.parametrize("turned", [1.0, -1.0], ids=["unstable", "stable"])
@pytest.mark.parametrize("place", [(0.317, 0.604), (0.0431, 0.948), (0.7012, 0.2207)])
@pytest.mark.parametrize("steep", [0.2, 20.0])
def test_an_island_of_a_hundredth_of_the_range_is_found(place, turned, steep):
    """Of a pair of roots that is dominant nowhere but there, beside a slow root and a delayed loop."""

    def made(x, y):
        real = turned * steep * (0.005**2 - (x - place[0]) ** 2 - (y - place[1]) ** 2)
        a = np.diag([real, real, -0.02, -5.0])
        a[0, 1], a[1, 0] = 3.0, -3.0
        b, c = np.zeros((4, 1)), np.zeros((1, 4))
        b[3], c[0, 3] = 1.0, 1.0
        names = ("p.a", "p.b", "p.c", "p.d"), ("p.u",), ("p.y",)
        return DelaySystem(a, b, c, np.zeros((1, 1)), *names, (Link("late", 0, 0, -0.5, 0.2),))

    (line,) = chart_of(made, (0.0, 1.0), (0.0, 1.0)).border
    radius = np.hypot(line[:, 0] - place[0], line[:, 1] - place[1])
    assert radius == pytest.approx(0.005, abs=1e-5)
    assert line[:, 2] == pytest.approx(3.0 / (2.0 * np.pi), rel=1e-6)


def test_a_chart_over_the_communication_step_is_of_the_co_simulation():
    drawn = config_chart(
        "emps",
        parameter_range("controller.velocity_gain=150..350 V.s/m"),
        parameter_range("run.step_size=2..6 ms"),
        ["run.master=jacobi"],
        points=20,
    )
    assert drawn.sampled
    (line,) = drawn.border
    # docs/frequency.md: 3.56 ms with the gain of the config.
    assert np.interp(243.45, line[:, 0], line[:, 1]) == pytest.approx(3.56, rel=5e-3)


def test_the_command_writes_the_chart(tmp_path, capsys):
    over = [
        "--over",
        "controller.velocity_gain=100..500 V.s/m",
        "--over",
        "controller.position_gain=50..900 1/s",
    ]
    assert main(["stability", "emps", *over, "--points", "50", "--out", str(tmp_path)]) == 0
    assert "machine over controller.velocity_gain and controller.position_gain" in capsys.readouterr().out
    chart = json.loads((tmp_path / "stability.json").read_text(encoding="utf-8"))["chart"]
    assert np.shape(chart["unstable"]) == (51, 51) and chart["config"] == pytest.approx([243.45, 160.18])
    assert (tmp_path / "chart.png").stat().st_size > 10_000


def test_refusals():
    gain = parameter_range("controller.velocity_gain=100..500 V.s/m")
    with pytest.raises(ConfigError, match=r"both ranges are of controller.velocity_gain"):
        config_chart("emps", gain, gain)
    with pytest.raises(ConfigError, match="a delay or a filter comes or goes"):
        chart_of(
            lambda a, b: DelaySystem.loop(control.tf([a], [1.0, 1.0] if b < 0.5 else [1.0, 1.0, 1.0])),
            (0.5, 1.0),
            (0.0, 1.0),
        )


def test_three_ranges_are_too_many(capsys):
    over = [part for _ in range(3) for part in ("--over", "controller.velocity_gain=100..500 V.s/m")]
    assert main(["stability", "emps", *over]) == 2
    assert "3 ranges are given" in capsys.readouterr().err
