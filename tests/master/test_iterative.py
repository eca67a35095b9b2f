"""The iterative master: loops that no fixed step solves, cycles solved implicitly, what cannot be solved."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from assembled import assemble
from doubles import FakeFmu, gain, mass, spring, variable

from orchestrator.base.errors import ConfigError, StepError
from orchestrator.fmi import Capabilities, Causality, Kind, StepStatus, Variability, load_fmu
from orchestrator.master import create_master
from orchestrator.master.iterative import Iterative, blocks
from orchestrator.results.recorders import Recorder
from orchestrator.simulation.grid import Grid
from orchestrator.simulation.loop import Report, simulate
from orchestrator.simulation.run import prepare, run
from orchestrator.system.assembly import Part
from orchestrator.system.signal_vector import Layout

METHODS = ("newton", "anderson", "fixed-point")
STIFFNESS = {"soft": 0.3, "stiff": 1.0}


def simulated(system, master, steps, stop=1):
    recorder = Recorder(system)
    simulate(system, master, Grid(Fraction(0), Fraction(stop, steps), steps), [recorder])
    return recorder.results()


def oscillator(order=("mass", "spring"), stiffness=1.0):
    parts = {"mass": Part("mass", mass(), {"position": "1 m"}), "spring": Part("spring", spring(stiffness))}
    return assemble(
        [parts[name] for name in order],
        ["mass.position -> spring.position", "spring.force -> mass.force"],
    )


# Algebraic loops.


def loop_config(path, **changes):
    """Y = 50 (y + 0.5) + 1, so that y = -26/49."""
    return {
        "run": {
            "master": {"name": "iterative", "tolerance": 1e-10},
            "step_size": "0.1 s",
            "stop_time": "1 s",
            **changes,
        },
        "instances": {
            "a": {"fmu": str(path), "start": {"k": 50.0, "c": 1.0}},
            "b": {"fmu": str(path), "start": {"k": 1.0, "c": 0.5}},
        },
        "connections": ["a.y -> b.u", "b.y -> a.u"],
    }


def test_a_loop_of_gain_50_is_solved_from_the_start_with_the_default_settings(python_fmu):
    path = python_fmu("amplifier")
    assert not load_fmu(path).description.capabilities.directional_derivatives
    results = run(loop_config(path), halving=False).results
    assert len(results) == 11
    assert results["a.y"] == pytest.approx(np.full(11, -26.0 / 49.0), abs=1e-10)
    assert results["b.y"] == pytest.approx(np.full(11, 0.5 - 26.0 / 49.0), abs=1e-10)


@pytest.mark.parametrize("method", ["newton", "anderson"])
def test_a_loop_that_changes_in_time_is_solved_at_every_point(method):
    clock = FakeFmu(
        outputs={"y": ""},
        step=lambda values, time, h: values.update(now=time + h),
        output=lambda values: {"y": math.sin(values.get("now", 0.0))},
    )
    amplifier = gain(
        inputs={"u": "", "v": ""}, feedthrough={"y": ["u", "v"]},
        output=lambda v: {"y": 50.0 * v["u"] + v["v"]},
    )  # fmt: skip
    system = assemble(
        [Part("clock", clock), Part("a", amplifier), Part("b", gain())],
        ["clock.y -> a.v", "a.y -> b.u", "b.y -> a.u"],
        loops=True,
    )
    results = simulated(system, Iterative(tolerance=1e-11, method=method), 20)
    assert results["a.y"] == pytest.approx(np.sin(results.time) / -49.0, abs=1e-10)


def test_a_nonlinear_loop_is_solved():
    cubic = gain(output=lambda values: {"y": 2.0 - values["u"] ** 3})
    system = assemble([Part("a", cubic), Part("b", gain())], ["a.y -> b.u", "b.y -> a.u"], loops=True)
    results = simulated(system, Iterative(tolerance=1e-12), 5)  # 1 = 2 - 1**3; its slope there is -3
    assert results["a.y"] == pytest.approx(np.ones(6), abs=1e-11)


def test_a_loop_without_a_solution_raises_at_initialisation_with_the_numbers(python_fmu):
    config = loop_config(python_fmu("amplifier"))
    config["instances"]["a"]["start"]["k"] = 1.0
    with pytest.raises(StepError) as caught:
        run(config, halving=False)
    first, *rest = str(caught.value).splitlines()
    assert first == (
        "b at time 0 s: algebraic loop at initialisation: no convergence after 1 iteration (its loop gain is "
        "1, so that there is no solution or no single one); tolerance 1e-12"
    )
    assert rest == [
        "    b.y: residual 0.667, 0.5 gives 1.5",
        "    a.y: residual 0.333, 1 gives 1.5",
        "  Check its start values and what it consists of.",
    ]
    assert caught.value.status == "not converged"


def test_no_convergence_is_an_error_with_iterations_residuals_and_tolerance():
    system = oscillator(stiffness=1e4)
    with pytest.raises(StepError) as caught:
        simulated(system, Iterative(tolerance=1e-9, method="fixed-point", max_iterations=3), 10)
    # F(x) = -1e4 * (1 + 0.005 x) of the force x: -1e4, 4.9e5, -2.451e7, 1.22549e9.
    assert str(caught.value).splitlines() == [
        "spring at time 0 s: master iterative, fixed-point: no convergence after 3 iterations; "
        "tolerance 1e-09",
        "    spring.force: residual 1.02, -24510000 gives 1.22549e+09 N",
        "  Take a smaller step size, or check what the loop consists of.",
    ]
    assert caught.value.status == "not converged" and caught.value.instance == "spring"


def test_an_iteration_that_runs_off_raises():
    with pytest.raises(StepError):
        simulated(oscillator(stiffness=1e9), Iterative(tolerance=1e-9, method="fixed-point"), 10)


def test_other_masters_refuse_a_loop_hop_by_hop_and_name_the_remedy(python_fmu):
    config = loop_config(python_fmu("amplifier"), master="gauss-seidel")
    for one in config["instances"].values():
        one["feedthrough"] = {"y": ["u"]}
    with pytest.raises(ConfigError) as caught:
        prepare(config)
    text = str(caught.value)
    assert "config: connections: algebraic loop\n  b.u is direct-feedthrough to b.y" in text
    assert "  a.y is connected to b.u\n  The master iterative solves it; or take a connection out" in text


def switch(turned, **changes):
    """Y = u, or its opposite."""

    def port(name, causality):
        return variable(name, causality, kind=Kind.BOOLEAN, type="Boolean", variability=Variability.DISCRETE)

    return FakeFmu(
        extra=[port("u", Causality.INPUT), port("y", Causality.OUTPUT)],
        output=lambda values: {"y": bool(values["u"]) != turned},
        **{"feedthrough": None, **changes},
    )


def test_a_loop_through_what_is_no_real_number_is_refused_by_every_master():
    fmu = switch(True, feedthrough={"y": ["u"]})
    with pytest.raises(ConfigError) as caught:
        assemble([Part("a", fmu), Part("b", fmu)], ["a.y -> b.u", "b.y -> a.u"], loops=True)
    assert (
        "It cannot be solved: a.y is of type Boolean, and only real numbers can be iterated. "
        "Take a connection out of the loop"
    ) in str(caught.value)


def test_a_loop_at_initialisation_alone_runs_with_every_master():
    lagging = gain(feedthrough={"y": []}, output=lambda values: {"y": values["u"] * 0.5 + 1.0})
    lagging.description = replace(lagging.description, initial_feedthrough={"y": ("u",)})
    system = assemble([Part("a", lagging), Part("b", gain())], ["a.y -> b.u", "b.y -> a.u"])
    assert system.loops == ()
    results = simulated(system, create_master("gauss-seidel"), 1)
    assert results["a.y"][0] == pytest.approx(2.0, rel=1e-12)


# Loops that are only assumed.


@pytest.mark.parametrize(("master", "behind"), [("jacobi", 2), ("gauss-seidel", 1)])
def test_an_assumed_loop_is_held_over_the_step_and_agrees_at_the_start(master, behind):
    contraction = gain(feedthrough=None, output=lambda values: {"y": 0.5 * values["u"] + 1.0})
    system = assemble(
        [Part("a", contraction), Part("b", gain(feedthrough=None))], ["a.y -> b.u", "b.y -> a.u"]
    )
    results = simulated(system, create_master(master), 4)
    assert results["a.y"] == pytest.approx(np.full(5, 2.0), rel=1e-12)

    # A source whose jump goes round: each pass of the loop costs a step, of Jacobi two.
    def ramp(values, time, h):
        values["now"] = time + h

    source = FakeFmu(outputs={"y": ""}, step=ramp, output=lambda values: {"y": values.get("now", 0.0)})
    adder = gain(
        inputs={"u": "", "v": ""}, feedthrough=None, output=lambda values: {"y": values["u"] + values["v"]}
    )
    system = assemble(
        [Part("source", source), Part("a", adder), Part("b", gain(0.5, feedthrough=None))],
        ["source.y -> a.v", "a.y -> b.u", "b.y -> a.u"],
    )
    found = simulated(system, create_master(master), 8)
    late = int(master == "jacobi")  # the source's value is a step late, too
    expected = [0.0] * 9
    for n in range(1, 9):
        back = 0.5 * expected[n - behind] if n >= behind else 0.0
        expected[n] = (n - late) / 8 + back
    assert found["a.y"] == pytest.approx(expected, rel=1e-12)


def test_an_assumed_loop_that_has_no_start_is_reported_and_runs():
    loop = ["a.y -> b.u", "b.y -> a.u"]
    system = assemble(
        [Part(n, gain(feedthrough=None, output=lambda v: {"y": v["u"] + 1.0})) for n in "ab"], loop
    )
    report = Report()
    simulate(system, create_master("jacobi"), Grid(Fraction(0), Fraction(1, 2), 2), report=report)
    (reported,) = report.log.values()
    assert reported[0].startswith("[not converged] algebraic loop at initialisation: no convergence after 1 ")
    assert reported[0].endswith("; it begins with start values")
    # What no master can iterate is passed on as it is.
    system = assemble([Part("a", switch(True)), Part("b", switch(False))], loop)
    simulate(system, create_master("jacobi"), Grid(Fraction(0), Fraction(1, 2), 2), report=report)
    assert "still change after 10 passes" in str(report.log)
    system = assemble([Part("a", switch(False)), Part("b", switch(False))], loop)
    simulate(system, create_master("jacobi"), Grid(Fraction(0), Fraction(1, 2), 2), report=report)
    assert not report.log


# Cycles through states.


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("interpolation", [0, 1])
def test_orders_of_convergence(method, interpolation):
    errors = []
    for steps in (100, 200, 400):
        master = Iterative(tolerance=1e-12, method=method, interpolation=interpolation)
        results = simulated(oscillator(), master, steps, stop=2)
        errors.append(np.abs(results["mass.position"] - np.cos(results.time)).max())
    observed = [math.log2(coarse / fine) for coarse, fine in pairwise(errors)]
    assert observed == pytest.approx([master.order] * 2, abs=0.05)
    assert master.order == 1 + interpolation


def test_one_step_is_implicit():
    system = oscillator()
    h = 0.5
    results = simulated(system, Iterative(tolerance=1e-13), 1, stop=Fraction(1, 2))
    assert results["mass.position"][1] == pytest.approx(1.0 / (1.0 + h * h / 2.0), rel=1e-12)
    results = simulated(system, Iterative(tolerance=1e-13, interpolation=1), 1, stop=Fraction(1, 2))
    # The mean force acts: x = 1 - h*h/4 * (1 + x).
    assert results["mass.position"][1] == pytest.approx((1.0 - h * h / 4.0) / (1.0 + h * h / 4.0), rel=1e-12)


def test_a_stiff_coupling_that_fixed_steps_blow_up_stays_bounded():
    system = oscillator(stiffness=1e4)
    with np.errstate(over="ignore", invalid="ignore"):
        explicit = simulated(system, create_master("gauss-seidel"), 50, stop=5)
    assert np.abs(explicit["mass.position"]).max() > 1e6
    implicit = simulated(system, Iterative(tolerance=1e-9), 50, stop=5)
    assert np.abs(implicit["mass.position"]).max() <= 1.0


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("order", [("mass", "spring"), ("spring", "mass")])
def test_a_loose_tolerance_gives_gauss_seidel_to_the_bit(method, order):
    system = oscillator(order)
    loose = simulated(system, Iterative(tolerance=1e9, method=method), 50)
    fixed = simulated(system, create_master("gauss-seidel"), 50)
    for name in ("mass.position", "mass.velocity", "spring.force"):
        assert loose[name].tolist() == fixed[name].tolist()


def test_only_what_stands_in_a_cycle_is_stepped_back():
    rigid = Capabilities(save_state=False, variable_step_size=True)
    ramp = FakeFmu(outputs={"y": "m"}, capabilities=rigid)
    sink = gain(unit_in="m", unit_out="m", capabilities=rigid)
    system = assemble(
        [Part("sink", sink), Part("mass", mass(), {"position": "1 m"}), Part("spring", spring()),
         Part("ramp", ramp)],
        ["mass.position -> spring.position", "spring.force -> mass.force", "mass.position -> sink.u"],
    )  # fmt: skip
    found = blocks(system, Layout.of(system))
    assert [[system.instances[index].name for index in one.order] for one in found if one.torn] == [
        ["mass", "spring"]
    ]
    simulated(system, Iterative(tolerance=1e-12), 3)
    assert sink.calls.count(("sink", "step")) == ramp.calls.count(("ramp", "step")) == 3


def test_an_fmu_that_cannot_be_stepped_back_is_refused_beforehand():
    stuck = mass(capabilities=Capabilities(variable_step_size=True))
    system = assemble(
        [Part("mass", stuck), Part("spring", spring())],
        ["mass.position -> spring.position", "spring.force -> mass.force"],
    )
    with pytest.raises(ConfigError) as caught:
        simulated(system, Iterative(tolerance=1e-9), 3)
    assert str(caught.value) == (
        "system: instances.mass: master iterative cannot step mass back, which its place in a cycle of "
        "connections demands\n"
        "  FMU Mass does not declare canGetAndSetFMUstate. Take an FMU that does, or the master gauss-seidel."
    )


def test_an_instance_that_refuses_a_step_ends_the_run():
    fmu = mass(step=lambda values, time, h: StepStatus.DISCARD if time > 0.45 else None)
    system = assemble(
        [Part("mass", fmu), Part("spring", spring())],
        ["mass.position -> spring.position", "spring.force -> mass.force"],
    )
    with pytest.raises(StepError, match=r"mass at time 0\.5 s: refused a step of 0\.1 s"):
        simulated(system, Iterative(tolerance=1e-9), 10)


def test_the_number_of_iterations_and_the_residual_are_reported():
    from orchestrator.fmi import Point
    from orchestrator.master.running_instances import instantiate

    system = oscillator()
    with instantiate(system) as instances:
        signals = instances.initialise(0.0, 1.0)
        _, info = Iterative(tolerance=1e-12).step(system, instances, Point(0, 0.0, 0.1), signals)
    assert 2 <= info.iterations <= 4 and 0.0 <= info.residual <= 1e-12


@pytest.mark.parametrize("names", [("soft", "stiff"), ("stiff", "soft")])
def test_of_several_cycles_the_most_iterations_and_the_largest_residual_are_reported(names):
    """The one that takes the most need not be the one that is left with the largest."""
    from orchestrator.fmi import Point
    from orchestrator.master.running_instances import instantiate

    def reported(*which):
        parts, links = [], []
        for one in which:
            parts += [Part(f"{one}-mass", mass(), {"position": "1 m"}), Part(one, spring(STIFFNESS[one]))]
            links += [f"{one}-mass.position -> {one}.position", f"{one}.force -> {one}-mass.force"]
        system = assemble(parts, links)
        with instantiate(system) as instances:
            signals = instances.initialise(0.0, 1.0)
            master = Iterative(tolerance=1e-3, method="fixed-point")
            return master.step(system, instances, Point(0, 0.0, 0.1), signals)[1]

    soft, stiff = reported("soft"), reported("stiff")
    assert soft.iterations < stiff.iterations and soft.residual > stiff.residual
    both = reported(*names)
    assert (both.iterations, both.residual) == (stiff.iterations, soft.residual)


# Options.


def problem(**options) -> str:
    with pytest.raises(ConfigError) as caught:
        create_master({"name": "iterative", **options})
    return str(caught.value)


def test_a_tolerance_must_be_given_and_unknown_options_are_errors():
    assert problem() == "master iterative: tolerance is missing\n  it has no default"
    assert problem(tolerance=0).startswith("master iterative: tolerance: input should be greater than 0")
    assert "tolerence: unknown key 'tolerence'" in problem(tolerance=1e-6, tolerence=1)
    assert "'newton', 'anderson' or 'fixed-point'" in problem(tolerance=1e-6, method="secant")


def test_options_are_set_from_the_command_line_and_keep_the_name(python_fmu):
    config = loop_config(python_fmu("amplifier"))
    prepared = prepare(config, ["run.master.tolerance=1e-6", "run.master.method=anderson"])
    assert prepared.master == Iterative(tolerance=1e-6, method="anderson")
    assert prepared.config.model.run.master == {
        "name": "iterative", "tolerance": 1e-6, "method": "anderson",
    }  # fmt: skip
