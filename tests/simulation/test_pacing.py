"""Steps at the pace of a clock, which the tests turn by hand."""

from __future__ import annotations

import gc

import numpy as np
import pytest

from orchestrator.base.errors import ConfigError, OrchestratorError
from orchestrator.base.histogram import Histogram
from orchestrator.config import RealtimeModel
from orchestrator.simulation import pacing
from orchestrator.simulation.pacing import Pace
from orchestrator.simulation.run import run


class Clock:
    """A clock that only sleeping and working move [ns]."""

    now = 1_000_000_000

    def read(self) -> int:
        self.now += 1_000  # looking at it takes a microsecond
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += round(seconds * 1e9)

    def work(self, seconds: float) -> None:
        self.now += round(seconds * 1e9)


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(pacing, "perf_counter_ns", clock.read)
    monkeypatch.setattr(pacing, "sleep", clock.sleep)
    return clock


def paced(clock: Clock, busy: list[float], **options) -> tuple[Pace, list[float]]:
    """Steps of 1 ms that take so long. Returns: the pace and when each step began, after the first [s]."""
    pace, begun = Pace(RealtimeModel(**options), 0.0), []
    first = None
    for index, seconds in enumerate([*busy, 0.0]):
        pace.wait(1e-3 * index, lambda: False)
        first = clock.now if first is None else first
        begun.append((clock.now - first) * 1e-9)
        clock.work(seconds)
    return pace, begun


def test_steps_begin_at_their_deadlines(clock):
    pace, begun = paced(clock, [2e-4] * 10)
    assert begun == pytest.approx(1e-3 * np.arange(11), abs=5e-6)
    reported = pace.summary()
    assert (reported["steps"], reported["missed"]) == (10, 0)
    assert reported["busy"]["median"] == pytest.approx(2e-4, rel=0.05)
    assert reported["latency"]["max"] < 5e-6


def test_speed_scales_the_deadlines(clock):
    _, begun = paced(clock, [1e-5] * 4, speed=4)
    assert begun == pytest.approx(0.25e-3 * np.arange(5), abs=5e-6)


def test_a_missed_deadline_is_caught_up_with(clock):
    pace, begun = paced(clock, [1e-4, 2.5e-3, 1e-4, 1e-4, 1e-4, 1e-4])
    assert begun[2] == pytest.approx(3.5e-3, abs=2e-5)
    assert begun[4:] == pytest.approx([4e-3, 5e-3, 6e-3], abs=5e-6)
    reported = pace.summary()
    assert (reported["missed"], reported["longest_row_of_misses"]) == (2, 2)
    assert reported["worst_miss"] == pytest.approx(1.5e-3, abs=2e-5)
    assert reported["shifted"] == 0.0


def test_a_missed_deadline_moves_the_later_ones(clock):
    pace, begun = paced(clock, [1e-4, 2.5e-3, 1e-4, 1e-4], on_miss="shift")
    assert np.diff(begun)[2:] == pytest.approx([1e-3, 1e-3], abs=1e-5)
    assert pace.summary()["missed"] == 1
    assert pace.summary()["shifted"] == pytest.approx(1.5e-3, abs=2e-5)


def test_missed_deadlines_in_a_row_end_the_run(clock):
    with pytest.raises(OrchestratorError, match=r"2 deadlines in a row were missed.*\n?.*allows 1"):
        paced(clock, [2e-3] * 5, on_miss="stop", misses=2)
    paced(clock, [1.5e-3, 1e-4, 1.5e-3, 1e-4], on_miss="stop", misses=2)


def test_an_interrupt_ends_the_wait(clock):
    pace = Pace(RealtimeModel(), 0.0)
    pace.wait(0.0, lambda: False)
    before = clock.now
    pace.wait(10.0, lambda: clock.now > before + 200_000_000)
    assert clock.now - before < 400_000_000


def test_garbage_is_collected_again_afterwards():
    pace = Pace(RealtimeModel(), 0.0)
    with pytest.raises(KeyError), pace.quiet():
        assert not gc.isenabled()
        raise KeyError
    assert gc.isenabled()


def test_a_refused_priority_is_reported(monkeypatch):
    def refuse(*arguments):
        raise PermissionError("not permitted")

    monkeypatch.setattr("os.sched_setscheduler", refuse, raising=False)
    monkeypatch.setattr("os.sched_getscheduler", lambda pid: 0, raising=False)
    monkeypatch.setattr("os.sched_getparam", lambda pid: None, raising=False)
    monkeypatch.setattr("os.sched_param", lambda priority: priority, raising=False)
    monkeypatch.setattr("os.SCHED_FIFO", 1, raising=False)
    pace = Pace(RealtimeModel(priority=50), 0.0)
    with pace.quiet():
        pass
    assert "SCHED_FIFO 50 was refused (not permitted)" in pace.summary()["scheduler"]


def test_quantiles_of_the_histogram():
    histogram = Histogram()
    for value in range(1, 10_001):
        histogram.add(value * 1_000)
    reported = histogram.summary()
    assert reported["count"] == 10_000
    assert reported["median"] == pytest.approx(5e-3, rel=0.024)
    assert reported["p99"] == pytest.approx(9.9e-3, rel=0.024)
    assert reported["max"] == pytest.approx(1e-2)
    classes = histogram.classes()
    assert sum(classes["counts"]) == 10_000
    assert len(classes["edges"]) == len(classes["counts"]) + 1
    assert classes["edges"][0] <= 1.001e-6 and classes["edges"][-1] >= 1e-2
    assert Histogram().summary()["median"] == 0.0


@pytest.mark.parametrize("loop", ["python", "native"])
def test_pacing_changes_no_result(loop, tmp_path):
    changes = [f"run.loop={loop}", "run.stop_time=0.1 s"]
    plain = run("docking-1d-uncompensated", overrides=changes, halving=False)
    made = run(
        "docking-1d-uncompensated", overrides=[*changes, "run.realtime.speed=20"], halving=False, out=tmp_path
    )
    assert made.summary["run"]["loop"] == loop
    for name in plain.results.signals:
        assert np.array_equal(plain.results[name], made.results[name]), name
    reported = made.summary["run"]["realtime"]
    assert reported["steps"] == made.summary["run"]["steps"]
    # The clock is never ahead of the simulation: a run takes at least its time.
    assert made.summary["run"]["stepping_time"] >= 0.1 / 20
    assert "realtime.png" in made.files


def test_all_that_is_wrong_with_the_options_is_reported_at_once():
    with pytest.raises(ConfigError) as error:
        run("docking-1d-uncompensated", overrides=["run.realtime.speed=0", "run.realtime.on_miss=panic"])
    text = str(error.value)
    assert "run.realtime.speed=0" in text and "greater than 0" in text
    assert "'catch-up', 'shift' or 'stop'" in text
