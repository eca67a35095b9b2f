"""Effects on connections: nothing at zero size, their closed forms elsewhere, under every master and loop."""

from __future__ import annotations

import math
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from doubles import FakeFmu, gain, mass, spring
from unruly import unruly_fmu

from orchestrator.assembly import Part, assemble
from orchestrator.effects import effect_names
from orchestrator.effects.choose import BUILT_IN, built_in
from orchestrator.effects.noise import Noise
from orchestrator.errors import ConfigError, StepError
from orchestrator.fmi import load_fmu
from orchestrator.master import create_master
from orchestrator.master.adaptive import Adaptive
from orchestrator.master.iterative import Iterative
from orchestrator.results import Recorder
from orchestrator.run import run
from orchestrator.simulate import Grid, Report, simulate

# The docking FMUs bring a pythonfmu of their own, without what building takes: find the installed one first.
pytest.importorskip("pythonfmu")

# Each effect at zero size, and with an effect, on a signal in metres that is about one.
ZERO = {
    "gain": [{"gain": 1}, {"gain": 1.0}],
    "offset": [{"offset": "0 mm"}],
    "delay": [{"delay": "0 s"}, {"delay": "0 s", "before": "7 m"}],
    "low-pass": [{"low-pass": {"time_constant": "0 s"}}, {"low-pass": "inf Hz"}],
    "sample-and-hold": [{"sample-and-hold": "0 s", "phase": "1 ms"}],
    "saturate": [{"saturate": {}}, {"saturate": {"low": "-inf m", "high": "inf"}}],
    "quantise": [{"quantise": "0 m"}],
    "rate-limit": [{"rate-limit": "inf m/s"}],
    "dead-band": [{"dead-band": "0 m"}],
    "backlash": [{"backlash": "0 m"}],
    "noise": [
        {"noise": "0 m", "period": "1 ms", "seed": 5},
        {"noise": "0 m", "period": "1 ms", "seed": 5, "correlation": "1 ms"},
    ],
    "drift": [{"drift": "0 m/s"}],
    "dropout": [{"dropout": 0, "period": "1 ms", "seed": 5}],
    "jitter": [{"jitter": "0 s", "period": "1 ms", "seed": 5}],
    "map": [{"map": []}],
}
SIZED = {
    "gain": {"gain": 1.1},
    "offset": {"offset": "-10 cm"},
    "delay": {"delay": "33 ms"},
    "low-pass": {"low-pass": "20 Hz"},
    "sample-and-hold": {"sample-and-hold": "33 ms", "phase": "7 ms"},
    "saturate": {"saturate": {"high": "0.9 m"}},
    "quantise": {"quantise": "20 mm"},
    "rate-limit": {"rate-limit": "0.3 m/s"},
    "dead-band": {"dead-band": "0.1 m"},
    "backlash": {"backlash": "10 mm"},
    "noise": {"noise": "1 mm", "period": "7 ms", "seed": 5},
    "drift": {"drift": "-10 mm/s"},
    "dropout": {"dropout": 0.5, "period": "7 ms", "seed": 5},
    "jitter": {"jitter": "30 ms", "period": "7 ms", "seed": 5},
    "map": {"map": ["1 -> 3"]},
}
MASTERS = {
    "jacobi": {"name": "jacobi"},
    "jacobi-2": {"name": "jacobi", "extrapolation": 2},
    "gauss-seidel": {"name": "gauss-seidel"},
    "gauss-seidel-1": {"name": "gauss-seidel", "extrapolation": 1},
    "gauss-seidel-2": {"name": "gauss-seidel", "extrapolation": 2},
    "newton": {"name": "iterative", "tolerance": 1e-10},
    "newton-1": {"name": "iterative", "tolerance": 1e-10, "interpolation": 1},
    "anderson": {"name": "iterative", "tolerance": 1e-10, "method": "anderson"},
    "fixed-point": {"name": "iterative", "tolerance": 1e-10, "method": "fixed-point"},
    "doubling": {"name": "adaptive", "tolerance": 1e-4},
    "inputs": {"name": "adaptive", "tolerance": 1e-3, "estimate": "inputs"},
    "inputs-1": {
        "name": "adaptive",
        "tolerance": 1e-3,
        "estimate": "inputs",
        "base": {"name": "jacobi", "extrapolation": 1},
    },
    "iterative-parts": {
        "name": "adaptive",
        "tolerance": 1e-3,
        "base": {"name": "iterative", "tolerance": 1e-10},
    },
}
every_effect = pytest.mark.parametrize("name", BUILT_IN)
every_master = pytest.mark.parametrize("master", MASTERS.values(), ids=MASTERS.keys())


def simulated(system, master, steps, stop=1, loop="python"):
    recorder, report = Recorder(system), Report()
    chosen = create_master(master) if isinstance(master, str | dict) else master
    simulate(system, chosen, Grid(Fraction(0), Fraction(stop) / steps, steps), [recorder], report, loop=loop)
    assert report.loop == loop
    return recorder.results()


def bits(results):
    return results.time.tobytes(), {name: column.tobytes() for name, column in results.signals.items()}


def oscillator(through=(), **options):
    """x'' = -x, x(0) = 1 m: x = cos t; the spring gets the position through effects."""
    return assemble(
        [Part("mass", mass(), {"position": "1 m"}), Part("spring", spring())],
        [
            {"from": "mass.position", "to": "spring.position", "through": list(through)},
            "spring.force -> mass.force",
        ],
        **options,
    )


def ramp(function=lambda t: t, unit="m"):
    """An FMU that gives a function of time."""
    return FakeFmu(
        outputs={"y": unit},
        step=lambda values, time, h: values.update(now=time + h),
        output=lambda values: {"y": function(values.get("now", 0.0))},
    )


def filtered(through, function=lambda t: t, steps=100, master="gauss-seidel", unit="m", stop=1):
    """What comes out of effects on a function of time, at every point."""
    system = assemble(
        [Part("source", ramp(function, unit)), Part("sink", gain(1.0, unit, unit))],
        [{"from": "source.y", "to": "sink.u", "through": through}],
    )
    return simulated(system, master, steps, stop)["sink.y"]


# At zero size.


def test_every_effect_stands_in_the_suite():
    assert set(ZERO) == set(SIZED) == set(BUILT_IN) <= set(effect_names())


@every_effect
@every_master
def test_at_zero_size_every_bit_stays(name, master):
    plain = bits(simulated(oscillator(), master, 40))
    for item in ZERO[name]:
        assert bits(simulated(oscillator([item]), master, 40)) == plain
    assert (
        bits(simulated(oscillator([item for items in ZERO.values() for item in items]), master, 40)) == plain
    )


@every_effect
@every_master
def test_with_a_size_every_effect_shows(name, master):
    if name == "map":  # its table is for whole numbers
        plain = filtered([], lambda t: float(t > 0.5), master="jacobi")
        changed = filtered([SIZED[name]], lambda t: float(t > 0.5), master="jacobi")
        assert plain.max() == 1.0 and (changed == 3.0 * plain).all()
        return
    if name in ("quantise", "sample-and-hold", "noise", "dropout", "jitter") and master["name"] == "adaptive":
        # Jumps of an input have no small error in small steps: fixed ones.
        master = {**master, "tolerance": 1e9}
    plain, changed = simulated(oscillator(), master, 40), simulated(oscillator([SIZED[name]]), master, 40)
    assert np.abs(changed["mass.position"] - plain["mass.position"]).max() > 1e-6
    assert np.abs(changed["mass.position"] - plain["mass.position"]).max() < 0.2


def test_a_minus_zero_stays_one():
    items = [item for items in ZERO.values() for item in items]
    out = filtered(items, lambda t: -0.0, 3)
    assert np.signbit(filtered([], lambda t: -0.0, 3)).all() and np.signbit(out).all()


@pytest.mark.parametrize("master", ["jacobi", "gauss-seidel", "newton", "newton-1", "gauss-seidel-2"])
def test_at_zero_size_the_docking_loop_keeps_every_bit(master):
    """Its FMUs offer directional derivatives and take input derivatives."""
    units = {"position": "m", "velocity": "m/s", "force": "N"}

    def ran(wired, loop):
        data = {
            "extends": "docking-1d-uncompensated",
            "run": {"master": MASTERS[master], "step_size": "0.5 ms", "stop_time": "0.9 s", "loop": loop},
        }
        return docking(data, wired and (lambda name: zero_chain(units[name])), loop)

    def zero_chain(unit):
        return [
            {"gain": 1},
            {"delay": "0 s"},
            {"low-pass": {"time_constant": "0 s"}},
            {"quantise": f"0 {unit}"},
        ]

    plain = ran(False, "python")
    assert plain["contact.force"].max() > 1.0
    assert bits(ran(True, "python")) == bits(plain)
    if master in ("jacobi", "gauss-seidel"):
        assert bits(ran(True, "native")) == bits(plain)


def docking(data, through, loop):
    """Results of docking-1d-uncompensated with effects on each connection, by the name of its source."""
    from orchestrator.config import load_config

    base = load_config("docking-1d-uncompensated").model.to_data()
    base["run"].update(data["run"])
    if through:
        ends = [[end.strip() for end in one.split("->")] for one in base["connections"]]
        base["connections"] = [{"from": a, "to": b, "through": through(a.partition(".")[2])} for a, b in ends]
    base.pop("measures", None)
    return run(base, halving=False).results


# Closed forms.


def test_a_delay_of_whole_steps_gives_earlier_points_to_the_bit():
    t = np.arange(101) * 0.01
    for count in (1, 3, 7, 40, 200):
        late = filtered([{"delay": f"{count * 10} ms"}], math.exp)
        exact = filtered([], math.exp)
        assert late.tolist() == exact[np.maximum(np.arange(101) - count, 0)].tolist()
    assert np.exp(t) == pytest.approx(exact, rel=1e-14)


def test_a_delay_lies_on_the_line_between_points_and_knows_what_was_before():
    late = filtered([{"delay": "25 ms"}])
    t = np.arange(101) * 0.01
    assert late == pytest.approx(np.maximum(t - 0.025, 0.0), abs=1e-12)
    told = filtered([{"delay": "25 ms", "before": "-3 m"}])
    assert told[:3].tolist() == [-3.0] * 3
    assert told[3:] == pytest.approx(late[3:], abs=1e-15)


def test_a_delay_shorter_than_a_step_lies_within_it():
    assert filtered([{"delay": "4 ms"}])[1:] == pytest.approx(np.arange(1, 101) * 0.01 - 0.004, abs=1e-12)


@pytest.mark.parametrize(
    "item", [{"low-pass": "3 Hz"}, {"low-pass": {"time_constant": "53.0516476972984452 ms"}}]
)
def test_a_low_pass_is_exact_on_lines_and_of_second_order_elsewhere(item):
    lag = 1.0 / (6.0 * math.pi)
    t = np.arange(101) * 0.01
    assert filtered([item]) == pytest.approx(t - lag * (1.0 - np.exp(-t / lag)), abs=1e-13)
    errors = []
    for steps in (50, 100, 200):
        t = np.arange(steps + 1) / steps
        exact = (np.cos(t) + lag * np.sin(t) - np.exp(-t / lag)) / (1 + lag**2) + np.exp(-t / lag)
        errors.append(np.abs(filtered([item], math.cos, steps) - exact).max())
    assert [math.log2(a / b) for a, b in pairwise(errors)] == pytest.approx([2.0, 2.0], abs=0.1)


def test_sample_and_hold_takes_its_own_instants():
    t = np.arange(101) * 0.01
    held = filtered([{"sample-and-hold": "40 ms"}])
    assert held == pytest.approx(0.04 * np.floor(t / 0.04 + 1e-9), abs=1e-12)
    between = filtered([{"sample-and-hold": "32 ms", "phase": "13 ms"}])
    exact = np.where(t < 0.013 - 1e-9, 0.0, 0.013 + 0.032 * np.floor((t - 0.013) / 0.032 + 1e-9))
    assert between == pytest.approx(exact, abs=1e-12)


def test_functions_without_memory():
    wave = filtered([], lambda x: math.sin(7 * x))

    def through(item):
        return filtered([item], lambda x: math.sin(7 * x))

    assert (
        through({"saturate": {"low": "-0.5 m", "high": "30 cm"}}).tolist()
        == np.clip(wave, -0.5, 0.3).tolist()
    )
    assert through({"quantise": "25 cm"}) == pytest.approx(0.25 * np.floor(wave / 0.25 + 0.5), abs=1e-15)
    assert through({"dead-band": "0.4 m"}) == pytest.approx(
        np.sign(wave) * np.maximum(np.abs(wave) - 0.4, 0.0), abs=1e-15
    )
    assert through({"offset": "20 cm"}).tolist() == (wave + 0.2).tolist()


def test_rate_limit_and_backlash_follow():
    steep = filtered([{"rate-limit": "0.4 m/s"}], lambda t: t if t < 0.5 else 0.0)
    t = np.arange(101) * 0.01
    exact = np.where(t < 0.495, 0.4 * t, np.maximum(0.4 * 0.49 - 0.4 * (t - 0.49), 0.0))
    assert steep == pytest.approx(exact, abs=1e-12)
    triangle = filtered([{"backlash": "10 cm"}], lambda t: 0.5 - abs(t - 0.5))
    x = 0.5 - np.abs(t - 0.5)
    rising = np.maximum(x - 0.05, 0.0)
    assert triangle == pytest.approx(np.where(t <= 0.5, rising, np.minimum(0.45, x + 0.05)), abs=1e-12)


def test_noise_is_normal_repeatable_and_independent_of_step_and_master():
    item = {"noise": "2 m", "period": "1 ms", "seed": 123456789012}
    one = filtered([item], lambda t: 0.0, 4000, stop=4)
    assert one[:-1].tolist() == filtered([item], lambda t: 0.0, 4000, "jacobi", stop=4)[1:].tolist()
    assert one[::2].tolist() == filtered([item], lambda t: 0.0, 2000, stop=4).tolist()
    assert one.tolist() != filtered([{**item, "seed": 1}], lambda t: 0.0, 4000, stop=4).tolist()
    from scipy.stats import kstest

    assert kstest(one / 2.0, "norm").pvalue > 0.01
    correlation = np.corrcoef(one[:-1], one[1:])[0, 1]
    assert abs(correlation) < 3.0 / math.sqrt(4000)


def test_noise_with_a_correlation_time_forgets_in_it():
    item = {"noise": "2 m", "period": "1 ms", "seed": 7, "correlation": "4 ms"}
    one = filtered([item], lambda t: 0.0, 8000, stop=8)
    assert one.tolist() == filtered([item], lambda t: 0.0, 16000, stop=8)[::2].tolist()
    assert np.std(one) == pytest.approx(2.0, rel=0.1)
    for ticks in (1, 4):
        found = np.corrcoef(one[:-ticks], one[ticks:])[0, 1]
        assert found == pytest.approx(math.exp(-ticks / 4.0), abs=0.08)


def test_dropout_holds_what_was_not_lost():
    item = {"dropout": 0.3, "period": "2 ms", "phase": "1 ms", "seed": 11}
    one = filtered([item], lambda t: t, 4000, stop=4)
    taken = np.flatnonzero(np.diff(one) > 0.0) + 1
    assert set(taken % 2) == {1}, "samples at odd points"
    assert one[taken] == pytest.approx(taken * 1e-3, abs=1e-12)
    assert 1.0 - len(taken) / 2000 == pytest.approx(0.3, abs=0.04)
    assert one == pytest.approx(filtered([item], lambda t: t, 8000, stop=4)[::2], abs=1e-12)
    assert filtered([{**item, "dropout": 1}], lambda t: t, 100).tolist() == [0.0] * 101


def test_jitter_delays_each_period_by_another_time():
    item = {"jitter": "4 ms", "period": "10 ms", "seed": 3}
    one = filtered([item], lambda t: t, 4000, stop=4)
    late = (np.arange(4001) * 1e-3 - one)[10:-1].reshape(-1, 10)
    assert np.ptp(late, axis=1).max() < 1e-12, "the same within a period"
    assert late.min() >= -1e-12 and late.max() <= 4e-3 + 1e-12
    from scipy.stats import kstest

    assert kstest(late[:, 0] / 4e-3, "uniform").pvalue > 0.01


def test_drift_grows_from_the_start():
    assert filtered([{"drift": "3 m/s"}], lambda t: 0.0, 10)[-1] == pytest.approx(3.0, abs=1e-12)


# Sums, further signals, other units.


def test_several_sources_are_added_each_with_its_gain():
    system = assemble(
        [
            Part("one", ramp(math.sin)),
            Part("two", ramp(math.cos, "mm")),
            Part("sink", gain(1.0, "N", "N")),
        ],
        [
            {
                "from": [{"port": "one.y", "gain": "2 N/m"}, {"port": "two.y", "gain": "-3 N/mm"}],
                "to": "sink.u",
                "through": [{"offset": "1 N"}],
            }
        ],
    )
    results = simulated(system, "gauss-seidel", 50)
    exact = 2.0 * results["one.y"] - 3.0 * results["two.y"] + 1.0
    assert results["sink.y"] == pytest.approx(exact, abs=1e-12)
    assert simulated(system, MASTERS["newton"], 50)["sink.y"].tolist() == results["sink.y"].tolist()
    delayed = simulated(system, "jacobi", 50)["sink.y"]
    assert delayed[1:].tolist() == results["sink.y"][:-1].tolist()


def test_a_sum_of_lengths_in_other_units_is_converted():
    parts = [Part("one", ramp()), Part("two", ramp(unit="mm")), Part("sink", gain(1.0, "mm", "mm"))]
    system = assemble(parts, [{"from": ["one.y", "two.y"], "to": "sink.u"}])
    results = simulated(system, "gauss-seidel", 10)
    assert results["sink.y"] == pytest.approx(1000.0 * results["one.y"] + results["two.y"], rel=1e-14)


@every_master
def test_a_sum_of_a_signal_and_none_of_another_changes_no_bit(master):
    def system(source):
        return assemble(
            [
                Part("mass", mass(), {"position": "1 m"}),
                Part("spring", spring()),
                Part("other", ramp()),
            ],
            [{"from": source, "to": "spring.position"}, "spring.force -> mass.force"],
        )

    plain = simulated(system("mass.position"), master, 30)
    added = simulated(system(["mass.position", {"port": "other.y", "gain": 0}]), master, 30)
    assert bits(added) == bits(plain)


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
    """x'' = -x(t - d), x = 1 until the start: by the method of steps, exact to t = 3 d."""
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
    """An adaptive run that steps back and one that takes the same steps at once agree to the bit."""
    item = SIZED[name]

    class Nervous(Adaptive):
        """Rejects every whole step once, then takes its halves."""

    taken = simulated(oscillator([item]), Nervous(tolerance=1e9), 16)
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
        "run.step_size: step size 0.02 s is longer than 0.01 s\n  the system's delays were judged by that one"
    )


@pytest.mark.parametrize("method", ["newton", "anderson", "fixed-point"])
def test_an_algebraic_loop_through_effects_is_solved(method):
    """b = (a/2 + c) 1.5 + 1 with a = b/2: b = (1.5 c + 1)/(1 - 0.375)... at every point."""
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


def test_noise_of_array_elements_is_independent():
    noise = built_in("noise")
    assert noise is Noise
    one = Noise(deviation=1.0, period=1.0, seed=3)
    assert one.for_element(1).numbers() != one.numbers()
