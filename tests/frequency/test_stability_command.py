"""`orchestrator stability`: what it prints and writes."""

import json

import numpy as np

from orchestrator.cli.main import main
from orchestrator.frequency.gain import verdict


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
    fall, rise = report["margins"]["gain_margin"]
    least = f"down to {fall:.4g} times" if fall else "down to nothing"
    most = f"up to {rise:.4g} times ({20.0 * np.log10(rise):.3g} dB)"
    assert f"gain margin: the gain may go {least} and {most}" in printed
    assert report["verdict"] == printed.splitlines()[1] == "stable"
    assert report["step"]["master"] == "gauss-seidel"
    for name in ("bode", "nyquist", "nichols", "roots", "chart"):
        assert (tmp_path / f"{name}.png").stat().st_size > 10_000


def test_active_controller_stands_on_the_border(capsys):
    assert main(["stability", "docking-1d"]) == 0
    printed = capsys.readouterr().out
    assert "on the border of stability: a contact changes the velocity by less than 1e-5" in printed
    assert "note: controller.switching_compensation is not linear and is left out" in printed
    (contact,) = (one for one in printed.splitlines() if one.startswith("one contact after free flight"))
    assert contact.endswith(
        "119.7 ms, without controller.switching_compensation, which in a run takes back what onset adds to "
        "the 1.00000 above"
    )


def test_figures_of_a_loop_on_the_border(monkeypatch):
    from orchestrator.frequency import report
    from orchestrator.frequency.loop import Loop

    monkeypatch.setattr(report, "chart", lambda *_: None)  # takes long, and is not looked at
    monkeypatch.setattr("orchestrator.frequency.figures.stability_chart", lambda *_: None)
    drawn = report.stability_figures(Loop.of("docking-1d"))
    (name,) = (text.get_text() for text in drawn["nyquist"].axes[0].get_legend().get_texts())
    assert name == "docking-1d: on the border of stability"
    drawn["bode"].canvas.draw()
    _, phase = drawn["bode"].axes
    low, high = phase.get_ylim()
    assert low <= -185.0 + 1e-3 and high >= -175.0 - 1e-3 and phase.yaxis.get_offset_text().get_text() == ""
    shown = [one.get_text() for one in phase.get_xticklabels() if phase.get_xlim()[0] < one.get_position()[0]]
    assert shown[:5] == ["0.2", "0.5", "1", "2", "5"]


def test_verdicts_are_the_same_wherever_they_stand():
    assert verdict(2, 1.0 + 1e-6) == verdict(0, 1.0 - 1e-6) == "on the border of stability"
    assert verdict(2, 1.2) == "unstable: 2 roots with positive real part"
    assert verdict(1, None) == "unstable: 1 root with positive real part"
    assert verdict(0, 0.9) == "stable"


def test_wrong_parameters_are_refused(capsys):
    assert main(["stability", "docking-1d-uncompensated", "--set", "robot.taum=1 ms"]) == 2
    assert "taum" in capsys.readouterr().err
