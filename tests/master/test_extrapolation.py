"""Extrapolated inputs: order of convergence, held and interpolating FMUs, FMI 2's input derivatives."""

from __future__ import annotations

import math
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from assembled import assemble
from doubles import FakeFmu, FakeInstance, gain, mass, spring, variable

from orchestrator.base.errors import ConfigError
from orchestrator.fmi import Capabilities, Causality, Initial, Kind, Variability
from orchestrator.master import create_master
from orchestrator.master.iterative import Iterative
from orchestrator.results.recorders import Recorder
from orchestrator.simulation.grid import Grid
from orchestrator.simulation.loop import simulate
from orchestrator.simulation.run import prepare, run
from orchestrator.system.assembly import Part

fixed_masters = pytest.mark.parametrize("name", ["jacobi", "gauss-seidel"])


def simulated(system, master, steps, stop=1):
    recorder = Recorder(system)
    simulate(system, master, Grid(Fraction(0), Fraction(stop, steps), steps), [recorder])
    return recorder.results()


def oscillator():
    return assemble(
        [Part("mass", mass(), {"position": "1 m"}), Part("spring", spring())],
        ["mass.position -> spring.position", "spring.force -> mass.force"],
    )


@fixed_masters
@pytest.mark.parametrize("extrapolation", [0, 1, 2])
def test_orders_of_convergence(name, extrapolation):
    master, errors = create_master({"name": name, "extrapolation": extrapolation}), []
    for steps in (400, 800, 1600):
        results = simulated(oscillator(), master, steps, stop=2)
        errors.append(np.abs(results["mass.position"] - np.cos(results.time)).max())
    observed = [math.log2(coarse / fine) for coarse, fine in pairwise(errors)]
    assert observed == pytest.approx([master.order] * 2, abs=0.1)
    assert master.order == min(extrapolation + 1, 2)


@fixed_masters
def test_order_zero_changes_no_bit(name):
    plain = simulated(oscillator(), create_master(name), 30)
    zero = simulated(oscillator(), create_master({"name": name, "extrapolation": 0}), 30)
    assert plain["mass.position"].tolist() == zero["mass.position"].tolist()


def polynomial(*coefficients):
    """A source that gives a polynomial of time, and what jumps from 0 to 1 at 0.55 s."""

    def outputs(values):
        now = values.get("now", 0.0)
        return {"y": sum(c * now**n for n, c in enumerate(coefficients)), "on": float(now > 0.55)}

    on = variable(
        "on", Causality.OUTPUT, kind=Kind.BOOLEAN, type="Boolean", variability=Variability.DISCRETE,
        initial=Initial.CALCULATED,
    )  # fmt: skip
    return FakeFmu(
        outputs={"y": ""}, extra=[on], output=outputs, step=lambda v, time, h: v.update(now=time + h)
    )


@pytest.mark.parametrize("order", [1, 2])
def test_a_polynomial_of_the_order_passes_a_jacobi_feedthrough_without_delay(order):
    source = polynomial(*[1.0, 2.0, -3.0][: order + 1])
    system = assemble([Part("source", source), Part("gain", gain())], ["source.y -> gain.u"])
    results = simulated(system, create_master({"name": "jacobi", "extrapolation": order}), 10)
    assert results["gain.y"][order + 1 :] == pytest.approx(results["source.y"][order + 1 :], abs=1e-12)
    held = simulated(system, create_master("jacobi"), 10)
    assert np.abs(held["gain.y"] - held["source.y"])[1:].min() > 1e-3


@fixed_masters
def test_what_is_no_real_number_is_held(name):
    def port(label, causality):
        return variable(
            label, causality, kind=Kind.BOOLEAN, type="Boolean", variability=Variability.DISCRETE,
            initial=Initial.CALCULATED if causality is Causality.OUTPUT else Initial.EXACT,
        )  # fmt: skip

    target = FakeFmu(
        extra=[port("u", Causality.INPUT), port("seen", Causality.OUTPUT)],
        feedthrough={"seen": ["u"]},
        output=lambda values: {"seen": values["u"]},
    )
    system = assemble([Part("source", polynomial(0.0)), Part("target", target)], ["source.on -> target.u"])
    results = simulated(system, create_master({"name": name, "extrapolation": 2}), 10)
    late = 1 if name == "jacobi" else 0
    assert results["target.seen"].tolist() == [False] * (6 + late) + [True] * (5 - late)


class Following(FakeInstance):
    """Integrates an input that runs as its derivatives say."""

    def write_input_derivatives(self, order, values):
        self.values[f"slope{order}"] = float(values[0])

    def do_step(self, point):
        h, one, two = point.step_size, self.values.pop("slope1", 0.0), self.values.pop("slope2", 0.0)
        self.values["level"] += h * self.values["u"] + h * h / 2 * one + h**3 / 6 * two
        return super().do_step(point)


def following(unit=""):
    """An FMU of such instances."""
    level = variable("level", Causality.OUTPUT, initial=Initial.EXACT)
    fmu = FakeFmu(
        inputs={"u": unit}, extra=[level],
        capabilities=Capabilities(interpolate_inputs=True, save_state=True),
    )  # fmt: skip
    fmu.instantiate = lambda name: Following(name, fmu)
    return fmu


@fixed_masters
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("count", [1, 3])
def test_an_fmu_that_interpolates_follows_a_polynomial_exactly(name, order, count):
    """In parts of a step, too: derivatives hold for one of its own steps only."""
    source = polynomial(*[1.0, 2.0, -3.0][: order + 1])
    # The connection converts by 1000, and with it the derivatives.
    scaled = FakeFmu(outputs={"y": "m"}, output=source.output, step=source.step)
    parts = [Part("source", scaled), Part("sum", following("mm"), ratio=Fraction(1, count))]
    system = assemble(parts, ["source.y -> sum.u"])
    results = simulated(system, create_master({"name": name, "extrapolation": order}), 10)
    t = results.time
    exact = 1e3 * sum(c * t ** (n + 1) / (n + 1) for n, c in enumerate([1.0, 2.0, -3.0][: order + 1]))
    # From where enough points are known on.
    gained = results["sum.level"] - results["sum.level"][order]
    assert gained[order:] == pytest.approx((exact - exact[order])[order:], rel=1e-12)


@fixed_masters
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("count", [1, 3])
def test_what_jumps_is_held_though_the_fmu_interpolates(name, order, count):
    """A curve through the value before a jump would run on to three times the jump."""
    through = [{"effect": "quantise", "resolution": 0.5}]
    link = {"from": "source.y", "to": "sum.u", "through": through}
    parts = [Part("source", polynomial(0.0, 1.0)), Part("sum", following(), ratio=Fraction(1, count))]
    results = simulated(assemble(parts, [link]), create_master({"name": name, "extrapolation": order}), 10)
    held = 0.5 * np.round(results.time / 0.5)
    given = held[1:] if name == "gauss-seidel" else held[:-1]
    assert np.diff(results["sum.level"]) == pytest.approx(0.1 * given, abs=1e-12)


@fixed_masters
def test_slow_instances_are_refused_with_extrapolation(name):
    system = assemble([Part("slow", gain(), {"u": 1}, ratio=Fraction(2))])
    with pytest.raises(ConfigError, match="the master extrapolates inputs over one communication step"):
        simulated(system, create_master({"name": name, "extrapolation": 1}), 2)


def docking(master, step, *more):
    """The first contact of the bundled system, whose C FMUs interpolate their inputs."""
    config = ["run.stop_time=0.3 s", f"run.step_size={step}", f"run.master={master}", *more]
    return run(prepare("docking-1d-uncompensated", config), halving=False).results["contact.force"]


@fixed_masters
def test_bundled_fmus_take_input_derivatives(name):
    # An independent route: the implicit trapezoidal coupling, four times as fine.
    reference = docking("{name: iterative, tolerance: 1e-9, interpolation: 1}", "0.05 ms")[::4]

    def error(extrapolation):
        force = docking(f"{{name: {name}, extrapolation: {extrapolation}}}", "0.2 ms")
        return np.abs(force - reference).max() / np.abs(reference).max()

    assert error(0) > 1e-3
    assert error(1) < 1e-4  # measured: 3.7e-5 and 6.8e-6
    assert error(2) < 1e-5  # measured: 9.0e-7 and 8.4e-7


@pytest.mark.parametrize("who", ["robot", "contact"])
@pytest.mark.parametrize(
    "master",
    ["{name: gauss-seidel, extrapolation: 2}", "{name: iterative, tolerance: 1e-9, interpolation: 1}"],
)
def test_bundled_fmus_in_parts_of_a_step_follow_their_inputs_as_in_whole_ones(who, master):
    whole, parts = (docking(master, "0.2 ms", *own) for own in ((), (f"instances.{who}.step_size=0.1 ms",)))
    # What is left are the parts' own roundings; where later parts hold their inputs it is 1e-3 and more.
    assert parts == pytest.approx(whole, rel=0, abs=1e-7 * np.abs(whole).max())


def test_interpolated_iteration_on_an_interpolating_fmu():
    level = variable("level", Causality.OUTPUT, "N", initial=Initial.EXACT, start=1.0)
    fmu = FakeFmu(
        inputs={"u": "N"}, extra=[level], capabilities=Capabilities(interpolate_inputs=True, save_state=True)
    )
    fmu.instantiate = lambda name: Following(name, fmu)
    system = assemble(
        [Part("sum", fmu), Part("minus", gain(-1.0, "N", "N"))], ["sum.level -> minus.u", "minus.y -> sum.u"]
    )
    errors = []
    for steps in (10, 20):  # level' = -level by the trapezoidal rule
        results = simulated(system, Iterative(tolerance=1e-13, interpolation=1), steps)
        errors.append(abs(results["sum.level"][-1] - math.exp(-1.0)))
        z = 1.0 / steps / 2.0
        assert results["sum.level"][-1] == pytest.approx(((1 - z) / (1 + z)) ** steps, rel=1e-11)
    assert math.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.05)
