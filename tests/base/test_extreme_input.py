"""Input of any size is refused with a message, quickly: numbers, nesting, aliases."""

from __future__ import annotations

import subprocess
import sys
from time import perf_counter

import pytest

from orchestrator.base.errors import ConfigError
from orchestrator.cli.main import main
from orchestrator.config.text import MOST_ALIASED, compose

# Each list holds the former nine times: 9**8 values in nine lines.
BOMB = "\n".join(
    ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    + [f"a{level}: &a{level} [{', '.join([f'*a{level - 1}'] * 9)}]" for level in range(1, 8)]
    + ["run: *a7\n"]
)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (BOMB, "its aliases stand for 102908548 values"),
        ("run: " + "[" * 150 + "]" * 150, "lists and mappings within each other"),
        ("run: " + "[" * 100_000 + "]" * 100_000, "not YAML: "),
        ("a: &a {b: *a}", "an alias that contains itself"),
    ],
)
@pytest.mark.parametrize("command", [["check"], ["run"], ["sweep", "--store", "store"], ["diagnose"]])
def test_what_expands_is_refused(tmp_path, capsys, monkeypatch, command, text, problem):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "x.yaml").write_text(text, encoding="utf-8")
    begin = perf_counter()
    assert main([command[0], "x.yaml", *command[1:]]) == 2
    assert problem in capsys.readouterr().err
    assert perf_counter() - begin < 10.0  # hours, and all of the memory, without the limit
    assert [one.name for one in tmp_path.iterdir()] == ["x.yaml"]


PLACES = {
    "config that another extends": ("base.yaml", "", {"x.yaml": "extends: base.yaml\n"}, "check x.yaml"),
    "system of a sweep": (
        "base.yaml", "",
        {"x.yaml": "format: sweep/1\nsystem: base.yaml\ndesign: {grid: {a: [1]}}\n"}, "sweep x.yaml --check",
    ),
    "system of a study": (
        "base.yaml", "", {"x.yaml": "format: port-study/1\nsystem: base.yaml\nruns: []\n"}, "diagnose x.yaml"
    ),
    "folder of a case": ("case/case.yaml", "format: gap-case/1\n", {}, "diagnose case"),
    "folder of a study": ("case/study.yaml", "format: gap-study/1\n", {}, "diagnose case"),
    "system of a challenge": ("x.yaml", "", {}, "challenge x.yaml --out made"),
    "case of a challenge": (
        "all/a/case.yaml", "format: gap-case/1\n", {}, "challenge run all --verdicts made"
    ),
}  # fmt: skip


@pytest.mark.parametrize("place", PLACES)
def test_what_expands_is_refused_wherever_a_command_reads_it(place, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    name, head, beside, command = PLACES[place]
    for file, text in {name: head + BOMB, **beside}.items():
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / file).write_text(text, encoding="utf-8")
    assert main(command.split()) in ((1,) if "challenge run" in command else (2,))
    found = capsys.readouterr().err
    assert "its aliases stand for 102908548 values" in found and "Traceback" not in found


@pytest.mark.parametrize(
    ("command", "status"),
    [
        ("diagnose x.yaml", 2), ("diagnose study.yaml", 2), ("diagnose all/a", 2),
        ("challenge x.yaml --out made", 2), ("challenge study.yaml --out made", 2),
        ("challenge run all --verdicts made", 1), ("sweep sweep.yaml --check", 2),
    ],
)  # fmt: skip
def test_what_expands_is_refused_before_modules_load_for_seconds(command, status, tmp_path):
    (tmp_path / "x.yaml").write_text(BOMB, encoding="utf-8")
    (tmp_path / "study.yaml").write_text("format: port-study/1\nsystem: x.yaml\nruns: []\n", encoding="utf-8")
    (tmp_path / "sweep.yaml").write_text("format: sweep/1\nsystem: x.yaml\n", encoding="utf-8")
    (tmp_path / "all/a").mkdir(parents=True)
    (tmp_path / "all/a/case.yaml").write_text("format: gap-case/1\n" + BOMB, encoding="utf-8")
    program = "import sys; from orchestrator.cli.main import main; "
    program += f"status = main({command.split()}); "
    program += "print(status, {'numba', 'scipy', 'matplotlib'} & {*sys.modules})"
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True)
    assert done.stdout.splitlines()[-1] == f"{status} set()" and "its aliases stand for" in done.stderr
    found = {one.name for one in tmp_path.iterdir()}
    assert found - {"made"} == {"x.yaml", "study.yaml", "sweep.yaml", "all"}


def test_aliases_are_taken_up_to_the_limit():
    few = "a: &a [1, 2]\nb: [*a, *a]\n"
    assert compose(few, "x")[0] == {"a": [1, 2], "b": [[1, 2], [1, 2]]}
    row = "a: &a [" + ", ".join(["1"] * 999) + "]\nb: ["
    assert len(compose(row + ", ".join(["*a"] * (MOST_ALIASED // 1000)) + "]\n", "x")[0]["b"]) == 100
    with pytest.raises(ConfigError):
        compose(row + ", ".join(["*a"] * (MOST_ALIASED // 1000 + 2)) + "]\n", "x")


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("robot.tau_m=1e400 ms", "cannot take '1e400 ms', about 1e397 is beyond double precision"),
        ("robot.tau_m=-1e999 s", "cannot take '-1e999 s', about -1e999 is beyond double precision"),
        ("robot.tau_m=1e123456789 s", "1e123456789 is beyond double precision"),
        ("robot.tau_m=1 s99999999", "the power of s in unit 's99999999' is above 30"),
        ("robot.xi_n=1e400", "must be a finite number, got inf"),
        (f"robot.xi_n={'9' * 400}", "about 1e400 is beyond double precision"),
        (f"robot.xi_n={'9' * 5000}", "a number of 5000 characters"),
        ("run.step_size=1e-300 s", "step_size 1e-300 s makes more than 1e+12 steps"),
        ("run.step_size=1e400 s", "about 1e400 is beyond double precision"),
        ("run.stop_time=1e300 s", "makes more than 1e+12 steps"),
        ("run.record_every=1e400", "run.record_every"),
        ("connections[0].through=[{delay: 1e400 s}]", "about 1e400 is beyond double precision"),
        (f"connections[0].through=[{{gain: {'9' * 400}}}]", "gain"),
    ],
)
def test_numbers_of_any_size(capsys, override, message):
    assert main(["check", "docking-1d", "--set", override]) == 2
    assert message in capsys.readouterr().err


def test_a_step_below_the_resolution_of_time(capsys):
    times = ("run.start_time=1e12 s", "run.stop_time=1000000000001 s", "run.step_size=0.1 us")
    arguments = [part for one in times for part in ("--set", one)]
    assert main(["check", "docking-1d", *arguments]) == 2
    assert "is below the resolution of times near stop_time" in capsys.readouterr().err
