"""`orchestrator stability`: what it prints and writes."""

import json

from orchestrator.__main__ import main


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
    assert "robot.tau_m beyond 3.3551 ms: unstable, 4.025 Hz" in printed
    assert "growth of the velocity per contact: 0.94691 by the rightmost roots" in printed
    report = json.loads((tmp_path / "stability.json").read_text(encoding="utf-8"))
    assert report["margins"]["stable"] and report["residual"] < 1e-12
    assert report["step"]["master"] == "gauss-seidel"
    for name in ("bode", "nyquist", "nichols", "roots", "chart"):
        assert (tmp_path / f"{name}.png").stat().st_size > 10_000


def test_active_controller_stands_on_the_border(capsys):
    assert main(["stability", "docking-1d"]) == 0
    printed = capsys.readouterr().out
    assert "on the border of stability: a contact changes the velocity by less than 1e-5" in printed
    assert "note: controller.switching_compensation is not linear and is left out" in printed


def test_wrong_parameters_are_refused(capsys):
    assert main(["stability", "docking-1d-uncompensated", "--set", "robot.taum=1 ms"]) == 2
    assert "taum" in capsys.readouterr().err
