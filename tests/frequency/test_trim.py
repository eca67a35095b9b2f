"""Steady states: against closed forms, and against runs that start there."""

from __future__ import annotations

import json

import numpy as np
import pytest
from modelica_texts import built_models

import orchestrator as orc
from orchestrator.base.errors import ConfigError
from orchestrator.cli.main import main
from orchestrator.frequency.trim import trim
from orchestrator.simulation.run import prepare

TANK = """
model Tank "A tank with an outlet"
  parameter Real area(unit = "m2") = 2;
  parameter Real outlet(unit = "m2") = 0.01;
  parameter Real g(unit = "m/s2") = 9.81;
  input Real inflow(unit = "m3/s", start = 0.02);
  output Real level(unit = "m", start = 1, fixed = true, min = 0, max = 20);
  output Real outflow(unit = "m3/s");
equation
  outflow = outlet * sqrt(2 * g * level);
  area * der(level) = inflow - outflow;
end Tank;
"""
PENDULUM = """
model Pendulum "A pendulum with a torque"
  parameter Real stiffness(unit = "1/s2") = 9;
  parameter Real damping(unit = "1/s") = 0.4;
  input Real torque(unit = "1/s2", start = 0);
  output Real angle(unit = "rad", start = 0.1, fixed = true);
  output Real speed(unit = "rad/s", start = 0, fixed = true);
equation
  der(angle) = speed;
  der(speed) = torque - stiffness * sin(angle) - damping * speed;
end Pendulum;
"""


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    return built_models(tmp_path_factory.mktemp("models"), TANK, PENDULUM)


def tanks(models, inflow="0.05 m3/s"):
    """Two tanks, the second fed by the first through a late pipe."""
    system = orc.System(step_size="1 s", stop_time="200 s")
    system.add("upper", models["Tank"], inflow=inflow)
    system.add("lower", models["Tank"], outlet="0.02 m2")
    return system.connect("upper.outflow", "lower.inflow", {"delay": "5 s"}).data


def test_tanks_settle_where_outflow_is_inflow(models):
    """h = (q/a)^2/(2 g), and a root of -q/(2 h A)."""
    found = trim(prepare(tanks(models)))
    levels = {"upper": (0.05 / 0.01) ** 2 / 19.62, "lower": (0.05 / 0.02) ** 2 / 19.62}
    for name, level in levels.items():
        assert found.states[f"{name}.level"].value == pytest.approx(level, rel=1e-12)
        assert abs(found.states[f"{name}.level"].rate) < 1e-12
    linear = orc.linearise(tanks(models), at="trim")
    roots = sorted(one.root.real for one in linear.modes().modes)
    expected = sorted(-0.05 / (2.0 * level * 2.0) for level in levels.values())
    assert roots == pytest.approx(expected, rel=1e-9)
    assert linear.point["upper.level"] == pytest.approx(levels["upper"], rel=1e-12)


def test_a_run_from_the_steady_state_stays_there(models):
    found = trim(prepare(tanks(models)))
    result = orc.run(
        orc.load(tanks(models)), set=dict(one.split("=", 1) for one in found.overrides), halving=False
    )
    for name in ("upper.level", "lower.level"):
        values = result[name].values
        assert np.ptp(values) < 1e-9 * values[0]


def pendulum(models, gain):
    """Its torque follows its own angle, through a delay."""
    system = orc.System(step_size="1 ms", stop_time="1 s")
    system.add("swing", models["Pendulum"])
    effects = ({"gain": f"{gain} 1/(rad.s2)"}, {"offset": "4 1/s2"}, {"delay": "0.1 s"})
    return system.connect("swing.angle", "swing.torque", *effects).data


def test_a_loop_settles_where_its_torques_balance(models):
    found = trim(prepare(pendulum(models, -2.0)))
    angle = found.states["swing.angle"].value
    assert 4.0 - 2.0 * angle == pytest.approx(9.0 * np.sin(angle), abs=1e-10)
    assert found.states["swing.speed"].value == pytest.approx(0.0, abs=1e-12)
    root = orc.linearise(pendulum(models, -2.0), at="trim").modes().dominant.root
    left = root**2 + 0.4 * root + 9.0 * np.cos(angle) + 2.0 * np.exp(-0.1 * root)
    assert abs(left) < 1e-9 * abs(root) ** 2


def test_inputs_behind_a_delay_within_the_fmu():
    """A robot whose command is 1 mm less half its own position comes to 1/1.5 mm."""
    system = orc.System(step_size="0.1 ms", stop_time="1 s")
    system.add("robot", "RobotResponse", omega_n="75 Hz", xi_n=0.8, tau_m="3.33 ms")
    system.connect("robot.position", "robot.command", {"gain": -0.5}, {"offset": "1 mm"})
    found = trim(prepare(system.data))
    assert found.states["robot.position"].value == pytest.approx(1e-3 / 1.5, rel=1e-9)


def test_what_has_no_steady_state_is_named(models, capsys):
    with pytest.raises(ConfigError, match=r"path\.turned goes on changing by 1\.257 rad/s, whatever"):
        trim(prepare("emps"))
    assert main(["stability", "emps", "--trim", "--fix", "path.turned"]) == 0
    printed = capsys.readouterr().out
    assert "path.turned = 0 rad, rate 1.3 rad/s, fixed" in printed
    # 127 m would be needed, and 20 m is the most.
    with pytest.raises(ConfigError, match=r"upper\.level goes on changing by"):
        trim(prepare(tanks(models, inflow="0.5 m3/s")))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--trim", "--fix", "path.turn"], "no state path.turn"),
        (["--fix", "path.turned"], "Add --trim"),
        (["--trim", "--at-time", "1 s"], "two operating points"),
    ],
)
def test_options_that_make_no_sense_are_refused(options, message, capsys):
    assert main(["stability", "emps", *options]) == 2
    assert message in capsys.readouterr().err


def test_each_value_of_a_range_has_a_steady_state_of_its_own(models, tmp_path, capsys):
    """Roots of -q/(2 h A) with h = (q/a)^2/(2 g): -g a^2/(A q)."""
    orc.load(tanks(models)).to_yaml(tmp_path / "tanks.yaml")
    command = ["stability", str(tmp_path / "tanks.yaml"), "--trim", "--out", str(tmp_path / "out")]
    assert main([*command, "--over", "upper.outlet=0.01..0.02 m2", "--points", "3"]) == 0
    report = json.loads((tmp_path / "out" / "stability.json").read_text(encoding="utf-8"))
    expected = [-9.81 * outlet**2 / (2.0 * 0.05) for outlet in (0.01, 0.015, 0.02)]
    assert report["over"]["real"] == pytest.approx(expected, rel=1e-8)
    assert report["trim"]["upper.level"]["value"] == pytest.approx(25.0 / 19.62, rel=1e-12)
    assert "upper.level = 1.27420999 m" in capsys.readouterr().out
