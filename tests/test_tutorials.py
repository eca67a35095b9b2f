"""Tutorials do what their pages say: every command and every line of Python runs, with these figures."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from orchestrator.cli.main import main

DOCS = Path(__file__).parents[1] / "docs"


def blocks(text: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", text, flags=re.DOTALL)


def write_inputs(text: str, folder: Path) -> None:
    """Write a page's models, configs and tables to the files that it names."""
    for one in blocks(text, "modelica"):
        name = re.match(r"model (\w+)", one)[1]
        (folder / f"{name}.mo").write_text(one, encoding="utf-8")
    for one in blocks(text, "yaml"):
        (folder / re.match(r"# (\S+)", one)[1]).write_text(one, encoding="utf-8")


def run_commands(text: str, capsys: pytest.CaptureFixture[str]) -> dict[str, str]:
    """Run the commands of a page, and return the output of each by its first two words."""
    printed = {}
    for line in "".join(blocks(text, "sh")).splitlines():
        command = shlex.split(line)
        assert command[0] == "orchestrator"
        assert main(command[1:]) == 0, line
        printed[" ".join(command[1:3])] = capsys.readouterr().out
    return printed


def test_the_servo_tutorial(tmp_path, monkeypatch, capsys):
    text = (DOCS / "tutorial-servo.md").read_text(encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    write_inputs(text, tmp_path)
    printed = run_commands(text, capsys)
    report = printed["stability servo.yaml"]
    assert "\nstable\n" in report
    weakest = report.partition("the weakest first:\n")[2].splitlines()[0]
    assert weakest.startswith("  controller.torque -> delay -> drive.torque: ")
    assert float(re.search(r"delay ([\d.]+) ms", weakest)[1]) == pytest.approx(3.09, abs=0.005)
    assert "39.2 Hz, damping 0.5822" in report
    names: dict[str, object] = {}
    exec("\n".join(blocks(text, "python")), names)
    assert len(names["table"]["controller.speed_gain"]) == 3


def test_the_tutorial_on_your_own_fmu(tmp_path, monkeypatch, capsys):
    text = (DOCS / "tutorial-fmu.md").read_text(encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    write_inputs(text, tmp_path)
    (table,) = blocks(text, "csv")
    (tmp_path / "power.csv").write_text(table, encoding="utf-8")
    thermostat, reading = blocks(text, "python")
    (tmp_path / "Thermostat.py").write_text(thermostat, encoding="utf-8")
    printed = run_commands(text, capsys)
    assert printed["check start.yaml"].startswith("start: 2 instances, 2 connections")
    names: dict[str, object] = {}
    exec(reading, names)
    assert [round(one, 1) for one in names["with_sensor"]] == [19.7, 21.7]
    assert [round(one, 1) for one in names["direct"]] == [20.5, 21.5]


def test_the_tutorial_on_diagnosis(tmp_path, monkeypatch, capsys):
    text = (DOCS / "tutorial-diagnosis.md").read_text(encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    write_inputs(text, tmp_path)
    logging, reading = blocks(text, "python")
    names: dict[str, object] = {}
    exec(logging, names)
    printed = run_commands(text, capsys)
    (verdict,) = blocks(text, "text")
    assert verdict.strip() in printed["diagnose study.yaml"]
    exec(reading, names)
    diagnosis = names["diagnosis"]
    assert diagnosis["laws"][0]["numbers"]["level"]["value"] == pytest.approx(-12.0, rel=0.01)
    assert diagnosis["held_out"]["closed"] > 0.97
