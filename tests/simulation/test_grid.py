"""The communication grid."""

from __future__ import annotations

import signal
from fractions import Fraction

import pytest
from assembled import assemble
from doubles import FakeInstance, mass
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.base.errors import ConfigError
from orchestrator.config import RunModel
from orchestrator.master import create_master
from orchestrator.results.recorders import Recorder
from orchestrator.simulation.grid import Grid
from orchestrator.simulation.loop import simulate
from orchestrator.system.assembly import Part


def grid(step: str, stop: str, start: str = "0 s") -> Grid:
    return Grid.of(RunModel(master="jacobi", step_size=step, stop_time=stop, start_time=start), "x: run")


def refusal(*arguments: str) -> str:
    with pytest.raises(ConfigError) as caught:
        grid(*arguments)
    return str(caught.value)


def test_counts_are_exact():
    assert grid("0.2 ms", "0.3 s").steps == 1500  # int(0.3 / 2e-4) is 1499
    assert len(grid("0.1 ms", "4 s")) == 40001
    assert grid("1 us", "1 min").steps == 60_000_000


@given(st.integers(1, 10**6), st.integers(1, 10**6), st.integers(-(10**6), 10**6))
def test_times_are_rounded_once_and_shared_instants_are_equal(numerator, denominator, begin):
    one = Grid(Fraction(begin, 1000), Fraction(numerator, denominator), 5)
    times = [point.time for point in one]
    assert times == [float(one.start + index * one.step_size) for index in range(6)]
    assert [point.time for point in one.halved()][::2] == times
    assert times[-1] == float(one.stop)


def test_points_tell_index_step_and_the_last():
    points = list(grid("0.1 s", "1.3 s", "1 s"))
    assert [(p.index, p.time, p.step_size, p.last) for p in points] == [
        (0, 1.0, 0.1, False),
        (1, 1.1, 0.1, False),
        (2, 1.2, 0.1, False),
        (3, 1.3, 0.1, True),
    ]


def test_a_run_that_is_no_whole_number_of_steps():
    assert refusal("0.3 ms", "1 ms") == (
        "x: run: stop_time 1 ms is 3.33333 steps of 0.3 ms away\n"
        "  a whole number of steps after start_time is needed. Nearest stop times: 0.0009 s, 0.0012 s."
    )
    assert refusal("3 s", "1 s").endswith("Nearest stop times: 3.0 s.")


def test_times_that_make_no_run():
    assert refusal("0 s", "1 s") == "x: run: step_size 0 s is not positive"
    assert refusal("-1 ms", "1 s") == "x: run: step_size -1 ms is not positive"
    assert refusal("1 ms", "1 s", "1 s") == "x: run: stop_time 1 s is not after start_time 1 s"


def test_an_interrupt_takes_effect_between_steps_and_later_ones_are_pythons_own():
    def step(values, time, h):
        if 0.45 < time < 0.55:
            signal.raise_signal(signal.SIGINT)
        values["velocity"] += h

    system = assemble([Part("mass", mass(step=step), {"force": "0 N"})])
    recorder = Recorder(system)
    with pytest.raises(KeyboardInterrupt):
        simulate(system, create_master("jacobi"), grid("0.1 s", "1 s"), [recorder])
    results = recorder.results()
    assert results.time[-1] == 0.6 and results["mass.velocity"][-1] == pytest.approx(0.6)
    assert system.instances[0].fmu.alive == []
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_an_fmu_that_hangs_is_left_at_the_second_interrupt():
    def step(values, time, h):
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)
        raise AssertionError("still here")

    system = assemble([Part("mass", mass(step=step), {"force": "0 N"})])
    with pytest.raises(KeyboardInterrupt):
        simulate(system, create_master("jacobi"), grid("0.1 s", "1 s"))


def test_an_interrupt_after_the_last_step_is_not_lost(monkeypatch):
    """Of several runs the next is not to begin."""
    free = FakeInstance.free

    def interrupted(self):
        signal.raise_signal(signal.SIGINT)
        free(self)

    monkeypatch.setattr(FakeInstance, "free", interrupted)
    system = assemble([Part("mass", mass(), {"force": "0 N"})])
    recorder = Recorder(system)
    with pytest.raises(KeyboardInterrupt):
        simulate(system, create_master("jacobi"), grid("0.1 s", "1 s"), [recorder])
    assert recorder.results().time[-1] == 1.0 and system.instances[0].fmu.alive == []
