"""Inputs that nothing feeds keep the start value that their FMU declares, unless a config refuses that."""

from __future__ import annotations

import json

import pytest
import yaml
from unruly import unruly_fmu

from orchestrator.cli.main import main
from orchestrator.simulation.run import run


@pytest.fixture
def config(tmp_path):
    data = {
        "run": {"master": "jacobi", "step_size": "0.1 s", "stop_time": "1 s"},
        "instances": {name: {"fmu": str(unruly_fmu(2))} for name in ("one", "two", "three")},
        "connections": ["one.level -> two.rate"],
    }
    (tmp_path / "config.yaml").write_text(yaml.safe_dump(data))
    return tmp_path / "config.yaml"


def test_they_are_counted_in_one_line_and_listed_on_request(config, capsys):
    assert main(["check", str(config)]) == 0
    brief = capsys.readouterr().out
    assert brief.count("2 inputs have no connection and keep the start value") == 1
    assert "one.rate" not in brief
    assert main(["check", str(config), "-v"]) == 0
    said = capsys.readouterr().out
    assert "no connection: one.rate = 0 m\n" in said and "no connection: three.rate = 0 m\n" in said
    assert main(["check", str(config), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["unconnected"] == {"one.rate": "0 m", "three.rate": "0 m"}


def test_they_keep_the_declared_value(config):
    made = run(config, halving=False)
    assert (made.results["one.level"] == 0.0).all()
    assert made.summary["parameters"]["one.rate"] == 0.0


def test_a_config_may_refuse_them(config, capsys):
    assert main(["check", str(config), "--set", "run.unconnected=error"]) == 2
    said = capsys.readouterr().err
    assert "input one.rate [m] is not connected and has no start value" in said
    assert "input three.rate [m] is not connected and has no start value" in said
