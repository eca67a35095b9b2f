"""What the controller's open choices do to the system in six degrees of freedom."""

from __future__ import annotations

import pytest

from orchestrator.docking import sensitivity


def test_missed_work_has_to_be_restored():
    settings = ["run.stop_time=1.3 s"]
    chosen = sensitivity.measured(sensitivity.CHANGES["as chosen"], settings)
    without = sensitivity.measured(sensitivity.CHANGES["missed work not restored"], settings)
    assert chosen["contacts"] == without["contacts"] == 2
    assert chosen["energy"] == pytest.approx(1.0, abs=3e-4)
    assert without["energy"] > 1.05 and without["first_cor"] > chosen["first_cor"] + 0.02
    assert abs(chosen["stiffness_error"]) < 1e-3


def test_a_run_without_contacts_says_so():
    with pytest.raises(ValueError) as caught:
        sensitivity.measured((), ["run.stop_time=0.2 s"])
    assert str(caught.value) == "sensitivity: 0 contacts in the run; needed: 2; let it run longer"


def test_the_command_writes_table_and_figure(tmp_path, capsys, monkeypatch):
    wanted = ("as chosen", "normal not averaged")
    monkeypatch.setattr(sensitivity, "CHANGES", {name: sensitivity.CHANGES[name] for name in wanted})
    monkeypatch.setattr(sensitivity.measured, "__defaults__", (("run.stop_time=1.3 s",),))
    assert sensitivity.main(["--out", str(tmp_path)]) == 0
    rows = (tmp_path / "sensitivity.csv").read_text().splitlines()
    assert rows[0].startswith("variation,contacts,first_cor") and [row.split(",")[0] for row in rows[1:]] == [
        *wanted
    ]
    assert "as chosen" in capsys.readouterr().out
    assert (tmp_path / "sensitivity.png").stat().st_size > 10000
