"""The law of the controller in space: each derivative beside differences of the FMU itself."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.docking.options import SpaceOptions
from orchestrator.docking.space_stability import space_point
from orchestrator.frequency.measured_part import differences
from orchestrator.frequency.twin_runs import resumed
from orchestrator.master.running_instances import instantiate
from orchestrator.results.measures import choose_measures
from orchestrator.simulation.run import prepare

LINEAR = ("controller.switching_compensation=false", "controller.identification_period=1 s")
SAMPLES = 12


def reached(time, *overrides):
    """The controller's law where a run is at a time, its inputs there, and the FMU as it stands."""
    prepared = prepare("docking-6d", overrides)
    (options,) = (one.options for one in choose_measures(prepared.config))
    assert isinstance(options, SpaceOptions)
    find = space_point(prepared, options).laws_there["controller"]
    with instantiate(prepared.system) as instances:
        signals = instances.initialise(float(prepared.grid.start), None)
        for point in prepared.grid:
            if point.time >= time - 1e-9:
                break
            signals, _ = prepared.master.step(prepared.system, instances, point, signals)
        names = [one.name for one in prepared.system.instances]
        one, running = (
            each[names.index("controller")] for each in (prepared.system.instances, instances.running)
        )
        law = find(running.get_values)
        inputs = list(law.space.inputs) if law is not None else []
        return law, running.get_values(inputs), *resumed(one, running, prepared, point.time)


@pytest.mark.parametrize(
    "more", [(), ("controller.tau_s=1 ms", "sensor.tau_s=1 ms"), ("controller.normal_time=0 s",)]
)
def test_the_law_in_contact_is_what_the_fmu_does(more):
    law, values, one, prepared = reached(0.3, *LINEAR, *more)
    sampled = law.sampled
    outputs = list(sampled.outputs[:12])
    for column, name in enumerate(sampled.inputs):
        height = 1e-6 * max(1.0, abs(values[name]))
        up, down = (
            np.array(list(differences(one, [name], values, outputs, prepared, [np.array([size])] * SAMPLES)))
            for size in (height, -height)
        )
        found = (up - down)[1:] / (2.0 * height)
        state, expected = np.zeros(len(sampled.a)), []
        for _ in range(SAMPLES):
            expected.append(sampled.c[:12] @ state + sampled.d[:12, column])
            state = sampled.a @ state + sampled.b[:, column]
        # The normal turns on with the run's own force; what moves next to nothing is lost in rounding.
        least = max(2e-3 * np.max(abs(found)), 1e-10 / height)
        assert found == pytest.approx(np.array(expected), rel=1e-3, abs=least)


def test_the_limit_of_short_samples_is_that_of_the_sampled_law():
    """At a frequency far below the sampling the two agree but for the hold."""
    law, *_ = reached(0.3, *LINEAR)
    s = 2j * np.pi * 1.0
    z = np.exp(s * law.period)
    one, other = law.space, law.sampled
    limit = one.c @ np.linalg.solve(s * np.eye(len(one.a)) - one.a, one.b) + one.d
    held = other.c @ np.linalg.solve(z * np.eye(len(other.a)) - other.a, other.b) + other.d
    assert limit == pytest.approx(held, rel=1e-2, abs=1e-5)


def test_out_of_contact_and_without_compensation_no_law_is_stated():
    assert reached(0.1)[0] is None
    assert reached(0.3, "controller.mode=lead")[0] is None


def test_estimates_and_what_is_left_out_are_named():
    law, *_ = reached(0.3)
    # The contact has 176 N/mm; by now the controller has identified it once.
    assert "estimates stand still, at 175202 N/m and 0 N.s/m" in law.notes[0]
    assert law.notes[1:] == ("switching_compensation is not linear and is left out",)
