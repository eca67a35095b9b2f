"""Sweeps: each point as a run by itself, runs once, failures as data, the same on a cluster."""

from __future__ import annotations

import os
import signal
import threading
import time

import foreign
import pytest
import workers_tasks
from campaign_bench import QUICK, quick

from orchestrator.base.errors import ConfigError, Interrupted
from orchestrator.campaign import Store, Study
from orchestrator.fmi import messages as frames
from orchestrator.fmi.workers import LocalPool, Work
from orchestrator.fmi.workers.child import Child, KilledError, _started
from orchestrator.simulation.run import run

CRASH, HANG = 1, 2


def test_each_point_equals_a_run_by_itself(tmp_path):
    study = quick(record="all")
    swept = study.run(tmp_path / "store", jobs=2)
    assert (swept.points, swept.made, swept.reused, sum(swept.failed.values())) == (12, 12, 0, 0)
    columns = swept.columns()
    assert columns["point"].tolist() == list(range(12))
    assert columns["robot.tau_m"].tolist() == pytest.approx([0.004] * 4 + [0.008] * 4 + [0.012] * 4)
    for point in (1, 10):
        changes = [f"{path}={value}" for path, value in QUICK.items()]
        changes += [f"robot.tau_m={float(columns['robot.tau_m'][point])!r} s"]
        changes += [f"contact.stiffness={float(columns['contact.stiffness'][point])!r} N/m"]
        made = run("docking-1d-uncompensated", overrides=changes)
        assert columns["peak"][point] == abs(made.results["contact.force"]).max()
        assert columns["last"][point] == made.results["satellite.velocity"][-1]
        assert columns["stiff"][point] == made.results.parameters["contact.stiffness"] / 1000
        with Store(tmp_path / "store") as store:
            key = columns["run"][point]
            reported = store.query(f"select name, value from numbers where run = '{key}'").to_pydict()
            numbers = dict(zip(reported["name"], reported["value"], strict=True))
            force = store.query(f"select time, \"contact.force\" as f from trajectories where run = '{key}'")
        cor = made.summary["contacts"][0]["cor"]
        assert numbers["contacts[0].cor"] == cor
        assert numbers["numerics.contacts[0].cor"] == made.summary["numerics"]["contacts"][0]["cor"]
        assert sorted(force.column("time").to_pylist()) == made.results.time.tolist()
        assert force.column("f").to_pylist() == made.results["contact.force"].tolist()


def test_the_change_at_half_the_step_goes_with_every_quantity(tmp_path):
    columns = quick().run(tmp_path / "store", jobs=1).columns()
    half = quick(set=QUICK | {"run.step_size": "4 ms"}, step_halving=False)
    finer = half.run(tmp_path / "store", jobs=1).columns()
    assert columns["peak.change"] == pytest.approx(finer["peak"] - columns["peak"], abs=1e-9)
    assert "peak.change" not in finer
    assert (columns["stiff.change"] == 0.0).all()


def test_a_sweep_that_is_started_again_makes_nothing_twice(tmp_path):
    first = quick().run(tmp_path / "store", jobs=2)
    again = quick().run(tmp_path / "store", jobs=2)
    assert (again.made, again.reused) == (0, 12)
    assert again.table.equals(first.table)
    # What another study has run is found by its content, however it is written.
    other = quick(
        design={"list": [{"robot.tau_m": "0.004 s", "contact.stiffness": "1e5 N/m"}, {"robot.tau_m": "8 ms"}]}
    )
    found = other.run(tmp_path / "store", jobs=2)
    assert (found.made, found.reused) == (0, 2)
    assert found.columns()["peak"][0] == first.columns()["peak"][0]
    changed = quick(derived={"peak": "min(contact.force)"}).run(tmp_path / "store", jobs=2)
    assert changed.made == 12


def test_equal_points_are_run_once(tmp_path):
    study = quick(design={"grid": {"robot.tau_m": ["8 ms", "0.008 s", "4 ms"]}})
    swept = study.run(tmp_path / "store", jobs=1)
    assert (swept.points, swept.made) == (3, 2)
    assert swept.columns()["peak"][0] == swept.columns()["peak"][1]


def test_values_that_are_no_start_values_and_fmus_can_be_varied(tmp_path):
    design = {
        "grid": {
            "run.step_size": ["8 ms", "4 ms"],
            "run.master": ["gauss-seidel", "jacobi"],
            "satellite.form": ["python", "native"],
        }
    }
    rest = {path: value for path, value in QUICK.items() if path not in ("satellite.form",)}
    columns = quick(set=rest, design=design).run(tmp_path / "store", jobs=1).columns()
    peaks = columns["peak"].reshape(2, 2, 2)
    assert (peaks[..., 0] == peaks[..., 1]).all()  # both forms compute the same
    assert len(set(peaks[..., 0].ravel())) == 4
    assert columns["run.step_size"].tolist() == [0.008] * 4 + [0.004] * 4
    assert columns["satellite.form"].tolist() == ["python", "native"] * 4


def test_repeats_have_seeds_of_their_own_and_the_same_ones_each_time(tmp_path):
    system = run("docking-1d-uncompensated", halving=False, overrides=["run.stop_time=1 ms"]).summary[
        "config"
    ]
    system["connections"][0] = {
        "from": "satellite.position",
        "to": "robot.command",
        "through": [{"noise": "10 um", "period": "8 ms", "seed": 1}],
    }
    values = {
        "system": system,
        "design": {"grid": {"robot.tau_m": ["4 ms", "8 ms"]}},
        "repeats": {"count": 3, "seed": 5, "into": ["connections[0].through[0].seed"]},
    }
    study = quick(**values)
    columns = study.run(tmp_path / "store", jobs=1).columns()
    assert columns["repeat"].tolist() == [0, 1, 2] * 2
    assert len(set(columns["peak"])) == 6
    seeds = columns["connections[0].through[0].seed"].tolist()
    assert seeds[:3] == seeds[3:] and len(set(seeds)) == 3
    assert quick(**values).run(tmp_path / "store", jobs=1).made == 0


@pytest.fixture
def wild(tmp_path):
    return foreign.wild(tmp_path / "Wild.fmu")


def unruly(wild, **changes):
    return Study(
        {
            "system": {
                "run": {"master": "jacobi", "step_size": "0.1 s", "stop_time": "1 s"},
                "instances": {"one": {"fmu": str(wild), "start": {"u": 2, "at": 0.5}}},
            },
            "design": {"grid": {"one.way": [0, CRASH, HANG, 4], "one.u": [1, 2]}},
            "derived": {"end": "final(one.y)"},
            "time_limit": "2 s",
        }
        | changes
    )


@pytest.mark.skipif(os.name != "posix", reason="signals are reported by name on POSIX only")
def test_a_crash_or_a_hang_is_kept_with_its_reason_and_the_others_go_on(wild, tmp_path):
    swept = unruly(wild).run(tmp_path / "store", jobs=2)
    assert swept.made == 8
    assert dict(swept.failed) == {"crash": 4, "time limit": 2}
    columns = swept.columns()
    assert columns["status"].tolist() == ["done"] * 2 + ["failed"] * 6
    assert columns["kind"].tolist() == [
        "",
        "",
        "crash",
        "crash",
        "time limit",
        "time limit",
        "crash",
        "crash",
    ]
    assert columns["message"][2] == "its process died of SIGSEGV"
    assert columns["message"][4] == "took longer than 2 s, and was ended"
    assert columns["message"][6] == "its process ended with status 3"
    assert columns["end"][:2] == pytest.approx([1.0, 2.0])
    with Store(tmp_path / "store") as store:
        lines = store.query("select line from logs").column(0).to_pylist()
    assert "about to write to nowhere" in lines
    # Failures are results: they are not made again unless that is asked for.
    assert unruly(wild).run(tmp_path / "store", jobs=2).made == 0
    assert unruly(wild).run(tmp_path / "store", jobs=2, retry_failed=True).made == 6
    with Store(tmp_path / "store") as store:
        assert store.query("select count(*) as n from runs").column("n").to_pylist() == [8]


def test_failures_are_tried_again_as_the_study_says(wild, tmp_path):
    study = unruly(
        wild,
        design={"list": [{"one.way": CRASH}, {"one.way": 0}]},
        retry={"attempts": 3, "on": ["crash"]},
    )
    study.run(tmp_path / "store", jobs=1)
    with Store(tmp_path / "store") as store:
        found = store.query("select attempts from sweep order by point").column(0).to_pylist()
    assert found == [3, 1]


def test_a_run_that_diverges_is_kept_with_its_reason(tmp_path):
    system = {
        "run": {"master": "gauss-seidel", "step_size": "10 ms", "stop_time": "20 s"},
        "instances": {
            "satellite": {
                "fmu": "SatelliteDynamics",
                "form": "native",
                "start": {"mass": "1 kg", "position": "1 m", "velocity": "0 m/s"},
            }
        },
        "connections": [
            {"from": "satellite.position", "to": "satellite.force", "through": [{"gain": "1e6 N/m"}]}
        ],
    }
    study = Study(system=system, design={"grid": {"satellite.mass": ["1 kg", "1e12 kg"]}})
    columns = study.run(tmp_path / "store", jobs=1).columns()
    assert columns["status"].tolist() == ["failed", "done"]
    assert columns["kind"][0] == "diverged"
    assert "satellite" in columns["message"][0]


def test_a_worker_that_is_killed_while_it_begins_is_started_again():
    begun = []

    def make():
        begun.append(1)
        if len(begun) < 3:
            raise KilledError("a worker could not begin")
        return "a process"

    assert _started(make) == "a process" and len(begun) == 3


class _Late(threading.Timer):
    """A time limit that is over at the moment the answer has been read."""

    def start(self):
        pass

    def cancel(self):
        self.function(*self.args, **self.kwargs)


@pytest.fixture
def child():
    made = Child(Work(workers_tasks.do, None, "payload", time_limit=1e6), None)
    yield made
    made.end()


def test_a_time_limit_that_is_over_as_the_answer_comes_ends_nothing(child, monkeypatch):
    monkeypatch.setattr(threading, "Timer", _Late)
    for task in ("one", "two"):
        assert child.do(task).value[1] == task
        assert child.alive
    assert child.do("leave").failure.kind == "crash"


def test_a_process_that_a_time_limit_ends_after_its_answer_takes_no_more_tasks(child, monkeypatch):
    receive = frames.receive

    def expired(file):
        answer = receive(file)
        child._expire(child._limited)
        return answer

    with monkeypatch.context() as patch:
        patch.setattr(frames, "receive", expired)
        made = child.do("one")
    assert made.failure is None and made.value[1] == "one"
    assert not child.alive


@pytest.mark.skipif(os.name != "posix", reason="kills by signal")
def test_a_worker_that_is_killed_costs_nothing_but_time(tmp_path):
    study = quick(design={"grid": {"robot.tau_m": {"from": "4 ms", "to": "12 ms", "count": 60}}})
    expected = study.run(tmp_path / "undisturbed", jobs=2).table
    psutil = pytest.importorskip("psutil")

    def children():
        return [one.pid for one in psutil.Process().children() if "workers.serve" in " ".join(one.cmdline())]

    killed = []

    def kill(done, of, failed):
        if done in (5, 15, 25):
            killed.append(children()[0])
            os.kill(killed[-1], signal.SIGKILL)

    swept = study.run(tmp_path / "store", jobs=2, progress=kill)
    assert len(set(killed)) == 3
    assert swept.table.equals(expected)


def test_an_interrupt_keeps_what_was_made_and_the_sweep_goes_on_from_there(tmp_path):
    study = quick()
    expected = study.run(tmp_path / "undisturbed", jobs=2).table

    def interrupt(done, of, failed):
        if done == 5:
            raise KeyboardInterrupt

    with pytest.raises(Interrupted, match="5 runs of this sweep are kept"):
        study.run(tmp_path / "store", jobs=2, progress=interrupt)
    swept = study.run(tmp_path / "store", jobs=2)
    assert (swept.made, swept.reused) == (7, 5)
    assert swept.table.equals(expected)


def test_a_store_takes_one_sweep_at_a_time(tmp_path):
    def second(done, of, failed):
        with pytest.raises(ConfigError, match="is writing to this folder"):
            quick().run(tmp_path / "store", pool=LocalPool(1))

    quick(design={"grid": {"robot.tau_m": ["4 ms"]}}).run(tmp_path / "store", jobs=1, progress=second)


def test_no_threads_or_processes_are_left(tmp_path):
    quick().run(tmp_path / "store", jobs=2)
    time.sleep(0.1)
    assert not [one for one in threading.enumerate() if one.name.startswith("worker-")]
