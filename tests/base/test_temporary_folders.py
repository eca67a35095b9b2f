"""Temporary folders of killed processes go at the next start, and those of the living stay."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest
import yaml
from unruly import unruly_fmu

from orchestrator.base.temporary_folders import scratch_folder, scratch_root

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="processes are killed by signals")

COMMAND = [sys.executable, "-m", "orchestrator", "run"]


@pytest.fixture
def config(tmp_path):
    data = {
        "run": {"master": "jacobi", "step_size": "1 us", "stop_time": "1000 s", "loop": "python"},
        "instances": {
            "here": {"fmu": str(unruly_fmu(2))},
            "apart": {"fmu": str(unruly_fmu(3)), "isolate": "process"},
        },
    }
    (tmp_path / "config.yaml").write_text(yaml.safe_dump(data))
    return tmp_path / "config.yaml"


def unpacked(temporary):
    """The folders of FMUs there."""
    return set(temporary.glob("*/fmu-*"))


def started(config, temporary, out, count=2):
    """A run that goes on until it is killed, once so many FMUs are unpacked."""
    before = unpacked(temporary)
    process = subprocess.Popen(
        [*COMMAND, str(config), "--out", str(out), "--quiet", "--no-halving"],
        env=os.environ | {"TMPDIR": str(temporary)},
    )
    deadline = time.monotonic() + 60.0
    while (
        len(unpacked(temporary) - before) < count and process.poll() is None and time.monotonic() < deadline
    ):
        time.sleep(0.05)
    assert process.poll() is None
    return process


def test_what_killed_runs_left_goes_at_the_next_start_and_what_others_use_stays(config, tmp_path):
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    killed = started(config, temporary, tmp_path / "killed")
    killed.send_signal(signal.SIGKILL)
    killed.wait()
    left = set(temporary.iterdir())
    assert left
    living = started(config, temporary, tmp_path / "living")
    try:
        mine = set(temporary.iterdir())
        assert not left & mine and mine
        short = [*COMMAND, str(config), "--set", "run.stop_time=1 ms", "--quiet"]
        subprocess.run(short, env=os.environ | {"TMPDIR": str(temporary)}, check=True)
        assert set(temporary.iterdir()) == mine
        assert living.poll() is None
    finally:
        living.send_signal(signal.SIGINT)
        living.wait()
    assert list(temporary.iterdir()) == []


def test_folders_of_a_process_lie_in_one_that_is_locked():
    folder = scratch_folder("x-")
    assert folder.parent == scratch_root() and (scratch_root() / ".running").is_file()
    folder.rmdir()


def test_a_folder_that_is_being_made_is_left_alone(tmp_path):
    young, old = tmp_path / "orchestrator-young", tmp_path / "orchestrator-old"
    for one in (young, old):
        one.mkdir()
    os.utime(old, (0, 0))
    (tmp_path / "other").mkdir()
    command = "from orchestrator.base.temporary_folders import scratch_root; scratch_root()"
    subprocess.run([sys.executable, "-c", command], env=os.environ | {"TMPDIR": str(tmp_path)}, check=True)
    assert sorted(one.name for one in tmp_path.iterdir()) == ["orchestrator-young", "other"]
