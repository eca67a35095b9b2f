"""Tasks in copies of this process give what they give one after the other."""

import os
import sys
import time
from functools import partial

import numpy as np
import pytest

from orchestrator.base.parallel import in_parallel, in_time


def test_results_come_in_the_order_of_the_tasks():
    tasks = [partial(np.full, 3, float(k)) for k in range(7)]
    assert [one.tolist() for one in in_parallel(tasks)] == [[float(k)] * 3 for k in range(7)]
    assert in_parallel([]) == []


def test_the_first_error_is_raised():
    def fails(number):
        raise ValueError(f"task {number}")

    with pytest.raises(ValueError, match="task 1"):
        in_parallel([lambda: 0, partial(fails, 1), lambda: 2])


@pytest.mark.skipif(sys.platform != "linux", reason="tasks run in this process")
def test_a_copy_that_is_killed_is_an_error(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    with pytest.raises(RuntimeError, match="ended with code 7"):
        in_parallel([partial(os._exit, 7), partial(os._exit, 7)])


def test_one_core_runs_the_tasks_here(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0}, raising=False)
    seen = []
    assert in_parallel([lambda: seen.append(1), lambda: seen.append(2)]) == [None, None]
    assert seen == [1, 2]


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere a task takes what it needs")
def test_a_task_that_takes_too_long_gives_none():
    begin = time.perf_counter()
    assert in_time(partial(time.sleep, 600.0), 0.2) is None and time.perf_counter() - begin < 60.0
    assert in_time(lambda: 3, 60.0) == 3

    def fails():
        raise ValueError("within time")

    with pytest.raises(ValueError, match="within time"):
        in_time(fails, 60.0)
