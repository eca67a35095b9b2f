"""Intermediate update of FMI 3.0: inputs follow the master's curve within a step, outputs can be watched."""

from __future__ import annotations

from fractions import Fraction

import foreign
import numpy as np
import pytest
from assembled import assemble
from doubles import FakeFmu
from test_extrapolation import fixed_masters, polynomial, simulated

from orchestrator.base.errors import FmuError, StepError
from orchestrator.fmi import Point, RunOptions, StepStatus, load_fmu
from orchestrator.master import create_master
from orchestrator.simulation.run import run
from orchestrator.system.assembly import Part

ISOLATED = RunOptions(isolated=True)


@pytest.fixture
def within(tmp_path):
    return foreign.within(tmp_path / "Within.fmu")


@pytest.fixture
def deaf(tmp_path):
    """The same FMU, which does not declare that it updates."""
    return foreign.within(tmp_path / "Deaf.fmu", "")


def squared(path, master, steps=10, run_options=RunOptions()):  # noqa: B008
    """X = integral of (1 + 2 t - 3 t^2)^2."""
    system = assemble(
        [Part("source", polynomial(1.0, 2.0, -3.0)), Part("one", load_fmu(path, run_options), {"w": 0})],
        ["source.y -> one.u"],
    )
    return simulated(system, master, steps)


def integral(t):
    return t + 2 * t**2 - 2 * t**3 / 3 - 3 * t**4 + 9 * t**5 / 5


@fixed_masters
def test_inputs_follow_the_extrapolation_within_a_step(name, within, deaf):
    master = create_master({"name": name, "extrapolation": 2})
    follows, holds = squared(within, master), squared(deaf, master)

    def error(results):
        # From where three points are known on, of which on the extrapolation is exact.
        gained = results["one.x"] - results["one.x"][2]
        return np.abs(gained - (integral(results.time) - integral(results.time[2])))[2:].max()

    # Simpson's rule on eighths of a step: a polynomial of degree 4 has an error of h^5 there.
    assert error(follows) < 1e-7
    assert error(holds) > 1e-3
    assert follows["one.held"][-1] == 1  # the first step knows one point only


@pytest.mark.parametrize("run_options", [RunOptions(), ISOLATED], ids=["here", "isolated"])
@fixed_masters
def test_without_extrapolation_nothing_is_set_and_no_bit_changes(name, run_options, within, deaf):
    master = create_master(name)
    plain, updating = squared(deaf, master), squared(within, master, run_options=run_options)
    for signal in ("one.x", "one.y"):
        assert plain[signal].tolist() == updating[signal].tolist()
    assert updating["one.held"][-1] == 10


@fixed_masters
def test_isolation_changes_no_bit_of_an_update(name, within):
    master = create_master({"name": name, "extrapolation": 2})
    here, there = squared(within, master), squared(within, master, run_options=ISOLATED)
    assert here["one.x"].tolist() == there["one.x"].tolist()


def test_what_is_reached_within_a_step_is_announced(within):
    assert squared(within, create_master("jacobi"), 1)["one.required"][-1] == 3  # u, x and y


def test_the_description_tells_which_inputs_follow(within, deaf):
    assert load_fmu(within).description.followed == {"u"}
    assert load_fmu(deaf).description.followed == frozenset()


def started(path, **start):
    instance = load_fmu(path).instantiate("one")
    u, y = np.zeros(1), np.zeros(3)
    instance.bind(["u"], u, ["x", "y", "held"], y)
    instance.enter_initialisation(0.0, {"parts": 4, **start})
    instance.exit_initialisation()
    return instance, u, y


def test_slopes_hold_for_one_step(within):
    instance, u, y = started(within)
    u[0] = 1.0
    instance.write_inputs()
    instance.write_input_derivatives(1, np.array([2.0]))
    instance.do_step(Point(0, 0.0, 0.5))
    instance.read_outputs()
    assert y == pytest.approx([0.5 + 0.5 + 4 * 0.125 / 3, 2.0, 0.0])
    u[0] = 1.0
    instance.write_inputs()
    instance.do_step(Point(1, 0.5, 0.5))
    instance.read_outputs()
    assert y[1] == 1.0
    instance.free()


def test_outputs_are_seen_within_a_step(within):
    instance, u, _ = started(within)
    u[0] = 2.0
    seen = []
    instance.watch(lambda time, outputs: seen.append((time, *outputs.tolist())))
    instance.write_inputs()
    assert instance.do_step(Point(0, 1.0, 1.0)) is StepStatus.OK
    # x is read before the part that ends there is added.
    assert [row[:3] for row in seen] == [(1.25, 0.0, 2.0), (1.5, 1.0, 2.0), (1.75, 2.0, 2.0), (2.0, 3.0, 2.0)]
    assert np.isnan([row[3] for row in seen]).all()  # the FMU would refuse to give it
    assert instance.native_calls() is None  # a watcher is Python
    instance.watch(None)
    assert instance.native_calls() is not None
    instance.free()


def test_what_a_watcher_raises_ends_the_step_early(within):
    instance, u, _ = started(within)
    u[0] = 2.0

    def watcher(time, outputs):
        if time >= 0.5:
            raise KeyboardInterrupt

    instance.watch(watcher)
    instance.write_inputs()
    with pytest.raises(KeyboardInterrupt):
        instance.do_step(Point(0, 0.0, 1.0))
    assert instance.last_successful_time() == 0.5
    instance.free()


def test_watching_needs_an_fmu_that_updates(deaf):
    instance, *_ = started(deaf)
    with pytest.raises(FmuError) as caught:
        instance.watch(print)
    assert str(caught.value) == (
        f"{deaf}: instance one cannot do this, since the FMU does not declare providesIntermediateUpdate"
    )
    instance.free()


@pytest.mark.parametrize("capabilities", [foreign.WITHIN, foreign.WITHIN.split()[0]])
def test_an_input_that_is_refused_within_a_step_is_an_error_of_the_fmu(capabilities, tmp_path):
    path = foreign.within(tmp_path / "W.fmu", capabilities)
    instance, u, _ = started(path, limit=1.6)
    u[0] = 1.0
    instance.write_inputs()
    instance.write_input_derivatives(1, np.array([1.0]))
    with pytest.raises(StepError) as caught:
        instance.do_step(Point(0, 2.0, 1.0))
    assert (caught.value.what, caught.value.time) == ("fmi3SetFloat64 returned error", 2.0)
    # Where the FMU can be asked to return, it does so at the end of the part: u = 1.625 was refused.
    early = "canReturn" in capabilities
    assert instance.last_successful_time() == (2.75 if early else 3.0)
    instance.free()


def test_a_closed_loop_gains_accuracy(within, deaf):

    def run_one(path):
        # x' = u^2 with u = 1 + x, hence x = 1 / (1 - t) - 1.
        plus = FakeFmu(
            inputs={"x": ""}, outputs={"u": ""}, feedthrough={"u": ["x"]},
            output=lambda values: {"u": 1.0 + values["x"]},
        )  # fmt: skip
        system = assemble(
            [Part("one", load_fmu(path), {"w": 0}), Part("plus", plus)],
            ["one.x -> plus.x", "plus.u -> one.u"],
        )
        results = simulated(
            system, create_master({"name": "gauss-seidel", "extrapolation": 2}), 200, stop=Fraction(1, 2)
        )
        return np.abs(results["one.x"] - (1.0 / (1.0 - results.time) - 1.0)).max()

    assert run_one(within) < 0.1 * run_one(deaf)


def test_the_native_loop_takes_such_fmus_and_changes_no_bit(within):
    pytest.importorskip("numba")
    rows = {}
    for loop in ("python", "native"):
        config = {
            "run": {"master": "jacobi", "step_size": "10 ms", "stop_time": "1 s", "loop": loop},
            "instances": {name: {"fmu": str(within), "start": {"w": 0}} for name in ("one", "two")},
            "connections": ["one.x -> two.u"],
        }
        config["instances"]["one"]["start"]["u"] = 0.7
        made = run(config, halving=False)
        assert made.summary["run"]["loop"] == loop
        rows[loop] = made.results["two.x"].tolist()
    assert rows["python"] == rows["native"] and rows["python"][-1] > 0.0
