"""A crash or a hang of an isolated FMU ends the run with a message, and what was recorded is kept."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import foreign
import numpy as np
import pytest
from archives import repack

from orchestrator.base.errors import ConfigError, FmuError, StepError
from orchestrator.cli.main import main
from orchestrator.config import load_config
from orchestrator.fmi import Point, RunOptions, StepStatus, load_fmu
from orchestrator.results.recorders import read_results
from orchestrator.simulation.run import prepare, run

ISOLATED = RunOptions(isolated=True)
CRASH, HANG, LEAVE = 1, 2, 4
posix = pytest.mark.skipif(os.name != "posix", reason="signals are reported by name on POSIX only")


@pytest.fixture
def wild(tmp_path):
    return foreign.wild(tmp_path / "Wild.fmu")


def config(path, way, **instance):
    return {
        "run": {"master": "jacobi", "step_size": "0.1 s", "stop_time": "1 s"},
        "instances": {
            "good": {"fmu": str(path), "start": {"u": 1}},
            "bad": {
                "fmu": str(path),
                "start": {"u": 2, "way": way, "at": 0.5},
                "isolate": "process",
                **instance,
            },
        },
    }


@posix
def test_a_crash_ends_the_run_with_a_message_and_keeps_the_results(wild, tmp_path):
    out = tmp_path / "out"
    with pytest.raises(StepError) as caught:
        run(config(wild, CRASH), out=out)
    error = caught.value
    assert str(error).splitlines() == [
        "bad at time 0.5 s: its process died in do_step: SIGSEGV (Segmentation fault)",
        "  log of the FMU:",
        *["    [printed] a line on the standard output"] * 5,
        "    [printed] about to write to nowhere",
    ]
    assert (error.instance, error.time, error.status) == ("bad", 0.5, "crashed")
    kept = read_results(out)
    assert kept.time == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4, 0.5])
    assert kept["bad.y"] == pytest.approx(2.0 * kept.time)
    assert kept["good.y"] == pytest.approx(kept.time)


@posix
def test_a_crash_that_is_not_isolated_tells_the_call(wild, tmp_path):
    unruly = config(wild, CRASH)
    del unruly["instances"]["bad"]["isolate"]
    path = tmp_path / "unruly.json"
    path.write_text(json.dumps(unruly), encoding="utf-8")
    command = [sys.executable, "-m", "orchestrator", "run", str(path), "--out", str(tmp_path / "out")]
    ended = subprocess.run(command, cwd=Path(__file__).parents[2], capture_output=True, text=True)
    assert ended.returncode == -signal.SIGSEGV
    assert "Fatal Python error: Segmentation fault" in ended.stderr
    assert re.search(r'orchestrator/fmi/.*\.py", line \d+ in do_step', ended.stderr), ended.stderr


def test_a_hang_is_ended_after_the_time_limit_and_keeps_the_results(wild):
    with pytest.raises(StepError) as caught:
        # Long enough for a busy machine to load the FMU; its step never ends.
        run(config(wild, HANG, time_limit="5 s"))
    error = caught.value
    assert str(error).splitlines()[:2] == [
        "bad at time 0.5 s: do_step did not return within 5 s; its process was ended",
        "  If the FMU is only slow, raise instances.bad.time_limit.",
    ]
    assert (error.instance, error.time, error.status) == ("bad", 0.5, "time limit")
    kept = error.result.results
    assert kept["bad.y"] == pytest.approx([0.0, 0.2, 0.4, 0.6, 0.8, 1.0])


def test_an_fmu_that_ends_its_process_is_reported(wild):
    with pytest.raises(StepError) as caught:
        run(config(wild, LEAVE))
    assert caught.value.what == "its process died in do_step: exit code 3"


def test_nothing_is_left_behind(wild, monkeypatch, tmp_path):
    folder = tmp_path / "unpacked"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    fmu = load_fmu(wild, ISOLATED)
    one = fmu.instantiate("one")
    assert len(list(folder.iterdir())) >= 1
    process = one._process
    one.free()
    one.free()
    assert process.poll() is not None
    with pytest.raises(StepError):
        run(config(wild, CRASH))
    assert list(folder.glob("*/fmu-*")) == []


def driven(path, run_options, count=20):
    """Outputs of an FMU under an input that changes at every step."""
    instance = load_fmu(path, run_options).instantiate("one")
    outputs = [v.name for v in instance.description.outputs if v.kind.numeric]
    inputs = [v.name for v in instance.description.inputs if v.kind.numeric]
    u, y = np.zeros(len(inputs)), np.zeros(len(outputs))
    instance.bind(inputs, u, outputs, y)
    instance.enter_initialisation(0.0, {}, 10.0)
    instance.set_values({})
    first = instance.get_values(outputs)
    instance.exit_initialisation()
    rows = []
    for n in range(count):
        u[:] = 1.0 + np.sin(n + np.arange(len(inputs)))  # unsigned ones take no negative numbers
        instance.write_inputs()
        assert instance.do_step(Point(n, 0.01 * n, 0.01)) <= StepStatus.WARNING
        instance.read_outputs()
        rows.append(y.copy())
    instance.terminate()
    instance.free()
    return first, np.array(rows)


@pytest.mark.parametrize("kind", ["wild", "arrays", "ball1", "ball2", "ball3", "slave1"])
def test_isolation_changes_no_bit(kind, tmp_path):
    path = tmp_path / "F.fmu"
    if kind.startswith("ball"):
        foreign.bounce(path, int(kind[-1]))
    elif kind == "slave1":
        foreign.bounce(path, 1, slave=True)
    else:
        {"wild": foreign.wild, "arrays": foreign.arrays}[kind](path)
    tolerance = None if kind == "slave1" else 1e-6  # FMI 1.0 cannot be determined one
    here = driven(path, RunOptions(tolerance=tolerance))
    there = driven(path, RunOptions(tolerance=tolerance, isolated=True, time_limit=30.0))
    assert here[0] == there[0]
    assert np.array_equal(here[1], there[1])
    assert len(np.unique(here[1][:, 0])) > 1


def test_isolation_changes_no_bit_for_every_type(c_fmu):
    here, there = driven(c_fmu, RunOptions(), 5), driven(c_fmu, ISOLATED, 5)
    assert here[0] == there[0] and np.array_equal(here[1], there[1])


@pytest.mark.parametrize("serialised", [False, True])
def test_states_are_saved_in_the_process(serialised, c_fmu):
    instance = load_fmu(c_fmu, ISOLATED).instantiate("one")
    u, y = np.array([0.5]), np.zeros(1)
    instance.bind(["real_in"], u, ["real_out"], y)
    instance.enter_initialisation(0.0, {})
    instance.exit_initialisation()
    state = instance.save_state()
    data = instance.serialise_state(state)
    rows = []
    for _ in range(2):
        instance.write_inputs()
        instance.do_step(Point(0, 0.0, 0.125))
        instance.read_outputs()
        rows.append(float(y[0]))
        instance.restore_state(instance.deserialise_state(data) if serialised else state)
    assert rows == [0.0625, 0.0625]
    instance.read_outputs()
    assert y[0] == 0.0
    instance.free_state(state)
    instance.free()


def test_an_error_of_the_fmu_is_the_same_as_without_isolation(c_fmu):
    reported = []
    for run_options in (RunOptions(), ISOLATED):
        instance = load_fmu(c_fmu, run_options).instantiate("one")
        instance.bind(["real_in"], np.array([1.0]), ["real_out"], np.zeros(1))
        instance.enter_initialisation(0.0, {"limit": 0.2})
        instance.exit_initialisation()
        instance.write_inputs()
        with pytest.raises(StepError) as caught:
            for n in range(3):
                instance.do_step(Point(n, 0.125 * n, 0.125))
        reported.append((str(caught.value), caught.value.time, caught.value.status, caught.value.log))
        assert instance.do_step(Point(9, 9.0, 0.5)) is StepStatus.DISCARD
        assert instance.last_successful_time() == 9.0
        assert instance.log_lines()[-1] == "[discard] the step is too long"
        instance.free()
    assert reported[0] == reported[1]
    assert reported[0][0].splitlines()[0] == "one at time 0.125 s: fmi3DoStep returned error"


def test_an_fmu_that_cannot_be_made_is_reported_as_without_isolation(c_fmu, tmp_path):
    def other_token(name, data):
        return name, data.replace(b"{types-3}", b"{other-3}") if name.endswith(".xml") else data

    path = repack(c_fmu, tmp_path / "X.fmu", other_token)
    reported = []
    for run_options in (RunOptions(), ISOLATED):
        with pytest.raises(FmuError) as caught:
            load_fmu(path, run_options).instantiate("one")
        reported.append(str(caught.value))
    assert reported[0] == reported[1]
    assert "wrong instantiation token" in reported[0]


def test_files_in_the_working_directory_are_no_modules(wild, tmp_path, monkeypatch):
    (tmp_path / "pickle.py").write_text("raise SystemExit('imported by mistake')")
    monkeypatch.chdir(tmp_path)
    instance = load_fmu(wild, ISOLATED).instantiate("one")
    instance.free()


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="looks into /proc")
def test_a_process_that_hangs_ends_with_its_parent(wild, tmp_path):
    script = tmp_path / "parent.py"
    script.write_text(
        "import os, sys, threading, numpy as np\n"
        "from pathlib import Path\n"
        "from orchestrator.fmi import Point, RunOptions, load_fmu\n"
        "one = load_fmu(Path(sys.argv[1]), RunOptions(isolated=True)).instantiate('one')\n"
        "one.enter_initialisation(0.0, {'way': 2})\n"
        "one.exit_initialisation()\n"
        "threading.Thread(target=one.do_step, args=(Point(0, 0.0, 0.1),), daemon=True).start()\n"
        "print(one._process.pid, flush=True)\n"
        "os._exit(0)\n"
    )
    root = str(Path(__file__).parents[2])
    done = subprocess.run(
        [sys.executable, str(script), str(wild)],
        env={**os.environ, "PYTHONPATH": root},
        capture_output=True,
        text=True,
        check=True,
    )
    process = Path("/proc") / done.stdout.strip() / "stat"
    for _ in range(300):  # it looks every second
        if not process.exists() or process.read_text().rpartition(")")[2].split()[0] == "Z":
            return
        time.sleep(0.1)
    raise AssertionError("the process of the FMU outlives the program")


@posix
@pytest.mark.parametrize("flushed", [True, False])
def test_what_was_printed_outlives_a_run_that_is_killed(flushed, wild, tmp_path):
    if not flushed:  # of the FMU that keeps what it prints until its buffer is full

        def change(name, data):
            return name, data.replace(b"fflush\0", b"fileno\0") if name.endswith(".so") else data

        repack(wild, tmp_path / "Other.fmu", change)
        wild = tmp_path / "Other.fmu"
    path, out = tmp_path / "system.yaml", tmp_path / "out"
    path.write_text(json.dumps(config(wild, HANG)))
    command = [sys.executable, "-m", "orchestrator", "run", str(path), "--out", str(out), "--no-halving"]
    process = subprocess.Popen(command, cwd=Path(__file__).parents[2], stderr=subprocess.DEVNULL)
    printed = out / "log" / "bad.printed.log"
    for _ in range(600):
        if printed.is_file() and printed.read_text().count("a line on the standard output\n") == 5:
            break
        time.sleep(0.1)
    process.kill()
    process.wait()
    assert printed.read_text() == "a line on the standard output\n" * 5
    assert (
        main(["run", str(path), "--out", str(out), "--set", "bad.way=0", "--no-halving", "--no-figures"]) == 0
    )
    assert not printed.exists()
    assert (out / "log" / "bad.log").read_text().count("[printed] a line on the standard output") == 10


def test_a_time_limit_needs_a_process(wild):
    wrong = config(wild, 0, time_limit="2 s")
    del wrong["instances"]["bad"]["isolate"]
    with pytest.raises(ConfigError) as caught:
        prepare(wrong)
    assert str(caught.value) == (
        "config: instances.bad: time_limit needs isolate: process; only another process can be stopped"
    )


@pytest.mark.parametrize(("text", "why"), [("2", "'2' has no unit"), ("0 s", "'0 s' is not positive")])
def test_time_limits_are_times(wild, text, why):
    with pytest.raises(ConfigError, match=why):
        prepare(config(wild, 0, time_limit=text))


def test_isolation_is_an_override(wild):
    loaded = load_config(config(wild, 0), ["instances.good.isolate=process", "instances.good.time_limit=3 s"])
    good = loaded.model.instances["good"]
    assert (good.isolate, good.seconds()) == ("process", 3.0)


def test_an_interrupt_within_a_call_ends_the_process(wild, monkeypatch):
    instance = load_fmu(wild, ISOLATED).instantiate("one")
    instance.enter_initialisation(0.0, {"way": HANG})
    instance.exit_initialisation()

    def interrupted(descriptor):
        raise KeyboardInterrupt

    monkeypatch.setattr("orchestrator.fmi.messages.receive", interrupted)
    with pytest.raises(KeyboardInterrupt):
        instance.do_step(Point(0, 0.0, 0.1))
    monkeypatch.undo()
    instance.free()  # would wait for ever for a process that hangs
    assert instance._process.poll() is not None


def test_an_isolated_python_fmu_tells_what_it_logged(python_fmu):
    instance = load_fmu(python_fmu("misbehaving"), ISOLATED).instantiate("one")
    instance.enter_initialisation(0.0, {"way": "error", "at": 0.0})
    instance.exit_initialisation()
    with pytest.raises(StepError) as caught:
        instance.do_step(Point(0, 0.0, 0.1))
    assert caught.value.what == "fmi2DoStep returned fatal"
    assert any("the tank is empty" in line for line in caught.value.log)
    instance.free()
