"""The same study on a Dask cluster, and workers by themselves."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import workers_tasks
from campaign_bench import quick, through

from orchestrator.base.digests import digest_of
from orchestrator.base.errors import ConfigError, OrchestratorError
from orchestrator.campaign import Store
from orchestrator.fmi.workers import LocalPool, Retry, Work, pool_of
from orchestrator.fmi.workers.files import place_of, put_file

posix = pytest.mark.skipif(os.name != "posix", reason="signals are reported by name on POSIX only")


@pytest.fixture(scope="module")
def cluster():
    distributed = pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as made:
        yield made


def outcomes(pool, tasks, **options):
    work = Work(workers_tasks.do, payload=7, **options)
    return {one.task: one for one in pool.outcomes(work, tasks)}


@posix
@pytest.mark.parametrize("where", ["here", "cluster"])
def test_a_crash_or_a_hang_costs_one_task(where, request):
    pool = LocalPool(2) if where == "here" else pool_of(request.getfixturevalue("cluster"))
    tasks = [1, "abort", 2, "sleep", "raise", 3, "leave"]
    found = outcomes(pool, tasks, time_limit=1.0, retry=Retry(2))
    assert {task: one.value for task, one in found.items() if one.failure is None} == {
        n: (7, n) for n in (1, 2, 3)
    }
    failures = {
        task: (one.failure.kind, one.failure.message, one.attempts)
        for task, one in found.items()
        if one.failure
    }
    assert failures == {
        "abort": ("crash", "its process died of SIGABRT", 2),
        "sleep": ("time limit", "took longer than 1 s, and was ended", 2),
        "raise": ("error", "ValueError: raised (workers_tasks.py:23)", 1),
        "leave": ("crash", "its process ended with status 3", 2),
    }
    assert found["abort"].failure.log[-1] == "about to abort"


def test_an_outside_kill_is_no_fault_of_the_task():
    found = outcomes(LocalPool(1), ["killed", 1])
    assert found["killed"].failure.kind == "killed"
    assert found["killed"].attempts == 4
    assert found[1].value == (7, 1)


def test_tasks_are_taken_as_they_can_be_worked_on():
    taken = []

    def tasks():
        for n in range(1000):
            taken.append(n)
            yield n

    stream = LocalPool(2).outcomes(Work(workers_tasks.do), tasks())
    for _ in range(5):
        next(stream)
    time.sleep(0.3)
    assert len(taken) < 50
    stream.close()


def test_a_worker_that_cannot_begin_is_reported():
    with pytest.raises(OrchestratorError, match="a worker could not begin: RuntimeError: no such thing"):
        list(LocalPool(2).outcomes(Work(workers_tasks.do, workers_tasks.fail), [1, 2]))


def test_nothing_that_workers_unpack_is_left_behind(tmp_path, monkeypatch):
    for name in ("TMPDIR", "TEMP", "TMP"):
        monkeypatch.setenv(name, str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    work = Work(workers_tasks.do, time_limit=20.0)
    found = list(LocalPool(2).outcomes(work, [1, "abort", "leave", "raise", "killed", 2]))
    assert sum(one.failure is None for one in found) == 2
    # The folder of this process itself stays until it ends, with nothing but its lock.
    assert [path.name for path in tmp_path.rglob("*") if path.is_file()] == [".running"]
    assert len(list(tmp_path.rglob("*"))) == 2


def test_files_are_checked_where_they_arrive(tmp_path):
    place = place_of(b"data", "x.fmu")
    path = put_file(tmp_path, place, b"data")
    assert path == tmp_path / digest_of(b"data") / "x.fmu"
    before = path.stat().st_mtime_ns
    assert put_file(tmp_path, place, b"data").stat().st_mtime_ns == before
    path.write_bytes(b"dat")  # cut off by a full disk, say
    assert put_file(tmp_path, place, b"data").read_bytes() == b"data"
    with pytest.raises(OrchestratorError, match="arrived damaged"):
        put_file(tmp_path, place, b"date")


def test_a_cluster_gives_the_same_table_to_the_bit(cluster, tmp_path, monkeypatch):
    study = quick(record="all")
    here = study.run(tmp_path / "here", jobs=2)
    there = study.run(tmp_path / "there", scheduler=cluster.scheduler_address)
    assert there.made == 12
    assert there.table.equals(here.table)
    orders = {"numbers": "run, name", "trajectories": "run, time"}
    with Store(tmp_path / "here") as one, Store(tmp_path / "there") as other:
        for view, order in orders.items():
            sql = f"select * exclude (session) from {view} order by {order}"
            assert one.query(sql).equals(other.query(sql))


@posix
def test_a_worker_of_the_cluster_that_is_killed_costs_nothing_but_time(cluster, tmp_path):
    study = quick(design={"grid": {"robot.tau_m": {"from": "4 ms", "to": "12 ms", "count": 40}}})
    expected = study.run(tmp_path / "undisturbed", jobs=2).table

    def kill(done, of, failed):
        if done == 10:
            os.kill(next(iter(cluster.workers.values())).pid, signal.SIGKILL)

    swept = study.run(tmp_path / "store", scheduler=cluster, progress=kill)
    assert swept.table.equals(expected)


def test_a_scheduler_that_does_not_answer_is_refused():
    pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
    with pytest.raises(ConfigError, match="no Dask scheduler answers at tcp:"):
        pool_of("tcp://127.0.0.1:9")


_LAW = '''
from typing import ClassVar
from orchestrator.effects import Effect

class Scaled(Effect):
    """Part of the force."""
    jittable: ClassVar[bool] = True

    @staticmethod
    def kernel(time, x, options, memory, commit):
        return {factor} * x[0]
'''


def test_effects_from_files_that_a_design_varies_travel_to_workers_elsewhere(tmp_path):
    """The worker has a working directory and a cache of its own, and the files are gone when it begins."""
    distributed = pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
    # Files of one name, which their content distinguishes; the folder's name needs quotes in a config.
    here, there = tmp_path / "study #1", tmp_path / "there"
    names = []
    for factor in (0.5, 0.7, 0.9):
        folder = here / str(factor)
        folder.mkdir(parents=True)
        (folder / "gain.py").write_text(_LAW.format(factor=factor))
        names.append(f"{folder / 'gain.py'}:Scaled")

    def study():
        system, path = through(names[0])
        return quick(system=system, design={"grid": {path: names}}, step_halving=False)

    expected = study().run(tmp_path / "local", jobs=1)
    assert expected.made == 3 and not expected.failed
    assert len(set(expected.columns()["peak"])) == 3
    there.mkdir()
    loaded = study()
    others = [text for task in loaded.tasks() for _, text in task.others]
    assert len(set(others)) == 3 and all(text.startswith("files:") for text in others)
    assert loaded.id and sum(place.endswith("/gain.py") for place in loaded.files) == 3
    shutil.rmtree(here)
    environment = os.environ | {
        "XDG_CACHE_HOME": str(there / "cache"),
        "PYTHONPATH": os.pathsep.join(sys.path),
    }
    command = [sys.executable, "-m", "distributed.cli.dask_worker", "--nthreads", "1", "--no-dashboard"]
    with distributed.LocalCluster(n_workers=0, dashboard_address=None) as made:
        command += ["--local-directory", str(there), made.scheduler_address]
        worker = subprocess.Popen(command, cwd=there, env=environment, stderr=subprocess.DEVNULL)
        try:
            swept = loaded.run(tmp_path / "remote", scheduler=made.scheduler_address)
        finally:
            worker.terminate()
            worker.wait(30)
    assert swept.made == 3 and not swept.failed, swept.examples
    assert swept.table.equals(expected.table)
    sent = sorted(Path(there, "cache").rglob("gain.py"))
    assert sorted(digest_of(file.read_bytes()) for file in sent) == sorted(file.parent.name for file in sent)
    assert len(sent) == 3
