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


def test_the_servo_tutorial(tmp_path, monkeypatch, capsys):
    text = (DOCS / "tutorial-servo.md").read_text(encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    for one in blocks(text, "modelica"):
        name = re.match(r"model (\w+)", one)[1]
        (tmp_path / f"{name}.mo").write_text(one, encoding="utf-8")
    (config,) = blocks(text, "yaml")
    (tmp_path / "servo.yaml").write_text(config, encoding="utf-8")
    printed = {}
    for line in "".join(blocks(text, "sh")).splitlines():
        command = shlex.split(line)
        assert command[0] == "orchestrator"
        assert main(command[1:]) == 0, line
        printed[" ".join(command[1:3])] = capsys.readouterr().out
    report = printed["stability servo.yaml"]
    assert "\nstable\n" in report
    weakest = report.partition("the weakest first:\n")[2].splitlines()[0]
    assert weakest.startswith("  controller.torque -> delay -> drive.torque: ")
    assert float(re.search(r"delay ([\d.]+) ms", weakest)[1]) == pytest.approx(3.09, abs=0.005)
    assert "39.2 Hz, damping 0.5822" in report
    names: dict[str, object] = {}
    exec("\n".join(blocks(text, "python")), names)
    assert len(names["table"]["controller.speed_gain"]) == 3
