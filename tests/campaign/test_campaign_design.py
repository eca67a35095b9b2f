"""Designs: blocks, ranges and samples of what a study varies."""

from __future__ import annotations

import math

import numpy as np
import pytest
from campaign_bench import one_body, quick, with_mass_in

from orchestrator.base.errors import ConfigError
from orchestrator.campaign import Study


def points(design, **changes):
    study = quick(design=design, **changes)
    return [{path: level.shown for path, level in study.task(n)[1].items()} for n in range(len(study))]


def test_blocks_multiply_and_add():
    delays = {"grid": {"robot.tau_m": ["1 ms", "2 ms"]}}
    rates = {"list": [{"robot.omega_n": "50 Hz"}, {"robot.omega_n": "75 Hz", "robot.xi_n": 0.5}]}
    made = points({"multiply": [delays, rates]})
    assert [one["robot.tau_m"] for one in made] == [0.001, 0.001, 0.002, 0.002]
    assert [one["robot.omega_n"] / (2 * math.pi) for one in made] == pytest.approx([50, 75, 50, 75])
    assert ["robot.xi_n" in one for one in made] == [False, True, False, True]
    made = points({"add": [delays, rates, {"multiply": [delays, rates]}]})
    assert len(made) == 8
    assert made[2].keys() == {"robot.omega_n"}


def test_ranges_are_linear_or_logarithmic_and_keep_their_ends():
    linear = {"from": "100 N/mm", "to": "200 N/mm", "count": 5}
    made = points({"grid": {"contact.stiffness": linear}})
    assert [one["contact.stiffness"] for one in made] == [100e3, 125e3, 150e3, 175e3, 200e3]
    made = points({"grid": {"contact.stiffness": linear | {"spacing": "log"}}})
    values = [one["contact.stiffness"] for one in made]
    assert values[0] == 100e3 and values[-1] == 200e3
    assert np.diff(np.log(values)) == pytest.approx([math.log(2) / 4] * 4)


@pytest.mark.parametrize("kind", ["random", "latin-hypercube", "sobol"])
def test_samples_keep_to_their_distributions(kind):
    over = {
        "contact.stiffness": {"uniform": ["100 N/mm", "200 N/mm"]},
        "robot.omega_n": {"log-uniform": ["10 Hz", "1000 Hz"]},
        "robot.tau_m": {"normal": {"mean": "4 ms", "std": "1 ms", "low": "2 ms"}},
        "run.master": {"choice": ["jacobi", "gauss-seidel"]},
    }
    design = {kind: {"count": 256, "seed": 3, "over": over}}
    made = points(design)
    assert made == points(design)
    assert made != points({kind: design[kind] | {"seed": 4}})
    stiffness = np.array([one["contact.stiffness"] for one in made])
    assert stiffness.min() >= 100e3 and stiffness.max() <= 200e3
    assert stiffness.mean() == pytest.approx(150e3, rel=0.04)
    decades = np.log10([one["robot.omega_n"] / (2 * math.pi) for one in made])
    assert decades.min() >= 1 - 1e-12 and decades.max() <= 3 + 1e-12
    assert decades.mean() == pytest.approx(2.0, abs=0.12)
    delay = np.array([one["robot.tau_m"] for one in made])
    assert delay.min() >= 0.002
    assert np.median(delay) == pytest.approx(0.00403, abs=2e-4)
    assert 90 <= sum(one["run.master"] == "jacobi" for one in made) <= 166
    if kind == "latin-hypercube":  # one point in each of 256 slices
        assert sorted(((stiffness - 100e3) / 100e3 * 256).astype(int)) == list(range(256))


def drawn(study, path):
    return np.array([study.task(n)[1][path].shown for n in range(len(study))])


def sample(path, distribution, count=4000):
    return {"random": {"count": count, "seed": 1, "over": {path: distribution}}}


@pytest.mark.parametrize("std", ["2 K", "2 degC"])
def test_a_deviation_is_a_difference_which_scales_begin_anywhere_alike(tmp_path, std):
    # Of a value that is at least 100 K: a deviation of 2 K is none the less one.
    fmu = with_mass_in("K", tmp_path / "K.fmu", "300", 'min="100"')
    values = drawn(
        one_body(fmu, design=sample("m.mass", {"normal": {"mean": "20 degC", "std": std}})), "m.mass"
    )
    assert values.mean() == pytest.approx(293.15, abs=0.2)
    assert values.std() == pytest.approx(2.0, rel=0.05)


@pytest.mark.parametrize(
    ("std", "reported"),
    [
        ("0 K", "m.mass: std '0 K' is not positive"),
        ("-1 K", "m.mass: std '-1 K' is not positive"),
        ("1 kg", "m.mass: std: cannot take '1 kg'"),
        (2, "m.mass: std: 2 has no unit"),
        (True, "m.mass: std True is no number"),
    ],
)
def test_deviations_that_are_none_are_refused(tmp_path, std, reported):
    fmu = with_mass_in("K", tmp_path / "K.fmu", "300")
    with pytest.raises(ConfigError) as caught:
        one_body(fmu, design=sample("m.mass", {"normal": {"mean": "20 degC", "std": std}}))
    assert reported in str(caught.value)


def noisy(design, master="jacobi"):
    run = {"master": master, "step_size": "1 ms", "stop_time": "10 ms"}
    return Study(system={"run": run, "instances": {"n": {"fmu": "SensorNoise"}}}, design=design)


ITERATIVE = {"name": "iterative", "tolerance": 1e-6}


@pytest.mark.parametrize(
    ("distribution", "weights"),
    [
        ({"uniform": [1, 4]}, [1.0, 1.0, 1.0, 1.0]),
        ({"log-uniform": [1, 4]}, [math.log((n + 0.5) / (n - 0.5)) for n in (1, 2, 3, 4)]),
        ({"normal": {"mean": 2, "std": 100.5, "low": 1, "high": 4}}, [1.0, 1.0, 1.0, 1.0]),
    ],
)
@pytest.mark.parametrize(("path", "master"), [("n.seed", "jacobi"), ("run.master.max_iterations", ITERATIVE)])
def test_whole_numbers_are_drawn_with_their_ends_as_often_as_the_rest(distribution, weights, path, master):
    study = noisy(sample(path, distribution), master)
    levels = [study.task(n)[1][path] for n in range(len(study))]
    assert all(type(one.canonical) is int for one in levels)
    counts = [sum(one.shown == n for one in levels) for n in (1, 2, 3, 4)]
    expected = np.array(weights) / sum(weights) * len(levels)
    # Chi-squared with 3 degrees of freedom exceeds 16.3 once in a thousand; the seed is fixed.
    assert (((np.array(counts) - expected) ** 2) / expected).sum() < 16.3


def test_options_that_take_fractions_are_drawn_between_whole_numbers():
    path = "run.master.tolerance"
    values = drawn(noisy(sample(path, {"uniform": [1, 4]}, 100), ITERATIVE), path)
    assert len(set(values)) == 100 and values.min() >= 1 and values.max() <= 4


def test_a_range_of_whole_numbers_is_one(tmp_path):
    path = "run.master.max_iterations"
    linear = noisy({"grid": {path: {"from": 10, "to": 50, "count": 5}}}, ITERATIVE)
    assert drawn(linear, path).tolist() == [10, 20, 30, 40, 50]
    assert linear.run(tmp_path / "store", jobs=1).failed == {}
    ratios = {"from": 1, "to": 256, "count": 9, "spacing": "log"}
    assert drawn(noisy({"grid": {path: ratios}}, ITERATIVE), path).tolist() == [2**n for n in range(9)]
    assert drawn(noisy({"grid": {"n.seed": ratios}}), "n.seed").tolist() == [2**n for n in range(9)]
    with pytest.raises(ConfigError) as caught:
        noisy({"grid": {path: {"from": 10, "to": 20, "count": 4}}}, ITERATIVE)
    assert str(caught.value).splitlines() == [
        "study: design.grid.run.master.max_iterations: run.master.max_iterations takes whole numbers; "
        "the range holds others",
        "  10, 13.3333, 16.6667, 20. Choose another count, or list the values.",
    ]
