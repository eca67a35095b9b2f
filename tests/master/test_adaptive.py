"""The adaptive master: errors that keep to the tolerance, and what it does where they cannot."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from assembled import assemble
from doubles import FakeFmu, gain, mass, spring, variable

from orchestrator.base.errors import ConfigError, StepError
from orchestrator.fmi import Capabilities, Causality, Initial, Point
from orchestrator.fmi.bundled import find_fmu
from orchestrator.master import create_master
from orchestrator.master.adaptive import Adaptive
from orchestrator.master.energy import Ledger
from orchestrator.master.extrapolation import Extrapolation
from orchestrator.master.running_instances import Instances, instantiate
from orchestrator.results.recorders import Recorder
from orchestrator.simulation.grid import Grid
from orchestrator.simulation.loop import simulate
from orchestrator.simulation.run import prepare
from orchestrator.system.assembly import Part

ESTIMATES = ("doubling", "inputs")


def simulated(system, master, steps, stop=1):
    recorder = Recorder(system)
    simulate(system, master, Grid(Fraction(0), Fraction(stop, steps), steps), [recorder])
    return recorder.results()


def oscillator(**changes):
    return assemble(
        [Part("mass", mass(**changes), {"position": "1 m"}), Part("spring", spring())],
        ["mass.position -> spring.position", "spring.force -> mass.force"],
    )


def steps_of(system) -> int:
    return system.instances[0].fmu.calls.count((system.instances[0].name, "step"))


def error_and_cost(master, steps=4, stop=4):
    system = oscillator()
    results = simulated(system, master, steps, stop)
    return np.abs(results["mass.position"] - np.cos(results.time)).max(), steps_of(system)


@pytest.mark.parametrize("estimate", ESTIMATES)
@pytest.mark.parametrize("base", ["gauss-seidel", "jacobi"])
def test_the_error_follows_the_tolerance_down(estimate, base):
    def measured(tolerance):
        return error_and_cost(Adaptive(tolerance=tolerance, estimate=estimate, base=base))

    (coarse, few), (fine, many) = measured(2e-2), measured(1e-3)
    assert fine < coarse / 3 and many > 3 * few


@pytest.mark.parametrize("base", ["gauss-seidel", "jacobi"])
def test_a_loose_tolerance_gives_the_fixed_step_to_the_bit(base):
    fixed = simulated(oscillator(), create_master(base), 32)
    loose = simulated(oscillator(), Adaptive(tolerance=1e9, estimate="inputs", base=base), 32)
    halved = simulated(oscillator(), Adaptive(tolerance=1e9, base=base), 16)
    for name in ("mass.position", "mass.velocity", "spring.force"):
        assert loose[name].tolist() == fixed[name].tolist()
        # Of step doubling the two halves are kept.
        assert halved[name].tolist() == fixed[name][::2].tolist()


def rebound():
    """A mass of 1 kg that flies at 1 m/s against a spring of 1e4 N/m, from 1 m away: it leaves as it came."""
    wall = spring()
    wall.output = lambda values: {"force": 1e4 * max(-values["position"], 0.0)}
    start = {"position": "1 m", "velocity": "-1 m/s"}
    return assemble(
        [Part("mass", mass(), start), Part("wall", wall)],
        ["mass.position -> wall.position", "wall.force -> mass.force"],
    )


def test_steps_go_where_the_action_is_and_beat_fixed_ones_at_equal_error():
    parts = {}

    def measured(master, steps):
        system = rebound()
        recorder = Recorder(system)

        class Spy:
            def check(self, *arguments):
                return master.check(*arguments)

            def step(self, system, instances, point, signals):
                after, info = master.step(system, instances, point, signals)
                parts[point.index] = info.iterations
                return after, info

        simulate(system, Spy(), Grid(Fraction(0), Fraction(2, steps), steps), [recorder])
        return abs(recorder.results()["mass.velocity"][-1] - 1.0), steps_of(system)

    error, cost = measured(Adaptive(tolerance=1e-3), 32)
    # The first contact is at 1 s, in the middle of the run.
    assert parts[0] == parts[15] == parts[30] == 1 and parts[16] >= 64
    fixed, _ = measured(create_master("gauss-seidel"), 4 * cost)
    assert error < fixed


def test_points_of_parts_are_met_exactly():
    seen = []

    def step(values, time, h):
        seen.append((time, h))
        return mass().step(values, time, h)

    simulated(oscillator(step=step), Adaptive(tolerance=1e-4), 3, stop=1)
    grid = {n / 3 for n in range(3)}
    assert grid <= {time for time, _ in seen}
    # Of each attempt the whole is followed by its halves; those that count join without a gap.
    kept, reached = 0, 0.0
    for (time, h), (halfway, half) in pairwise(seen):
        if time == pytest.approx(reached, abs=1e-12) and halfway == pytest.approx(time + h) and half == h:
            kept, reached = kept + 1, halfway + half
    assert kept > 10 and reached == pytest.approx(1.0, abs=1e-12)


def test_what_no_step_resolves_is_an_error_with_the_numbers():
    def wobble(values, time, h):
        values["level"] += np.sqrt(h)

    level = variable("level", Causality.OUTPUT, "m", initial=Initial.EXACT)
    system = assemble([Part("jump", FakeFmu(extra=[level], step=wobble))])
    with pytest.raises(StepError) as caught:
        simulated(system, Adaptive(tolerance=1e-6, max_halvings=3), 10)
    assert str(caught.value) == (
        "jump at time 0 s: master adaptive: a step of 0.0125 s, halved 3 times, still has an estimated error "
        "of 4.63e+04 times the tolerance in jump.level\n"
        "  A jump cannot be resolved by small steps: take a larger tolerance, or a fixed step."
    )
    assert caught.value.status == "not converged"


def test_fmus_that_cannot_vary_their_step_or_go_back_are_refused():
    system = oscillator(capabilities=Capabilities())
    with pytest.raises(ConfigError) as caught:
        simulated(system, Adaptive(tolerance=1e-3), 3)
    assert [one.what for one in caught.value.problems] == [
        "master adaptive cannot step mass back, which it does where the error of a step is too large",
        "master adaptive cannot vary the step of mass",
    ]
    assert "canHandleVariableCommunicationStepSize" in str(caught.value)


def test_a_tolerance_must_be_given():
    with pytest.raises(ConfigError, match="tolerance is missing"):
        create_master("adaptive")


# Tolerances of signals.


def test_only_the_signals_that_have_a_tolerance_count():
    def cost(tolerance):
        return error_and_cost(Adaptive(tolerance=tolerance))[1]

    free = cost({"mass.position": "1 km", "spring.force": "1 MN"})
    assert free == 3 * 4, "every step once as a whole and once in halves"
    assert cost({"spring.force": "1 mN"}) > 4 * free
    assert cost({"mass.position": "1 mm"}) == cost({"mass.position": "0.001 m"}) > 4 * free


@pytest.mark.parametrize(
    ("options", "reported"),
    [
        (
            {"tolerance": {"mass.spead": "1 m/s"}},
            "no real signal 'mass.spead' that is recorded or feeds an input",
        ),
        (
            {"tolerance": {"mass.position": "1 N"}},
            "tolerance of mass.position: N [kg.m.s-2] cannot be converted",
        ),
        ({"tolerance": {"mass.position": "-1 m"}}, "tolerance of mass.position: '-1 m' is not above zero"),
        (
            {"tolerance": {"mass.velocity": "1 m/s"}, "estimate": "inputs"},
            "'mass.velocity' that feeds an input",
        ),
        ({"tolerance": "1 N", "estimate": "inputs"}, "'1 N' says of no signal how large its error may be"),
        (
            {"tolerance": 1e-3, "estimate": "power"},
            "estimate power: 0.001 is no energy; write it as in '1 uJ'",
        ),
        ({"tolerance": "1 N", "estimate": "power"}, "estimate power: N [kg.m.s-2] cannot be converted to J"),
    ],
)
def test_wrong_tolerances_are_reported_before_the_run(options, reported):
    (problem,) = Adaptive(**options).check(oscillator())
    assert reported in str(problem) and problem.place == "system: run.master.tolerance"


@pytest.mark.parametrize(
    ("options", "reported"),
    [
        ({"base": "adaptive"}, "'adaptive' takes no single steps; bases: gauss-seidel, jacobi, iterative"),
        ({"base": {"name": "jacobi", "extrapolation": 7}}, "input should be 0, 1 or 2"),
        ({"estimate": "doubling", "rollback": False}, "takes every part twice, which needs rollback"),
        ({"tolerance": 0}, "input should be greater than 0"),
    ],
)
def test_wrong_options_are_reported_when_the_master_is_made(options, reported):
    with pytest.raises(ConfigError, match=reported):
        create_master({"name": "adaptive", "tolerance": 1e-3, **options})


# Bases with options.


@pytest.mark.parametrize("extrapolation", [1, 2])
def test_extrapolating_bases_need_fewer_steps(extrapolation):
    base = {"name": "gauss-seidel", "extrapolation": extrapolation}

    def measured(base, tolerance):
        master = Adaptive(tolerance={"spring.force": tolerance}, estimate="inputs", base=base)
        return error_and_cost(master)

    error, cost = measured(base, "1 mN")
    plain, more = measured(base["name"], "2 mN")
    assert error < plain and 3 * cost < more


def test_extrapolation_is_exact_on_points_at_any_distance():
    system = oscillator()
    with instantiate(system) as instances:
        size = instances.layout.size
        a, b, c = (np.arange(1.0, size + 1.0) * factor for factor in (1.0, -0.5, 0.3))

        def at(time):
            return a + b * time + c * time**2

        time, seen = 0.0, []
        for index, step in enumerate((0.1, 0.3, 0.05, 0.4)):
            made = Extrapolation(instances, Point(index, time, step), at(time), 2)
            # An attempt that is taken back leaves no trace.
            made = Extrapolation(instances, Point(index, time, 0.7 * step), at(time), 2)
            made = Extrapolation(instances, Point(index, time, step), at(time), 2)
            seen.append(made.curve)
            if index > 1:
                assert made.curve.end == pytest.approx(at(time + step), rel=1e-12)
                assert made.curve.middle == pytest.approx(at(time + step / 2), rel=1e-12)
            time += step
        assert seen[0] is None and seen[1].order == 1
        gap = Extrapolation(instances, Point(9, time + 1.0, 0.1), at(time), 2)
        assert gap.curve is None, "a step that does not follow the one before begins anew"


def test_the_iterative_base_solves_algebraic_loops():
    """Y = 1 + 0.5 x and x = -2 y, both at once: y = 0.5, along a ramp."""
    ramp = FakeFmu(
        outputs={"y": ""},
        step=lambda values, time, h: values.update(now=time + h),
        output=lambda values: {"y": values.get("now", 0.0)},
    )
    adder = FakeFmu(
        inputs={"u": "", "ramp": ""},
        outputs={"y": ""},
        feedthrough={"y": ["u", "ramp"]},
        output=lambda v: {"y": v["ramp"] + 0.5 * v["u"]},
    )
    parts = [Part("ramp", ramp), Part("adder", adder), Part("back", gain(-2.0))]
    connections = ["ramp.y -> adder.ramp", "back.y -> adder.u", "adder.y -> back.u"]
    master = Adaptive(tolerance=1e-2, base={"name": "iterative", "tolerance": 1e-10})
    assert master.solves_loops and not Adaptive(tolerance=1e-2).solves_loops
    results = simulated(assemble(parts, connections, loops=True), master, 8)
    assert results["adder.y"] == pytest.approx(results.time / 2.0, abs=1e-9)


# The estimate by power.


def cannot_save(**changes):
    return oscillator(capabilities=Capabilities(variable_step_size=True), **changes)


def test_power_steers_fmus_that_cannot_save_their_state():
    def measured(tolerance):
        system = cannot_save()
        ledger = Ledger(system)
        grid = Grid(Fraction(0), Fraction(1), 4)
        recorder = Recorder(system)
        master = Adaptive(tolerance=tolerance, estimate="power")
        simulate(system, master, grid, [recorder], ledger=ledger)
        results = recorder.results()
        assert results.time.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
        error = np.abs(results["mass.position"] - np.cos(results.time)).max()
        return error, steps_of(system), ledger.accounts()["spring-mass"]

    (coarse, few, much), (fine, many, little) = measured("0.1 mJ"), measured("1 uJ")
    assert many > 5 * few and fine < coarse / 5
    assert abs(little.created) < abs(much.created) / 5


def test_power_takes_about_what_it_allows_of_each_part():
    """Parts away from the first few create the tolerance, less what the controller keeps clear of it."""
    system, parts = cannot_save(), []

    class Spy:
        solves_loops = False

        def __init__(self, master):
            self.check, self.master = master.check, master

        def step(self, *arguments):
            after, info = self.master.step(*arguments)
            parts.append((info.iterations, info.residual))
            return after, info

    grid = Grid(Fraction(0), Fraction(1, 2), 10)
    simulate(system, Spy(Adaptive(tolerance="10 uJ", estimate="power")), grid)
    assert all(10 < count < 1000 for count, _ in parts)
    assert all(0.1 < worst < 3.0 for _, worst in parts)


def test_a_part_refused_by_power_names_an_instance():
    system = oscillator()
    master = Adaptive(tolerance="1e-30 J", estimate="power", rollback=True, max_halvings=1)
    with pytest.raises(StepError) as caught:
        simulate(system, master, Grid(Fraction(0), Fraction(1), 4))
    assert caught.value.instance == "spring"
    assert "times the tolerance in power bond spring-mass\n" in str(caught.value)


def test_power_needs_a_bond():
    part = Part("one", gain(capabilities=Capabilities(variable_step_size=True)), {"u": 1})
    (problem,) = Adaptive(tolerance="1 J", estimate="power").check(assemble([part]))
    assert str(problem) == (
        "system: run.master.tolerance: master adaptive cannot estimate by power: no power bond is known\n"
        "  Declare them under bonds."
    )


# The docking loop, whose flights need few steps and whose contacts many.


@pytest.fixture(scope="module")
def reference():
    import fmpy

    return fmpy.simulate_fmu(
        str(find_fmu("UncompensatedDocking")), stop_time=0.8, output_interval=1e-2, relative_tolerance=1e-10
    )


def docking(master, step, reference, monkeypatch):
    """Largest error of the force [N], relative error of the velocity at the end, and the FMUs' steps."""
    overrides = [f"run.step_size={step}", "run.stop_time=0.8 s", "satellite.form=native"]
    prepared = prepare("docking-1d-uncompensated", overrides)
    count = 0
    plain = Instances._do_step

    def counted(*arguments):
        nonlocal count
        count += 1
        return plain(*arguments)

    recorder = Recorder(prepared.system)
    with monkeypatch.context() as patched:
        patched.setattr(Instances, "_do_step", counted)
        simulate(prepared.system, create_master(master), prepared.grid, [recorder], loop="python")
    results = recorder.results()
    every = round(0.01 / float(prepared.grid.step_size))
    force = np.abs(results["contact.force"][::every] - reference["force"]).max()
    velocity = results["satellite.velocity"][-1] / reference["velocity"][-1] - 1.0
    return force, abs(velocity), count


@pytest.mark.parametrize(
    ("estimate", "tolerance", "gain_in_steps"),
    [("inputs", {"contact.force": "0.01 N"}, 4.0), ("power", "1 uJ", 3.0)],
)
def test_on_the_docking_loop_it_beats_fixed_steps_at_equal_error(
    estimate, tolerance, gain_in_steps, reference, monkeypatch
):
    base = {"name": "gauss-seidel", "extrapolation": 2}
    options = {"estimate": estimate, "tolerance": tolerance, "rollback": True}
    force, velocity, steps = docking(
        {"name": "adaptive", "base": base, **options}, "10 ms", reference, monkeypatch
    )
    assert force < 0.03 and velocity < 3e-5
    for master in ("gauss-seidel", {**base, "extrapolation": 1}, base):
        fixed_force, _, fixed = docking(master, "1 ms", reference, monkeypatch)
        order = 1 if master == "gauss-seidel" else 2
        # What the fixed step would take for the same error of the force.
        assert fixed * (fixed_force / force) ** (1.0 / order) > gain_in_steps * steps
