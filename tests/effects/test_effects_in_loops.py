"""Effects of users, and effects under every master and loop."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from assembled import assemble
from doubles import gain, mass, spring
from unruly import unruly_fmu
from wired import (
    MASTERS,
    SIZED,
    bits,
    every_effect,
    every_master,
    oscillator,
    ramp,
    simulated,
)

from orchestrator.base.errors import ConfigError, StepError
from orchestrator.effects.choose import BUILT_IN
from orchestrator.fmi import load_fmu
from orchestrator.master.adaptive import Adaptive
from orchestrator.master.iterative import Iterative
from orchestrator.system.assembly import Part
from orchestrator.system.connection import Leg, Wire

# The docking FMUs bring a pythonfmu of their own, without what building takes: find the installed one first.
pytest.importorskip("pythonfmu")

USERS = '''
from typing import Annotated
from pydantic import Field
from orchestrator.effects import Effect, OfSignal

class Friction(Effect):
    """Opposes a velocity that it reads."""
    reads = ("velocity",)
    force: Annotated[float, OfSignal()] = Field(ge=0)

    @staticmethod
    def kernel(time, x, options, memory, commit):
        return x[0] - options[0] * (x[1] > 0.0) + options[0] * (x[1] < 0.0)

class Peak(Effect):
    """The largest value so far."""
    jittable = True

    @staticmethod
    def kernel(time, x, options, memory, commit):
        best = x[0]
        if memory[0] != 0.0 and memory[1] > best:
            best = memory[1]
        if commit:
            memory[0] = 1.0
            memory[1] = best
        return best

    def room(self, step_size):
        return 2

class Broken(Effect):
    @staticmethod
    def kernel(time, x, options, memory, commit):
        return 1.0 / (x[0] - x[0])

class Unjittable(Effect):
    jittable = True

    @staticmethod
    def kernel(time, x, options, memory, commit):
        return float(sorted(str(x[0]), key=hash)[0] > "a")
'''


@pytest.fixture
def users(tmp_path):
    (tmp_path / "mine.py").write_text(USERS)
    return tmp_path


def test_an_effect_of_a_user_reads_a_further_signal(users):
    """A mass on a spring with dry friction of 0.1 N, to the left until it turns: x = 0.9 cos t + 0.1."""
    item = {"effect": "mine.py:Friction", "force": "0.1 N", "read": {"velocity": "mass.velocity"}}
    system = assemble(
        [Part("mass", mass(), {"position": "1 m"}), Part("spring", spring())],
        [
            "mass.position -> spring.position",
            {"from": "spring.force", "to": "mass.force", "through": [item]},
        ],
        folder=users,
    )
    results = simulated(system, MASTERS["newton-1"], 2000, 3)
    assert results["mass.position"] == pytest.approx(0.1 + 0.9 * np.cos(results.time), abs=2e-3)


def test_an_effect_of_a_user_that_fails_names_itself(users):
    system = oscillator([{"effect": "mine.py:Broken"}], folder=users)
    with pytest.raises(StepError) as caught:
        simulated(system, "jacobi", 10)
    assert str(caught.value) == (
        "mass at time 0 s: effect mine.py:Broken on mass.position -> mine.py:Broken -> spring.position "
        "failed: ZeroDivisionError: float division by zero"
    )


# Both loops.


def chain_of_three(through, folder=None):
    fmu = load_fmu(unruly_fmu(3, "mm", "m"))
    return assemble(
        [Part("one", fmu), Part("two", fmu), Part("three", fmu, {"rate": "3 mm"})],
        [
            {"from": "three.level", "to": "one.rate", "through": through},
            {
                "from": ["one.level", {"port": "three.level", "gain": -0.5}],
                "to": "two.rate",
                "through": through,
            },
        ],
        folder=folder,
    )


@pytest.mark.parametrize("master", ["jacobi", "gauss-seidel"])
@pytest.mark.parametrize("name", [*BUILT_IN, "all", "none"])
def test_both_loops_give_the_same_bits(name, master):
    pytest.importorskip("numba")
    items = {**{key: [item] for key, item in SIZED.items()}, "all": list(SIZED.values()), "none": []}[name]
    native = simulated(chain_of_three(items), master, 2500, 3, "native")
    assert bits(native) == bits(simulated(chain_of_three(items), master, 2500, 3))
    assert len(np.unique(native["one.level"])) > 1000


@pytest.mark.parametrize("summed", [False, True])
@every_master
def test_effects_of_a_leg_act_before_its_gain(summed, master):
    """As effects before a gain do that is an effect itself; also of a leg that is added to another."""
    through = [SIZED["low-pass"], SIZED["saturate"], SIZED["delay"]]
    alone = oscillator([*through, {"gain": 0.5}])
    made, force = alone.connections
    (leg,), links = made.wire
    legs = [leg._replace(gain=0.5, links=links[:-1])]
    if summed:
        nothing = Leg(force.source, 0.0)
        legs = [nothing, *legs]
    own = replace(made, wire=Wire(tuple(legs)))
    assert set(own.sources) == {one.port for one in legs} and leg.port in made.passed_at_once
    found, expected = (
        simulated(one, master, 300, 3) for one in (replace(alone, connections=(own, force)), alone)
    )
    assert bits(found) == bits(expected)


@pytest.mark.parametrize("master", ["jacobi", "gauss-seidel"])
def test_both_loops_give_the_same_bits_of_legs_with_effects(master):
    pytest.importorskip("numba")

    def system(through):
        whole = chain_of_three(list(SIZED.values()))
        first, second = whole.connections
        legs, links = second.wire
        legs = tuple(leg._replace(links=links) for leg in legs)
        return replace(whole, connections=(first, replace(second, wire=Wire(legs))))

    native = simulated(system(()), master, 2500, 3, "native")
    assert bits(native) == bits(simulated(system(()), master, 2500, 3))
    assert bits(native) != bits(simulated(chain_of_three(list(SIZED.values())), master, 2500, 3))


def test_an_effect_of_a_user_runs_in_the_native_loop_where_it_can(users):
    pytest.importorskip("numba")
    system = chain_of_three([{"effect": "mine.py:Peak"}, {"delay": "5 ms"}], users)
    native = simulated(system, "gauss-seidel", 500, loop="native")
    assert bits(native) == bits(simulated(system, "gauss-seidel", 500))
    for name, reason in (("Broken", "is Python code"), ("Unjittable", "cannot be compiled")):
        with pytest.raises(ConfigError) as caught:
            simulated(chain_of_three([{"effect": f"mine.py:{name}"}], users), "jacobi", 10, loop="native")
        assert "the native loop cannot run this: effect mine.py:" in str(caught.value)
        assert reason in str(caught.value)


# Masters.


@pytest.mark.parametrize("name", ["delay", "low-pass", "gain", "saturate"])
def test_halving_the_step_shows_the_masters_order_with_effects(name):
    """A delay of whole coarse steps: the order is the master's, not the line's between points."""
    item = {"delay": "50 ms"} if name == "delay" else SIZED[name]
    system = oscillator([item])
    ends = [
        simulated(system, MASTERS["newton-1"], steps)["mass.position"][-1] for steps in (40, 80, 160, 320)
    ]
    differences = np.abs(np.diff(ends))
    orders = [math.log2(a / b) for a, b in pairwise(differences)]
    assert min(orders) > (0.7 if name == "saturate" else 1.8)
    assert differences[-1] < 1e-4


def test_a_delayed_oscillator_follows_its_delay_differential_equation():
    """X'' = -x(t - d), x = 1 until the start: by the method of steps, exact to t = 3 d."""
    d = 0.25
    system = oscillator([{"delay": f"{d} s"}])
    results = simulated(system, MASTERS["newton-1"], 300, Fraction(3, 4))
    t = results.time
    # x = sum over n of (-1)**n (t - (n - 1) d)**(2 n) / (2 n)! where t > (n - 1) d.
    exact = (
        sum(
            (-1) ** n * np.maximum(t - (n - 1) * d, 0.0) ** (2 * n) / math.factorial(2 * n)
            for n in range(1, 6)
        )
        + 1.0
    )
    assert results["mass.position"] == pytest.approx(exact, abs=2e-5)


@every_effect
@pytest.mark.parametrize("estimate", ["doubling", "inputs"])
def test_masters_that_step_back_give_the_fixed_step_at_a_loose_tolerance(name, estimate):
    item = SIZED[name]
    fixed = simulated(oscillator([item]), "gauss-seidel", 40)
    if estimate == "inputs":
        assert bits(simulated(oscillator([item]), Adaptive(tolerance=1e9, estimate="inputs"), 40)) == bits(
            fixed
        )
        loose = simulated(oscillator([item]), Iterative(tolerance=1e9), 40)
        assert bits(loose) == bits(fixed)
        return
    halves = simulated(oscillator([item]), Adaptive(tolerance=1e9), 20)
    assert halves["mass.position"].tolist() == fixed["mass.position"][::2].tolist()


@every_effect
def test_what_was_tried_is_not_remembered(name):
    """A run that goes back from whole steps to take their halves, and one of halves, agree to the bit."""
    item = SIZED[name]
    taken = simulated(oscillator([item]), Adaptive(tolerance=1e9), 16)
    fixed = simulated(oscillator([item]), "gauss-seidel", 32)
    assert taken["spring.force"].tolist() == fixed["spring.force"][::2].tolist()


def test_a_delay_finds_room_for_as_many_parts_as_the_adaptive_master_takes():
    master = Adaptive(tolerance=1e-7)
    results = simulated(oscillator([{"delay": "0.4 s"}]), master, 4, Fraction(8, 10))
    # Method of steps, see above.
    d, t = 0.4, results.time
    exact = 1.0 - t**2 / 2.0 + np.maximum(t - d, 0.0) ** 4 / 24.0
    assert results["mass.position"] == pytest.approx(exact, abs=1e-3)


def test_slow_instances_are_seen_as_they_stand():
    system = assemble(
        [Part("slow", ramp(), ratio=Fraction(4)), Part("sink", gain(1.0, "m", "m"))],
        [{"from": "slow.y", "to": "sink.u", "through": [{"delay": "20 ms"}]}],
    )
    results = simulated(system, "gauss-seidel", 100)
    assert results["sink.y"][2:].tolist() == results["slow.y"][:-2].tolist()


# Feedthrough and algebraic loops.


def two_gains(through, **options):
    return assemble(
        [Part("a", gain(0.5)), Part("b", gain(0.5)), Part("c", ramp(unit=""))],
        [
            {"from": ["a.y", "c.y"], "to": "b.u", "through": through},
            "b.y -> a.u",
        ],
        **options,
    )


def test_a_delay_of_a_step_breaks_an_algebraic_loop_and_a_shorter_one_does_not():
    system = two_gains([{"delay": "10 ms"}], step_size=0.01)
    assert system.loops == () and system.longest_step == 0.01
    results = simulated(system, "gauss-seidel", 100)
    # b = (a + c)/2 of the point before, a = b/2: all at one instant.
    expected = 0.5 * (results["a.y"] + results["c.y"])[:-1]
    assert results["b.y"][1:] == pytest.approx(expected, abs=1e-15)
    for through, step in (
        ([{"delay": "9 ms"}], 0.01),
        ([{"low-pass": "1 Hz"}], 0.01),
        ([{"delay": "1 s"}], None),
    ):
        with pytest.raises(ConfigError) as caught:
            two_gains(through, step_size=step)
        assert "algebraic loop" in str(caught.value) and "The master iterative solves it" in str(caught.value)
    with pytest.raises(ConfigError) as caught:
        simulated(system, "gauss-seidel", 50)
    assert str(caught.value) == (
        "run.step_size: step size 0.02 s is longer than 0.01 s\n"
        "  the system's delays were checked by that one"
    )


@pytest.mark.parametrize("method", ["newton", "anderson", "fixed-point"])
def test_an_algebraic_loop_through_effects_is_solved(method):
    """B = (a/2 + c) 1.5 + 1 with a = b/2: b = (1.5 c + 1)/(1 - 0.375)... at every point."""
    system = two_gains([{"gain": 1.5}, {"offset": 1.0}], loops=True)
    results = simulated(system, Iterative(tolerance=1e-12, method=method, max_iterations=200), 20)
    b = 0.5 * (1.5 * results["c.y"] + 1.0) / (1.0 - 0.5 * 1.5 * 0.5)
    assert results["b.y"] == pytest.approx(b, abs=1e-9)


def test_the_order_of_gauss_seidel_follows_what_passes_at_once():
    parts = [Part("last", gain(1.0, "m", "m")), Part("first", ramp())]
    ends = {"from": "first.y", "to": "last.u"}
    assert assemble(parts, [{**ends, "through": [{"low-pass": "1 Hz"}]}], step_size=0.1).order == (1, 0)
    assert assemble(parts, [{**ends, "through": [{"delay": "1 s"}]}], step_size=0.1).order == (1, 0)
    # What does pass at once goes before a wish.
    parts = [Part("a", gain(1.0, "m", "m")), Part("b", gain(1.0, "m", "m"))]
    back = [{"from": "b.y", "to": "a.u", "through": [{"delay": "1 s"}]}, "a.y -> b.u"]
    assert assemble(parts, back, step_size=0.1).order == (0, 1)
    assert assemble(parts[::-1], back, step_size=0.1).order == (1, 0)


def test_what_is_not_finite_is_named():
    source = ramp(lambda t: math.inf if t > 0.5 else t)
    system = assemble(
        [Part("source", source), Part("sink", gain(1.0, "m", "m"))],
        [{"from": "source.y", "to": "sink.u", "through": [item for item in SIZED.values()]}],
    )
    with pytest.raises(StepError, match=r"source at time 0.6 s: y \[m\] is inf"):
        simulated(system, "gauss-seidel", 10)
    system = oscillator([{"gain": 1e308}, {"gain": 1e308}])
    with pytest.raises(StepError) as caught:
        simulated(system, "jacobi", 10)
    assert str(caught.value) == (
        "mass: mass.position -> gain -> gain -> spring.position: the effects give inf\n"
        "  Check the effects' options."
    )
