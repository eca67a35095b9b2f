"""Effects on connections: nothing at zero size, their closed forms elsewhere."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from assembled import assemble
from doubles import gain, mass, spring
from wired import (
    MASTERS,
    SIZED,
    ZERO,
    bits,
    every_effect,
    every_master,
    filtered,
    oscillator,
    ramp,
    simulated,
)

from orchestrator.effects import effect_names
from orchestrator.effects.choose import BUILT_IN, built_in
from orchestrator.effects.noise import Noise
from orchestrator.simulation.run import run
from orchestrator.system.assembly import Part

# The docking FMUs bring a pythonfmu of their own, without what building takes: find the installed one first.
pytest.importorskip("pythonfmu")

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
    if (
        name in ("quantise", "sample-and-hold", "noise", "dropout", "jitter", "relay")
        and master["name"] == "adaptive"
    ):
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
    reported = filtered([{"delay": "25 ms", "before": "-3 m"}])
    assert reported[:3].tolist() == [-3.0] * 3
    assert reported[3:] == pytest.approx(late[3:], abs=1e-15)


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


def test_noise_of_array_elements_is_independent():
    noise = built_in("noise")
    assert noise is Noise
    one = Noise(deviation=1.0, period=1.0, seed=3)
    assert one.for_element(1).numbers() != one.numbers()
