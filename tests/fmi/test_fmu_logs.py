"""What FMUs log goes to files of the run's folder; messages of errors show the last lines."""

from __future__ import annotations

import pytest
from unruly import WAYS, unruly_fmu

from orchestrator.base.errors import StepError
from orchestrator.fmi import log_file
from orchestrator.simulation.run import run

each_kind = pytest.mark.parametrize("instance", [{}, {"isolate": "process"}])


def config(way, at, version=2, steps=20, **instance):
    start = {"way": WAYS.index(way), "at": at}
    return {
        "run": {"master": "jacobi", "step_size": "0.1 s", "stop_time": f"{steps / 10} s"},
        "instances": {
            "quiet": {"fmu": str(unruly_fmu(version))},
            "loud": {"fmu": str(unruly_fmu(version)), "start": start, **instance},
        },
    }


@each_kind
@pytest.mark.parametrize("version", [2, 3])
def test_each_instance_that_logs_has_a_file_with_times(version, instance, tmp_path):
    made = run(config("warn", 1.5, version, **instance), out=tmp_path, figures=False)
    assert "log/loud.log" in made.files and not (tmp_path / "log" / "quiet.log").exists()
    lines = (tmp_path / "log" / "loud.log").read_text().splitlines()
    assert lines[0].split("\t") == ["1.5 s", "[warning]", "all", "goes on with a warning"]
    assert len(lines) == 5  # of the run itself, not of the one with half the step
    # A second run begins with empty files.
    run(config("nothing", 0.0, version, **instance), out=tmp_path, figures=False)
    assert list((tmp_path / "log").iterdir()) == []


@each_kind
def test_a_failed_run_keeps_the_log_and_shows_its_last_ten_lines(instance, tmp_path):
    wanted = config("warn", 0.0, steps=60, **instance)
    wanted["instances"]["bad"] = {
        "fmu": str(unruly_fmu(2)), "start": {"way": WAYS.index("fails"), "at": 4.0}, **instance
    }  # fmt: skip
    with pytest.raises(StepError) as caught:
        run(wanted, out=tmp_path)
    assert str(caught.value).startswith("bad at time 4 s: ")
    assert (tmp_path / "log" / "bad.log").read_text() == "4 s\t[error]\tall\tfails as told\n"
    assert len((tmp_path / "log" / "loud.log").read_text().splitlines()) == 41


def test_messages_show_the_error_first_and_the_last_ten_lines_of_the_log():
    error = StepError("broke", instance="a", time=1.0, status="error", log=[str(n) for n in range(50)])
    lines = str(error).splitlines()
    assert lines[0] == "a at time 1 s: broke"
    assert lines[1] == "  log of the FMU, the last 10 of 50 lines:" and lines[2:] == [
        f"    {n}" for n in range(40, 50)
    ]


def test_a_chatty_fmu_fills_no_disk(tmp_path, monkeypatch):
    monkeypatch.setattr(log_file, "_LARGEST", 200)
    run(config("warn", 0.0, steps=100), out=tmp_path, figures=False, halving=False)
    lines = (tmp_path / "log" / "loud.log").read_text().splitlines()
    assert len(lines) < 10 and "further lines are left out" in lines[-1]


def test_many_lines_at_once_fill_the_file_up_to_its_size_in_bytes(tmp_path, monkeypatch):
    monkeypatch.setattr(log_file, "_LARGEST", 2000)
    file = log_file.LogFile(tmp_path, "a")
    file.write(["ü" * 40] * 1000, lambda: 1.0)
    file.write(["later"], lambda: 2.0)
    file.close()
    lines = file.path.read_text(encoding="utf-8").splitlines()
    assert len(lines) == 2000 // 85 + 1 and lines[0] == "1 s\t" + "ü" * 40
    assert "further lines are left out" in lines[-1]


def test_what_a_second_writer_appends_counts_with_what_is_there(tmp_path, monkeypatch):
    monkeypatch.setattr(log_file, "_LARGEST", 100)
    for _ in range(2):
        file = log_file.LogFile(tmp_path, "a")
        file.write(["x" * 40], lambda: 1.0)
        file.write(["y" * 40], lambda: 1.0)
        file.close()
    assert file.path.read_text().count("x" * 40) == 1
