"""Commands write over what they wrote themselves, and over nothing else."""

from __future__ import annotations

import pytest

from orchestrator.base.atomic_files import replaceable
from orchestrator.base.errors import ConfigError
from orchestrator.cli.main import main


def test_a_file_of_another_kind_is_not_written_over(tmp_path):
    there = tmp_path / "model.mo"
    there.write_text("model M end M;")
    with pytest.raises(ConfigError) as caught:
        replaceable(there, (".fmu",), "--output")
    assert str(caught.value) == (
        f"--output: {there} is there already, and is no .fmu file\n  Name another file, or remove that one."
    )
    replaceable(tmp_path / "new.txt", (".fmu",), "--output")
    (tmp_path / "old.fmu").write_text("")
    replaceable(tmp_path / "old.fmu", (".fmu",), "--output")


@pytest.mark.parametrize(
    "command", [["build", "{0}", "-o", "{0}"], ["report", "{1}", "-o", "{0}"]], ids=["build", "report"]
)
def test_the_commands_leave_it(command, tmp_path, capsys):
    there = tmp_path / "model.mo"
    there.write_text("model M end M;")
    assert main([one.format(there, tmp_path) for one in command]) in (1, 2)
    assert "is there already" in capsys.readouterr().err
    assert there.read_text() == "model M end M;"
