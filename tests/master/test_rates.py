"""Instances with a step of their own."""

from __future__ import annotations

from fractions import Fraction

import pytest
from assembled import assemble
from doubles import FakeFmu, gain, mass, spring, variable

from orchestrator.base.errors import ConfigError
from orchestrator.fmi import Causality, Initial
from orchestrator.master import create_master
from orchestrator.master.iterative import Iterative
from orchestrator.results.recorders import Recorder
from orchestrator.simulation.grid import Grid
from orchestrator.simulation.loop import simulate
from orchestrator.simulation.run import prepare
from orchestrator.system.assembly import Part


def simulated(system, name, steps, stop=1):
    recorder = Recorder(system)
    simulate(system, create_master(name), Grid(Fraction(0), Fraction(stop, steps), steps), [recorder])
    return recorder.results()


def counter():
    """Adds its input times the step size; remembers its steps in `steps`."""
    steps = []

    def step(values, time, h):
        steps.append((time, h, values["u"]))
        values["level"] += h * values["u"]

    level = variable("level", Causality.OUTPUT, initial=Initial.EXACT)
    fmu = FakeFmu(inputs={"u": ""}, extra=[level], step=step)
    fmu.steps = steps
    return fmu


def clock():
    return FakeFmu(
        outputs={"y": ""},
        step=lambda values, time, h: values.update(now=time + h),
        output=lambda values: {"y": values.get("now", 0.0)},
    )


@pytest.mark.parametrize(("name", "given"), [("jacobi", [0.0, 0.4]), ("gauss-seidel", [0.4, 0.8])])
def test_a_slow_instance_steps_once_in_n_and_holds_its_outputs_until_then(name, given):
    slow = counter()
    system = assemble([Part("clock", clock()), Part("slow", slow, ratio=Fraction(4))], ["clock.y -> slow.u"])
    results = simulated(system, name, 8, Fraction(4, 5))
    assert [time for time, _, _ in slow.steps] == pytest.approx([0.0, 0.4])
    assert [h for _, h, _ in slow.steps] == pytest.approx([0.4, 0.4])
    assert [u for _, _, u in slow.steps] == pytest.approx(given)
    levels = [0.0] * 4 + [0.4 * given[0]] * 4 + [0.4 * sum(given)]
    assert results["slow.level"].tolist() == pytest.approx(levels)


@pytest.mark.parametrize("master", ["jacobi", "gauss-seidel", {"name": "iterative", "tolerance": 1e-9}])
def test_a_fast_instance_takes_whole_parts_of_a_step(master):
    fast = counter()
    parts = [Part("clock", clock()), Part("fast", fast, ratio=Fraction(1, 4))]
    system = assemble(parts, ["clock.y -> fast.u"])
    recorder = Recorder(system)
    simulate(system, create_master(master), Grid(Fraction(0), Fraction(1, 2), 2), [recorder])
    assert [(time, h) for time, h, _ in fast.steps] == [(n / 8, 1 / 8) for n in range(8)]
    assert len({u for _, _, u in fast.steps[:4]}) == 1


def test_a_ratio_of_one_changes_no_bit():
    def system(ratio):
        return assemble(
            [Part("mass", mass(), {"position": "1 m"}, ratio=ratio), Part("spring", spring())],
            ["mass.position -> spring.position", "spring.force -> mass.force"],
        )

    one, same = simulated(system(Fraction(1)), "jacobi", 20), simulated(system(Fraction(3, 3)), "jacobi", 20)
    assert one["mass.position"].tolist() == same["mass.position"].tolist()


def test_a_system_at_one_slow_rate_is_the_system_at_that_rate():
    def system(ratio):
        return assemble(
            [Part("mass", mass(), {"position": "1 m"}, ratio=ratio), Part("spring", spring(), ratio=ratio)],
            ["mass.position -> spring.position", "spring.force -> mass.force"],
        )

    for name in ("jacobi", "gauss-seidel"):
        slow = simulated(system(Fraction(4)), name, 64)
        coarse = simulated(system(Fraction(1)), name, 16)
        assert slow["mass.position"][::4].tolist() == coarse["mass.position"].tolist()


def config(path, **steps):
    return {
        "run": {"master": "jacobi", "step_size": "1 ms", "stop_time": "12 ms"},
        "instances": {
            name: {"fmu": str(path), "start": {"u": 1.0}, **({"step_size": step} if step else {})}
            for name, step in steps.items()
        },
    }


def test_own_steps_of_a_config(python_fmu):
    path = python_fmu("amplifier")
    prepared = prepare(config(path, a="3 ms", b="250 us", c=None))
    assert [one.ratio for one in prepared.system.instances] == [3, Fraction(1, 4), 1]
    assert prepare(prepared.config, ["instances.a.step_size=6 ms"]).system.instances[0].ratio == 6
    with pytest.raises(ConfigError) as caught:
        prepare(config(path, a="1.5 ms", b="0.3 ms", c="5 ms", d="-1 ms"))
    assert str(caught.value).splitlines() == [
        "config: instances.a.step_size: cannot step a by 1.5 ms: it is 1.5 communication steps of 1 ms",
        "  a whole multiple, or a whole part of one, is needed",
        "config: instances.b.step_size: cannot step b by 0.3 ms: it is 0.3 communication steps of 1 ms",
        "  a whole multiple, or a whole part of one, is needed",
        "config: instances.c.step_size: cannot step c by 5 ms: a run of 0.012 s is 2.4 steps of it",
        "  a whole number is needed",
        "config: instances.d.step_size: cannot step d by -1 ms: it is -1 communication steps of 1 ms",
        "  a whole multiple, or a whole part of one, is needed",
    ]


def test_masters_that_step_back_refuse_slow_instances():
    system = assemble([Part("slow", gain(), {"u": 1}, ratio=Fraction(2))])
    with pytest.raises(ConfigError) as caught:
        simulate(system, Iterative(tolerance=1e-6), Grid(Fraction(0), Fraction(1, 2), 2))
    assert str(caught.value) == (
        "system: instances.slow.step_size: slow steps once in 2 communication steps\n"
        "  the master repeats communication steps. Give it the communication step or a part of it, or take "
        "the master jacobi or gauss-seidel."
    )
