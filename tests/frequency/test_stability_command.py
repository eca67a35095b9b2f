"""`orchestrator stability`: what it prints and writes."""

import json
import re

import pytest

from orchestrator.cli.main import main


def test_report_and_figures(tmp_path, capsys):
    code = main(
        [
            "stability",
            "docking-1d-uncompensated",
            "--set",
            "contact.damping=1200 N.s/m",
            "--out",
            str(tmp_path),
        ]
    )
    printed = capsys.readouterr().out
    assert code == 0
    # 2 ms of the robot and 1.3551 ms more.
    assert re.search(r"satellite.position -> robot.command: phase \S+ deg, delay 1.35507 ms", printed)
    assert "growth of the velocity per contact: 0.94691 by the rightmost roots" in printed
    report = json.loads((tmp_path / "stability.json").read_text(encoding="utf-8"))
    assert report["verdict"] == printed.splitlines()[1] == "stable"
    margin = report["margins"]["satellite.position -> robot.command"]["delay_margin"]
    assert margin == pytest.approx(1.3551e-3, abs=5e-8)
    assert report["later"]["delay_margin"] < margin
    assert f"later at once: {1e3 * report['later']['delay_margin']:.6g} ms each" in printed
    assert report["sampled"]["master"] == "gauss-seidel"
    assert report["docking"]["growth_with_steps"] == pytest.approx(0.94691, abs=1e-4)
    for name in ("bode", "nyquist", "nichols", "roots", "step", "participation"):
        assert (tmp_path / f"{name}.png").stat().st_size > 10_000


def test_active_controller_stands_on_the_border(capsys):
    assert main(["stability", "docking-1d"]) == 0
    printed = capsys.readouterr().out
    assert printed.splitlines()[1].startswith("on the border: 2 roots without damping, of satellite.velocity")
    assert "on the border of stability, a contact changes it by less than 1e-5" in printed
    assert "note: controller: switching_compensation is not linear and is left out" in printed
    (contact,) = (one for one in printed.splitlines() if one.startswith("one contact after free flight"))
    assert contact == (
        "one contact after free flight: velocity x 1.01000, energy x 1.02010, 119.7 ms, without "
        "controller.switching_compensation, which in a run takes back what onset adds"
    )


def test_an_arm_of_fmus_without_derivatives_is_measured(capsys):
    assert main(["stability", "arm-tracking"]) == 0
    printed = capsys.readouterr().out
    assert printed.splitlines()[1] == "stable"
    assert "-376.991 +-282.743j 1/s: 75 Hz, damping 0.8" in printed
    assert "inverse offers no directional derivatives; its step response was measured: 0 states" in printed


def test_wrong_parameters_are_refused(capsys):
    assert main(["stability", "docking-1d-uncompensated", "--set", "robot.taum=1 ms"]) == 2
    assert "taum" in capsys.readouterr().err


def test_ranges_that_the_config_does_not_take_are_reported_at_their_options(capsys):
    ranges = ["robot.tau_m=1..8", "contact.stiffnes=1..2 N/mm"]
    assert main(["stability", "docking-1d-uncompensated", "--over", ranges[0], "--over", ranges[1]]) == 2
    printed = capsys.readouterr().err
    assert "--over robot.tau_m=1..8" in printed and "has no unit" in printed
    assert "--over contact.stiffnes=1..2 N/mm" in printed and "--set" not in printed
