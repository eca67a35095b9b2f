"""Instances that runs take turns with are as new for each of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orchestrator.base.errors import StepError
from orchestrator.master.running_instances import instantiate
from orchestrator.simulation.loop import simulate
from orchestrator.simulation.run import prepare
from orchestrator.system.instance_pool import InstancePool, resets_well


@pytest.fixture(scope="module")
def drive():
    return prepare("emps", ["run.stop_time=0.5 s", "run.step_size=2 ms", "run.record=all"])


def signals(made, pool, loop="auto", start=None):
    """All signals of a run, with other start values of the drive."""
    seen = []

    def observe(point, values):
        seen.append(np.array(values.values))

    parts = [
        replace(one, start={**one.start, **(start or {})}) if one.name == "drive" else one
        for one in made.system.instances
    ]
    system = replace(made.system, instances=tuple(parts))
    simulate(system, made.master, made.grid, (observe,), loop=loop, pool=pool)
    return np.array(seen)


@pytest.mark.parametrize("loop", ["python", "native"])
def test_a_run_is_the_same_on_instances_of_an_earlier_one(drive, loop):
    """Start values of one run are none of the next, nor is where it ended."""
    fresh = signals(drive, None, loop)
    heavy = signals(drive, None, loop, {"mass": 200.0})
    pool = InstancePool()
    try:
        assert np.abs(fresh - heavy).max() > 1e-3
        for start, reported in (({"mass": 200.0}, heavy), ({}, fresh), ({"mass": 200.0}, heavy)):
            assert np.array_equal(signals(drive, pool, loop, start), reported)
    finally:
        pool.close()


def test_instances_are_loaded_once_and_freed_in_the_end(drive, monkeypatch):
    made, freed = [], []
    kind = type(drive.system.instances[0].fmu)
    instance = kind.instantiate
    monkeypatch.setattr(kind, "instantiate", lambda fmu, name: made.append(instance(fmu, name)) or made[-1])
    pool = InstancePool()
    for _ in range(3):
        signals(drive, pool)
    assert len(made) == len(drive.system.instances)
    for one in made:
        monkeypatch.setattr(one, "free", lambda one=one, free=one.free: freed.append(one) or free())
    # Two at once share none.
    with instantiate(drive.system, pool=pool) as first, instantiate(drive.system, pool=pool) as second:
        assert not set(map(id, first.running)) & set(map(id, second.running))
    assert not freed
    pool.close()
    assert set(map(id, made)) >= set(map(id, freed)) and len(freed) >= len(drive.system.instances)


def test_instances_of_other_tools_are_loaded_for_each_run(drive, monkeypatch):
    """What their reset leaves behind is unknown."""
    made, freed = [], []
    kind = type(drive.system.instances[0].fmu)
    instance = kind.instantiate
    monkeypatch.setattr(kind, "instantiate", lambda fmu, name: made.append(instance(fmu, name)) or made[-1])
    for one in {id(each.fmu): each.fmu for each in drive.system.instances}.values():
        assert resets_well(one)
        monkeypatch.setattr(one, "description", replace(one.description, tool="another"))
        assert not resets_well(one)
    pool = InstancePool()
    fresh = signals(drive, pool)
    assert np.array_equal(signals(drive, pool), fresh) and len(made) == 2 * len(drive.system.instances)
    for one in made:
        monkeypatch.setattr(one, "free", lambda one=one, free=one.free: freed.append(one) or free())
    pool.close()
    assert not freed  # the runs did it


def test_what_a_failed_run_held_is_as_new_or_freed(drive):
    """A run that an FMU ends leaves neither its state nor its messages to the next."""
    pool = InstancePool()
    fresh = signals(drive, None)
    try:
        with pytest.raises(StepError):
            signals(drive, pool, start={"mass": 0.0})
        assert np.array_equal(signals(drive, pool), fresh)
        with instantiate(drive.system, pool=pool) as instances:
            assert not any(one.log_lines() for one in instances.running)
    finally:
        pool.close()
