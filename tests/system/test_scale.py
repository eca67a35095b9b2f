"""1,000 instances with 10,000 connections: every FMU is read once, and the work grows as the system does."""

from __future__ import annotations

import sys
import zipfile

import numpy as np
import pytest
from benchmarks.scale import PORTS, large_config
from benchmarks.systems import STEP_SIZE, Case, build, ring

from orchestrator.base.errors import ConfigError
from orchestrator.fmi import archive
from orchestrator.fmi import loading as compiled
from orchestrator.results.column_stream import StreamedColumns
from orchestrator.results.measures import signal_changes
from orchestrator.results.recorders import Results
from orchestrator.simulation.run import prepare, run

STEPS = 10


@pytest.fixture(scope="module")
def fmu(tmp_path_factory):
    return build(Case("", 2, PORTS, True, ring(2, PORTS)), tmp_path_factory.mktemp("ring")).fmu


def test_a_thousand_instances_with_ten_thousand_connections_run(fmu, monkeypatch):
    counts = {"read": 0, "extracted": 0}
    read, extract = compiled.read_description, zipfile.ZipFile.extract

    def counted_read(*arguments):
        counts["read"] += 1
        return read(*arguments)

    def counted_extract(self, *arguments):
        counts["extracted"] += 1
        return extract(self, *arguments)

    monkeypatch.setattr(compiled, "read_description", counted_read)
    monkeypatch.setattr(archive.zipfile.ZipFile, "extract", counted_extract)
    compiled._load.cache_clear()
    prepared = prepare(large_config(1000, fmu, STEPS))
    assert len(prepared.system.instances) == 1000 and len(prepared.system.connections) == 10_000
    made = run(prepared, halving=False)
    assert counts == {"read": 1, "extracted": 2}  # the description and the library
    reported = made.summary["run"]
    assert list(reported["instance_time"]) == [f"s{index}" for index in range(1000)]
    assert min(reported["instance_time"].values()) > 0.0
    # Loading and initialising a thousand instances is no part of the loop.
    assert sum(reported["instance_time"].values()) < reported["stepping_time"] < reported["wall_time"]
    assert reported["real_time_factor"] == pytest.approx(STEPS * STEP_SIZE / reported["stepping_time"])
    # All instances begin alike, hence stay alike: first-order lags that are fed by one another.
    y = 1.0 + np.arange(PORTS)
    for _ in range(STEPS):
        y = y + (np.roll(y, -1) - y) * STEP_SIZE / 0.1
    for index in (0, 1, 499, 999):
        found = [made.results[f"s{index}.y{port}"][-1] for port in range(PORTS)]
        assert found == pytest.approx(y, rel=1e-12)


def calls(function):
    """How many functions are called."""
    count = 0

    def seen(frame, event, argument):
        nonlocal count
        count += event in ("call", "c_call")

    before = sys.getprofile()
    sys.setprofile(seen)
    try:
        function()
    finally:
        sys.setprofile(before)
    return count


@pytest.mark.parametrize("what", ["check", "run"])
def test_the_work_grows_in_proportion(what, fmu):
    found = []
    for size in (30, 300):
        config = large_config(size, fmu, 2, loop="python")
        prepared = prepare(config)
        found.append(calls(lambda: prepare(config) if what == "check" else run(prepared, halving=False)))  # noqa: B023
    assert found[1] < 11 * found[0]


def test_results_are_gone_through_equally_often_at_any_width(fmu, monkeypatch, tmp_path):
    """A pass costs in proportion to the width: one for each signal would cost its square."""
    reader = StreamedColumns._reader
    found = []
    for size in (20, 200):
        passes = []

        def counted(self, numbers, passes=passes):
            passes.append(numbers)
            return reader(self, numbers)

        monkeypatch.setattr(StreamedColumns, "_reader", counted)
        made = run(large_config(size, fmu, STEPS), out=tmp_path / str(size))
        assert len(made.results.signals) == size * PORTS
        found.append(len(passes))
    assert 0 < found[0] == found[1] < 20


def test_the_comparison_with_half_the_step_grows_in_proportion():
    found = []
    for width in (1000, 10_000):
        columns = {f"s{n}": np.zeros(300) for n in range(width)}
        once = Results(np.arange(300.0), columns)
        halved = Results(np.arange(600.0), {name: np.ones(600) for name in columns})
        found.append(calls(lambda: signal_changes(once, halved)))  # noqa: B023
    assert found[1] < 11 * found[0]


def test_a_mistake_in_a_large_system_is_reported_alone(fmu):
    config = large_config(300, fmu, 2)
    config["connections"][1234] = config["connections"][1234].replace(".y", ".v")
    with pytest.raises(ConfigError) as caught:
        prepare(config)
    assert len(caught.value.problems) == 1
    assert "connections[1234]" in str(caught.value)
