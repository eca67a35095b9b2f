"""One run at a time writes to a folder; one that was killed holds nobody up."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from unruly import unruly_fmu

from orchestrator.base.errors import ConfigError
from orchestrator.base.folder_lock import NAME, locked
from orchestrator.cli.main import main
from orchestrator.results.recorders import read_results
from orchestrator.simulation.run import run

SYSTEM = """
run: {master: jacobi, step_size: 1 ms, stop_time: 1 h, loop: python}
instances:
  one: {fmu: FMU, start: {rate: 0.1 m}}
"""


def refusal(folder: Path, process: int) -> str:
    return (
        f"{folder}: another run (process {process}) is writing to this folder\n"
        "  a folder takes one run at a time. Wait until it has ended, or give another folder."
    )


@pytest.fixture
def config(tmp_path) -> Path:
    path = tmp_path / "tank.yaml"
    path.write_text(SYSTEM.replace("FMU", str(unruly_fmu(1, "m", "m"))), encoding="utf-8")
    return path


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="sends a POSIX signal")
def test_a_second_run_is_refused_and_follows_a_killed_one(config, tmp_path, capsys):
    out = tmp_path / "out"
    process = subprocess.Popen(
        [sys.executable, "-m", "orchestrator", "run", str(config), "--out", str(out), "--quiet"],
        cwd=Path(__file__).parents[2], env={**os.environ},
    )  # fmt: skip
    try:
        file, deadline = out / "results.arrow", time.monotonic() + 60.0
        while time.monotonic() < deadline and not (file.is_file() and file.stat().st_size > 10_000):
            time.sleep(0.02)
        short = [
            "run",
            str(config),
            "--out",
            str(out),
            "--quiet",
            "--no-figures",
            "--set",
            "run.stop_time=1 s",
        ]
        size = file.stat().st_size
        assert main(short) == 2
        assert capsys.readouterr().err == f"orchestrator: {refusal(out, process.pid)}\n"
        assert process.poll() is None and file.stat().st_size >= size  # nothing of the first was touched
    finally:
        process.kill()
        process.wait()
    assert (out / NAME).exists()
    assert main(short) == 0
    assert len(read_results(out)) == 1001
    assert not (out / NAME).exists()


def test_runs_of_one_process_refuse_each_other(config, tmp_path):
    with locked(tmp_path):
        with pytest.raises(ConfigError) as caught:
            run(config, out=tmp_path)
        assert str(caught.value) == refusal(tmp_path, os.getpid())
    assert sorted(path.name for path in tmp_path.iterdir()) == ["tank.yaml"]


def test_several_systems_lock_the_folder_of_all(tmp_path, capsys):
    with locked(tmp_path):
        assert main(["run", "docking-1d", "docking-1d-uncompensated", "--out", str(tmp_path)]) == 2
    assert capsys.readouterr().err == f"orchestrator: {refusal(tmp_path, os.getpid())}\n"
    assert list(tmp_path.iterdir()) == []


def test_the_lock_goes_when_a_run_fails(tmp_path):
    with pytest.raises(ZeroDivisionError), locked(tmp_path):
        raise ZeroDivisionError
    with locked(tmp_path):
        assert (tmp_path / NAME).read_text() == f"{os.getpid()}\n"


def test_of_many_at_once_one_holds_it(tmp_path):
    """The file is removed by each holder, which must let no two of them in."""
    inside, worst, taken = 0, 0, 0
    guard = threading.Lock()

    def take() -> None:
        nonlocal inside, worst, taken
        for _ in range(200):
            try:
                with locked(tmp_path):
                    with guard:
                        inside, taken = inside + 1, taken + 1
                        worst = max(worst, inside)
                    time.sleep(0)
                    with guard:
                        inside -= 1
            except ConfigError:
                pass

    threads = [threading.Thread(target=take) for _ in range(4)]
    for one in threads:
        one.start()
    for one in threads:
        one.join()
    assert worst == 1 and taken > 1


def test_a_folder_that_cannot_be_written_to(tmp_path):
    with pytest.raises(ConfigError, match="cannot write to the folder"), locked(tmp_path / "absent"):
        pass
