"""The run of the tests itself comes to an end, whatever happens in it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
posix = pytest.mark.skipif(os.name != "posix", reason="uses bash and signals")
_TRIES = 4
_BLOCK = "<!-- test command -->\n```sh\n{command}\n```\n"


def readme_command() -> str:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    return text.split("<!-- test command -->\n```sh\n")[1].split("\n```")[0]


def checkout(folder: Path, command: str) -> Path:
    """A folder with .ci/run and a test command of its own."""
    (folder / ".ci").mkdir()
    shutil.copy(ROOT / ".ci" / "run", folder / ".ci" / "run")
    (folder / "README.md").write_text(_BLOCK.format(command=command))
    return folder


def ci(folder: Path, limit: str) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"TEST_LIMIT": limit}
    return subprocess.run(["bash", ".ci/run"], cwd=folder, env=environment, capture_output=True, text=True)


@posix
def test_a_run_that_hangs_is_ended_and_reported(tmp_path):
    done = ci(checkout(tmp_path, "echo begun && sleep 1000 && echo ended"), "1s")
    assert done.returncode == 124
    reported = "the tests did not end within 1s and were stopped: FAILED"
    assert done.stdout.splitlines() == ["echo begun && sleep 1000 && echo ended", "begun", reported]


@posix
@pytest.mark.parametrize(("command", "status"), [("echo 3 passed", 0), ("echo 1 failed && exit 1", 1)])
def test_the_tests_have_the_last_word(command, status, tmp_path):
    done = ci(checkout(tmp_path, command), "1m")
    assert done.returncode == status
    assert done.stdout.splitlines()[-1] == command.split(" && ")[0].removeprefix("echo ")


_TESTS = """
import os, pathlib, pytest, signal, time

@pytest.mark.parametrize("number", range(4))
def test_before(number):
    pass

def test_in_between():
    {fatal}

@pytest.mark.parametrize("number", range(3))
def test_after(number):
    pass
"""


@posix
@pytest.mark.parametrize(
    ("fatal", "options"),
    [
        ("os.kill(os.getpid(), signal.SIGKILL)", []),
        ("time.sleep(1000)", ["-o", "faulthandler_timeout=3"]),
    ],
    ids=["crash", "hang"],
)
def test_a_crash_or_a_hang_costs_one_test(fatal, options, tmp_path):
    """With --dist loadfile of xdist 3.8 the run waits for ever, or tries the same test again and again."""
    for name in ("one", "two"):
        (tmp_path / f"test_{name}.py").write_text(_TESTS.format(fatal=fatal if name == "two" else "pass"))
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["pytest"]["ini_options"]
    ours = [f"{name}={str(settings[name]).lower()}" for name in settings if name.startswith("faulthandler")]
    assert [one.partition("=")[0] for one in ours] == ["faulthandler_timeout", "faulthandler_exit_on_timeout"]
    (tmp_path / "pytest.ini").write_text("\n".join(["[pytest]", *ours]))
    chosen = readme_command().partition("-m pytest ")[2].split()
    for _ in range(_TRIES):
        done = subprocess.run(
            [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *chosen, *options],
            cwd=tmp_path, capture_output=True, text=True, timeout=300,
        )  # fmt: skip
        # xdist 3.8 sometimes asks the worker that is gone for tests, and stops with an internal error: such a
        # run ends and fails, too, but says less.
        if done.returncode != 3:
            break
        assert "INTERNALERROR" in done.stdout + done.stderr
    assert done.returncode == 1, done.stdout
    assert "1 failed, 15 passed" in done.stdout.splitlines()[-1]
    assert "crashed while running 'test_two.py::test_in_between'" in done.stdout
    if options:
        assert "time.sleep" in done.stderr or "test_in_between" in done.stderr
