"""The adaptive master: errors that keep to the tolerance, and what it does where they cannot."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from doubles import FakeFmu, mass, spring, variable

from orchestrator.assembly import Part, assemble
from orchestrator.errors import ConfigError, StepError
from orchestrator.fmi import Capabilities, Causality, Initial
from orchestrator.master import create_master
from orchestrator.master.adaptive import Adaptive
from orchestrator.results import Recorder
from orchestrator.simulate import Grid, simulate

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
    for time, h in seen:
        parts = (1 / 3) / h
        assert parts == 2 ** round(np.log2(parts))
        assert (time * 3) % 1 * parts == pytest.approx(round((time * 3) % 1 * parts), abs=1e-9)


def test_what_no_step_resolves_is_an_error_with_the_numbers():
    def wobble(values, time, h):
        values["level"] += np.sqrt(h)

    level = variable("level", Causality.OUTPUT, "m", initial=Initial.EXACT)
    system = assemble([Part("jump", FakeFmu(extra=[level], step=wobble))])
    with pytest.raises(StepError) as caught:
        simulated(system, Adaptive(tolerance=1e-6, max_halvings=3), 10)
    assert str(caught.value) == (
        "jump at time 0 s: master adaptive: a step of 0.0125 s, halved 3 times, still has an estimated error "
        "of 0.0463 in jump.level; tolerance 1e-06\n"
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
