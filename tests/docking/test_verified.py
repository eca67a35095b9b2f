"""`--verify` in contact: co-simulations that a constant push holds there."""

from __future__ import annotations

import json

import pytest

from orchestrator.cli.main import main


@pytest.mark.parametrize(
    "options",
    [
        ("docking-1d-uncompensated",),
        ("docking-1d-smith",),
        ("docking-1d-osaki",),
        ("docking-1d-admittance",),
        ("docking-1d", "--set", "controller.switching_compensation=false"),
    ],
)
def test_runs_held_in_contact_move_as_their_roots(options, capsys):
    assert main(["stability", *options, "--verify", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert not report["not_linear"]
    assert all(one["difference"] < 1e-5 for one in report["verify"]["sampled"])


def test_a_passivity_controller_is_named_and_no_growth_is_stated(capsys):
    assert main(["stability", "docking-1d-passivity", "--verify"]) == 0
    words = capsys.readouterr().out
    assert "controller is not linear at its operating point" in words
    assert "without what controller does" in words and "the runs do not move as the linear system" in words
    assert "growth" not in words


def test_another_program_is_refused_at_once(capsys):
    assert main(["stability", "docking-1d-rig"]) == 2
    assert "station: it is another program" in capsys.readouterr().err
